"""The results folder of a plan (docs/experiments.md).

- `experiment.json`: format, identity of the folder, versions; digests of the demonstrations
- `plan.json`: the runs of the plan, in its order
- `progress.json`: which runs are in progress, while `.lock` is held
- `demos/`: demonstrations generated for the plan
- `references/<policy>-<task>/`: the entry of a reference policy
- `runs/<name>/`: a run's folder, with `scores.csv`, `entry.json` and last of all `result.json`
"""

import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from magical import __version__
from magical.errors import ResultsError
from magical.experiments.plan import PlannedRun
from magical.files import owned
from magical.messages import quoted
from magical.runs.folder import versions, write_json
from magical.runs.plan import PLAN, RESULT, RUNS, read_listing
from magical.untrusted import read_json

FORMAT = 1
EXPERIMENT, PROGRESS, DEMOS = "experiment.json", "progress.json", "demos"
DONE, FAILED, WAITING = "done", "failed", "waiting"  # states; the first two are in `result.json`


@dataclass(frozen=True, slots=True)
class Experiment:
    """What `experiment.json` holds.

    Attributes:
        format: the folder's format.
        id: random; distinguishes the folder from one with the same path on another machine.
        versions: the versions that it was created with.
        demonstrations: digests of the user's dataset, by task.
        generated_demonstrations: digests of the scripted experts', by folder and task.
    """

    format: int
    id: str
    versions: dict[str, str]
    demonstrations: dict[str, str] = field(default_factory=dict)
    generated_demonstrations: dict[str, str] = field(default_factory=dict)


def read_experiment(path: Path) -> Experiment:
    """The record of a results folder; raises `ResultsError` if it is missing or damaged."""
    return read_json(path / EXPERIMENT, Experiment, ResultsError)


@dataclass(frozen=True, slots=True)
class RunsInProgress:
    """What `progress.json` holds: folders of the runs in progress, and how many can be at once."""

    running: tuple[str, ...] = ()
    slots: int = 1


@dataclass(frozen=True, slots=True)
class Results:
    """A results folder that this process has locked.

    Attributes:
        path: the folder, absolute.
        id: see `Experiment`.
    """

    path: Path
    id: str

    def folder(self, run: PlannedRun) -> Path:
        """A run's folder."""
        return self.path / RUNS / run.folder

    def state(self, run: PlannedRun) -> str | None:
        """`done`, `failed`, or `None` for a run that has not been finished."""
        return read_state(self.folder(run))

    def require_same(
        self, part: str, found: Mapping[str, str], others: Callable[[str], str]
    ) -> None:
        """Record digests in a field of `experiment.json`; those already there must be the same.

        Args:
            part: the field of `Experiment`.
            found: digests of what runs learn from, by name.
            others: says, for a name whose digest differs, what runs in the folder learned from.

        Raises:
            ResultsError: a digest differs.
        """
        experiment = asdict(read_experiment(self.path))
        known = experiment[part]
        for name, digest in found.items():
            if known.get(name, digest) != digest:
                raise ResultsError(
                    f"{self.path} holds runs that learned from {others(name)}; choose another "
                    "folder (--out)"
                )
        if not found.keys() <= known.keys():
            write_json(self.path / EXPERIMENT, {**experiment, part: {**known, **found}})

    def write_plan(
        self,
        runs: Sequence[PlannedRun],
        references: Sequence[str] = (),
        command: Sequence[str] = (),
    ) -> None:
        """Write the plan's runs, reference policies and command, as `Listing` describes them."""
        listed = [asdict(run.listed()) for run in runs]
        plan = {"runs": listed, "references": list(references), "command": list(command)}
        write_json(self.path / PLAN, plan)

    def write_progress(self, running: Iterable[PlannedRun], slots: int) -> None:
        """Record which runs are in progress, and how many can be at a time."""
        names = [run.folder for run in running]
        write_json(self.path / PROGRESS, asdict(RunsInProgress(tuple(names), slots)))


