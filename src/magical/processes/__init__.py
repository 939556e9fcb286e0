"""Child processes: one pool for finite work, and how every child is started and ended.

- `map_in_processes` maps a function over items in several processes; `outcomes_in_processes` yields
  exceptions too.
- `ProcessPool` takes tasks one at a time, and gives their results in any order.
- `Child` is a single child process, for uses that need more than that, and `serve` is its side of
  the pipes.
"""

from magical.processes.channel import WorkerTraceback, serve
from magical.processes.children import Child
from magical.processes.pool import (
    ProcessPool,
    available_cores,
    checked_workers,
    map_in_processes,
    outcomes_in_processes,
)

__all__ = [
    "Child",
    "ProcessPool",
    "WorkerTraceback",
    "available_cores",
    "checked_workers",
    "map_in_processes",
    "outcomes_in_processes",
    "serve",
]
