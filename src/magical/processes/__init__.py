"""Child processes: one pool for finite work, and how every child is started and ended.

- `map_in_processes` maps a function over items in several processes.
- `ProcessPool` takes tasks one at a time, and gives their results in any order.
- `Child` is one child process, for those that need more than that (the vector environment).
- `describe` and `rebuild` carry an exception from a child to its parent.
"""

from magical.processes.children import Child
from magical.processes.exceptions import WorkerTraceback, describe, rebuild
from magical.processes.pool import ProcessPool, available_cores, map_in_processes

__all__ = [
    "Child",
    "ProcessPool",
    "WorkerTraceback",
    "available_cores",
    "describe",
    "map_in_processes",
    "rebuild",
]
