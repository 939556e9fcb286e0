"""The runs of a plan as its results folder lists them."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from magical.errors import ResultsError
from magical.messages import printable, quoted
from magical.untrusted import read_json

PLAN = "plan.json"  # in a results folder: the planned runs
RUNS = "runs"  # in a results folder: the folder that holds the run folders
REFERENCES = "references"  # in a results folder: a folder for each reference policy and task
RESULT = "result.json"  # in a run's folder: its final record
MAX_BYTES = 1 << 26  # of `plan.json`
MAX_NAME = 40  # characters of a method's name in a file's name


@dataclass(frozen=True, slots=True)
class ListedRun:
    """A run as `plan.json` lists it; `total` is the number of batches or updates of training."""

    folder: str
    method: str
    tasks: tuple[str, ...]
    seed: int
    total: int

    def __post_init__(self) -> None:
        if Path(self.folder).name != self.folder or "\0" in self.folder:
            raise ValueError(f"expected a folder's name, found {quoted(self.folder)}")

    def __str__(self) -> str:
        """For messages, for instance `BC (ST), MoveToCorner, seed 0`."""
        return printable(f"{self.method}, {in_words(self.tasks)}, seed {self.seed}")


def in_words(tasks: tuple[str, ...]) -> str:
    """The name of the task, or the number of tasks."""
    return tasks[0] if len(tasks) == 1 else f"{len(tasks)} tasks"


def file_name(method: str) -> str:
    """A method's name in letters and digits, for names of files and folders."""
    return re.sub(r"[^a-z0-9]+", "-", method.lower()).strip("-")[:MAX_NAME]


@dataclass(frozen=True, slots=True)
class Listing:
    """What a results folder lists in `plan.json`.

    Attributes:
        runs: the planned runs.
        references: the folders of reference policies in `REFERENCES`; `None`: not recorded.
        collected: used by the studies.
        command: the words of the command that continues the plan, but for its folder.
    """

    runs: tuple[ListedRun, ...] = ()
    references: tuple[str, ...] | None = None
    collected: dict[str, Any] = field(default_factory=dict)
    command: tuple[str, ...] = ()


def read_listing(path: Path) -> Listing:
    """What the `plan.json` of a results folder lists; nothing if there is no such file.

    Raises:
        ResultsError: the file is damaged, or lists something else.
    """
    if not (path / PLAN).exists():
        return Listing()
    return read_json(path / PLAN, Listing, ResultsError, max_bytes=MAX_BYTES)
