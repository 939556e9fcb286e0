"""Run folders, their metrics and plans as plain files; what entries state about their making.

A reader of a run needs neither PyTorch nor the code that made it.
"""

import platform
import re
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from magical import __file__ as PACKAGE
from magical import __version__, files
from magical.errors import RunFolderError
from magical.files import parse_json, read_bounded, reading
from magical.files import write_json as write_json
from magical.messages import printable, quoted
from magical.plugins import distributions
from magical.processes import available_cores

# In the folder of a run:
CONFIG = "config.json"
RECORD = "run.json"  # versions, demonstrations with SHA-256 sums, device and precision
METRICS = "metrics.jsonl"  # one JSON object per line
CHECKPOINT = "checkpoint.safetensors"  # the newest
CURVES = "learning-curves.png"
TENSORBOARD = "tensorboard"  # a folder with the metrics again, on request
RESULT = "result.json"  # the final record of a plan's run

# In a results folder:
PLAN = "plan.json"  # the planned runs
RUNS = "runs"  # the folder that holds the run folders
REFERENCES = "references"  # a folder for each reference policy and task

MAX_METRICS = 1 << 28  # bytes of `metrics.jsonl`
MAX_PLAN = 1 << 26  # bytes of `plan.json`


def is_run(path: Path | str) -> bool:
    """Whether a path is a run folder."""
    try:
        return (Path(path) / CONFIG).is_file()
    except (OSError, ValueError):  # such as a name that is too long, or has a null character
        return False


def read_json(path: Path | str) -> dict[str, Any]:
    """Read a JSON object of a run; raises `RunFolderError` if it is missing or damaged."""
    return files.read_json(Path(path), dict[str, Any], RunFolderError)


def read_metrics(run: Path | str) -> list[dict[str, Any]]:
    """The metrics of a run folder, oldest first; empty if there are none yet.

    A last line that a crash has truncated is left out. Raises `RunFolderError` if any other line is
    not a JSON object with a step.
    """
    path = Path(run) / METRICS
    if not path.exists():
        return []
    with reading(path, RunFolderError):
        *lines, _ = read_bounded(path, MAX_METRICS).split(b"\n")
    rows = []
    for number, line in enumerate(lines, 1):
        where = f"{path}: line {number}"
        row = parse_json(line, dict[str, Any], where, RunFolderError)
        if not isinstance(row.get("step"), int):
            raise RunFolderError(f"{where}: expected a step, found {quoted(row)}")
        rows.append(row)
    return rows


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
    """A method's name in at most 40 letters and digits, for names of files and folders."""
    return re.sub(r"[^a-z0-9]+", "-", method.lower()).strip("-")[:40]


@dataclass(frozen=True, slots=True)
class Listing:
    """What a results folder lists in `plan.json`."""

    runs: tuple[ListedRun, ...] = ()
    references: tuple[str, ...] | None = None  # folders in `REFERENCES`; `None`: not recorded
    collected: dict[str, Any] = field(default_factory=dict)  # used by the studies
    command: tuple[str, ...] = ()  # that continues the plan, but for its folder


def read_listing(path: Path) -> Listing:
    """What a results folder lists, nothing without `PLAN`; raises `RunFolderError` if damaged."""
    if not (path / PLAN).exists():
        return Listing()
    return files.read_json(path / PLAN, Listing, RunFolderError, max_bytes=MAX_PLAN)


def provenance() -> dict[str, Any]:
    """Versions, the commit of the package's source (`None` if unknown) and the machine."""
    return {"versions": versions(), "commit": source_commit(), "machine": machine()}


def versions() -> dict[str, str]:
    """Versions of what results may depend on: Python, this package, libraries, plug-ins."""
    found = {"magical": __version__, "python": platform.python_version()}
    for name in ("torch", "numpy", "pymunk", "numba", "safetensors"):
        with suppress(metadata.PackageNotFoundError):  # an extra that is not installed
            found[name] = metadata.version(name)
    return {**found, **distributions()}


def machine() -> dict[str, str]:
    """This machine: name, operating system, processor, the cores that this process may use."""
    info = Path("/proc/cpuinfo")  # `platform` does not know the processor's model on Linux
    text = info.read_text(encoding="utf-8", errors="replace") if info.is_file() else ""
    model = re.search(r"^model name\s*: *(.+)$", text, re.MULTILINE)
    return {
        "name": platform.node(),
        "platform": platform.platform(terse=True),
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": str(available_cores()),
    }


@cache
def source_commit() -> str | None:
    """The commit of the package's source at the first call, with `-dirty` after local changes.

    `None` unless the package is imported from a clone and git is installed.
    """
    found, tracked = "", ["ls-files", "--error-unmatch", Path(PACKAGE).name]
    for words in (tracked, ["describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]):
        command = ["git", "-C", str(Path(PACKAGE).parent), *words]
        try:
            found = subprocess.check_output(command, stderr=subprocess.DEVNULL, text=True)
        except (OSError, subprocess.CalledProcessError):  # git is not installed, or no clone
            return None
    return found.strip()


# What a policy may have learned from: the terms of `learned_from` in entries.
DEMONSTRATIONS = "demonstrations"
RENDERED_STATES = "rendered states"
SIMULATOR = "simulator"
INTERACTION = "interaction"
SCORE = "score"
EXPERT_LABELS = "expert labels"
TEST_VARIANTS = "test variants"
EXTRA_DATA = "extra data"
OBJECT_PARSER = "object parser"
BENCHMARK_PRIOR = "benchmark prior"

# Keys of a policy's `record`: fields of `magical.evaluation.Record`.
LEARNED_FROM = "learned_from"
NUM_DEMOS = "num_demos"

SOURCES: Mapping[str, str] = {
    DEMONSTRATIONS: "demonstrations of the Demo variant",
    RENDERED_STATES: "stored Demo states rendered with other colours, shapes or walls",
    SIMULATOR: "the simulator outside Demo, without scores, or pre-training on it",
    INTERACTION: "episodes in the Demo variant, without their scores",
    SCORE: "scores of episodes in the Demo variant",
    EXPERT_LABELS: "an expert asked for actions in states that the learner visits",
    TEST_VARIANTS: "test variants, seen before the final evaluation",
    EXTRA_DATA: "data from elsewhere, such as a pre-trained network",
    OBJECT_PARSER: "a parser made for the known palette, or fitted on rendered scenes",
    BENCHMARK_PRIOR: "features or penalties chosen by those who know the tasks, or a part "
    "fitted on scenes of test variants",
}

# Tracks of what learns from Demo demonstrations: each may also use what those before it may.
TRACKS: Mapping[str, str] = {
    "P": DEMONSTRATIONS,
    "R": RENDERED_STATES,
    "X": SIMULATOR,
    "B": BENCHMARK_PRIOR,
}

# What learners that use the object parser declare. Its constants were fitted on scenes of TestAll,
# and a part fitted on scenes of test variants is a prior made for the benchmark (docs/protocol.md).
PARSER_SOURCES = (OBJECT_PARSER, BENCHMARK_PRIOR)


def track_of(names: Iterable[str]) -> str:
    """`P`, `R`, `X` or `B`: the last of `TRACKS` whose source was used; empty for all others.

    The others used another source, such as interaction, or no demonstrations. An object parser is
    declared and does not change the track.
    """
    used = set(names) - {OBJECT_PARSER}
    if DEMONSTRATIONS not in used or not used <= set(TRACKS.values()):
        return ""
    return [name for name, source in TRACKS.items() if source in used][-1]