@dataclass(frozen=True, slots=True)
class Outcome:
    """How the attempt to finish a run ended.

    Attributes:
        state: `interrupted` by Ctrl-C or SIGTERM, leaving a checkpoint; `no space` on the device;
            `lost` with a node of a cluster.
        seconds: how long this attempt took.
        error: the message, if it failed.
    """

    state: Literal["done", "failed", "interrupted", "no space", "lost"]
    seconds: float = 0.0
    error: str = ""


@contextmanager
def opened(path: Path, runs: Sequence[PlannedRun]) -> Iterator[Results]:
    """Lock a results folder for the runs of a plan; it is created if missing.

    Raises:
        ResultsError: the folder holds other files, or results of another plan or another version;
            another process runs a plan in it; there is no space left.
    """
    path = path.absolute()
    if not is_results(path) and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise ResultsError(f"{path}: expected a new or an empty folder; choose another one")
    with owned(path, ResultsError, "runs a plan in this folder"):
        if is_results(path):
            check_results(path, runs)
            (path / PROGRESS).unlink(missing_ok=True)  # left by a command that was killed
        else:
            write_json(path / EXPERIMENT, asdict(Experiment(FORMAT, uuid.uuid4().hex, versions())))
        yield Results(path, read_experiment(path).id)


def is_results(path: Path) -> bool:
    """Whether a path is a results folder."""
    return (path / EXPERIMENT).is_file()


def check_results(path: Path, runs: Sequence[PlannedRun]) -> None:
    """Check that an existing results folder is of this version, and of the plan of these runs.

    A plan may have changed since; it is another one if it has none of the earlier methods.

    Raises:
        ResultsError: the folder is of another version, or of another plan.
    """
    # A folder of another version may have other fields.
    found = read_json(path / EXPERIMENT, dict[str, Any], ResultsError)
    versions_then, written_in = found.get("versions"), found.get("format")
    version = versions_then.get("magical") if isinstance(versions_then, dict) else None
    if (written_in, version) != (FORMAT, __version__):
        raise ResultsError(
            f"{path} holds results of magical {version} (format {written_in}), this is "
            f"magical {__version__} (format {FORMAT}): their scores may differ. Choose another "
            "folder (--out), or install that version"
        )
    methods = {run.method for run in read_listing(path).runs}
    if methods and not methods & {run.method for run in runs}:
        raise ResultsError(
            f"{path} holds results of another plan, with the methods {', '.join(sorted(methods))}; "
            "choose another folder (--out)"
        )


def run_folders(path: Path) -> list[Path]:
    """The folders of all runs in a results folder, including those of earlier plans."""
    return sorted(folder for folder in (path / RUNS).glob("[!.]*") if folder.is_dir())


def read_state(folder: Path) -> str | None:
    """`done`, `failed`, or `None` for a run that has not been finished; raises `ResultsError`."""
    return read_result(folder).get("state")


def read_result(folder: Path) -> dict[str, Any]:
    """A run's final record, with its `state`; empty for a run that has not been finished.

    Raises:
        ResultsError: the record is damaged.
    """
    if not (folder / RESULT).is_file():
        return {}
    record = read_json(folder / RESULT, dict[str, Any], ResultsError)
    if (state := record.get("state")) not in (DONE, FAILED):
        raise ResultsError(
            f"{folder / RESULT}: expected a state, {DONE} or {FAILED}, found {quoted(state)}; "
            "remove the file to finish the run again"
        )
    return record


def planned_states(path: Path, runs: Sequence[PlannedRun]) -> list[str]:
    """The state of each run in a folder that need not exist: `done`, `failed` or `waiting`.

    Raises:
        ResultsError: the folder could not be used for these runs.
    """
    if is_results(path):
        check_results(path, runs)
        return [read_state(path / RUNS / run.folder) or WAITING for run in runs]
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise ResultsError(f"{path}: expected a new or an empty folder; choose another one")
    return [WAITING] * len(runs)
