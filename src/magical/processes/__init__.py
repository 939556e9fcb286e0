"""Child processes.

- `map_in_processes` maps a function over items in several processes.
- `Child` is a single child process (of the vector environment), `serve` its side of the pipes.
"""

from magical.processes.channel import WorkerTraceback, serve
from magical.processes.children import Child
from magical.processes.pool import available_cores, checked_workers, map_in_processes

__all__ = [
    "Child",
    "WorkerTraceback",
    "available_cores",
    "checked_workers",
    "map_in_processes",
    "serve",
]
