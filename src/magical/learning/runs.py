"""Run folders: what was asked for, what it was learned from, what happened, the newest checkpoint.

- `config.json`: the configuration
- `run.json`: versions, demonstrations with SHA-256 sums, device and precision
- `metrics.jsonl`: one line of JSON a report
- `checkpoint.safetensors`: all that the next batch depends on
- `tensorboard/`: the metrics again, if asked for
"""

import json
import math
import platform
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import IO, Any, Self

import torch

from magical import __version__
from magical.errors import DivergedError, RunFolderError
from magical.files import write_atomically
from magical.learning.checkpoints import Tree, load_tree, save_tree
from magical.learning.config import Config
from magical.learning.devices import Compute, choose_precision
from magical.learning.interrupts import Interrupts
from magical.learning.progress import Progress

CONFIG = "config.json"
RECORD = "run.json"
METRICS = "metrics.jsonl"
CHECKPOINT = "checkpoint.safetensors"
TENSORBOARD = "tensorboard"

VERSIONED = ("torch", "numpy", "pymunk", "numba", "safetensors")  # what results may depend on


class Run:
    """A run in progress: the door between an algorithm and its folder.

    Attributes:
        saved: the checkpoint's tree to continue from, or `None` at the beginning.
        step: how many batches (or updates) it had behind it.
    """

    def __init__(
        self,
        folder: Path,
        *,
        progress: Progress,
        interrupts: Interrupts,
        stop_after: int | None = None,
        tensorboard: bool = False,
    ) -> None:
        self.folder = folder
        self._progress = progress
        self._interrupts = interrupts
        self.record = read_json(folder / RECORD) if (folder / RECORD).exists() else {}
        path = folder / CHECKPOINT
        self.saved: Tree | None = load_tree(path) if path.exists() else None
        self.step = int(self.saved["step"]) if self.saved else 0
        self._last = math.inf if stop_after is None else self.step + stop_after
        drop_metrics_after(folder / METRICS, self.step)
        self._metrics: IO[str] = (folder / METRICS).open("a", encoding="utf-8")
        self._board = _summary_writer(folder / TENSORBOARD, self.step) if tensorboard else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._metrics.close()
        if self._board:
            self._board.close()

    def describe(self, **facts: Any) -> None:
        """Write facts into `run.json` once; a resumed run must find the same.

        Raises `RunFolderError` if a fact has changed since the run began.
        """
        for name, fact in facts.items():
            if name in self.record and self.record[name] != fact:
                raise RunFolderError(
                    f"{self.folder}: the run began with other {name}; expected "
                    f"{_short(self.record[name])}, found {_short(fact)}"
                )
        if not set(facts) <= set(self.record):
            self._remember(facts)

    def compute(self, device: str, precision: str, step: Callable[[], torch.Tensor]) -> Compute:
        """Where and how precisely to compute: as the run began, or by `choose_precision`.

        A run that is resumed on another kind of device chooses again.
        """
        recorded = self.record.get("compute")
        if recorded and recorded["device"] == device:
            chosen = Compute(**recorded)
        else:
            chosen = choose_precision(device, precision, step)
            self._remember({"compute": chosen.to_dict()})
        chosen.set_threads()
        return chosen

    def _remember(self, facts: Mapping[str, Any]) -> None:
        self.record = {**self.record, **facts}
        write_json(self.folder / RECORD, self.record)

    def log(self, step: int, total: int, **metrics: float | str) -> None:
        """Report: a line in `metrics.jsonl`, in TensorBoard (numbers), in the progress bar."""
        line = {"step": step, **{name: _plain(value) for name, value in metrics.items()}}
        self._metrics.write(json.dumps(line) + "\n")
        self._metrics.flush()
        if self._board:
            for name, value in metrics.items():
                if not isinstance(value, str):
                    self._board.add_scalar(name, value, step)
        self._progress.update(step, total, metrics)

    def checkpoint(self, step: int, tree: Tree) -> None:
        """Replace the checkpoint by the state after `step` batches.

        Raises `DivergedError` if its weights are not all finite; the older one stays.
        """
        self.require_finite(step, tree)
        save_tree(self.folder / CHECKPOINT, {**tree, "step": step})
        self.step = step

    def require_finite(self, step: int, tree: Any) -> None:
        """Raise `DivergedError` for a number or tensor that is not finite, anywhere in `tree`."""
        if not _finite(tree):
            kept = f"the checkpoint of step {self.step}" if self.step else "no checkpoint"
            raise DivergedError(
                f"training diverged: at step {step} the loss or the weights are not finite; "
                f"{self.folder} keeps {kept}. Try a smaller learning rate or --precision float32"
            )

    def stops(self, step: int) -> bool:
        """Whether to leave a checkpoint and stop: Ctrl-C, or as many steps as were asked for."""
        return self._interrupts.seen or step >= self._last


def open_folder(path: Path, config: Config, resume: bool) -> None:
    """Make a run folder, or check that the one there is the one meant.

    Raises:
        RunFolderError: it holds another configuration, or the same and `resume` was not asked
            for; it holds other things; there is nothing to resume; it cannot be written.
    """
    wanted = config.to_dict()
    if (path / CONFIG).exists():
        found = read_json(path / CONFIG)
        different = differences(wanted, found)
        if different:
            raise RunFolderError(
                f"{path} holds a run with another configuration: {different}; choose another "
                "folder, or the same configuration to resume it"
            )
        if not resume:
            raise RunFolderError(
                f"{path} holds this run already; add --resume (resume=True) to continue it, or "
                "choose another folder"
            )
        return
    if resume:
        raise RunFolderError(f"{path}: expected a run to resume, found none")
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise RunFolderError(f"{path}: expected a new or an empty folder, found other things in it")
    write_json(path / CONFIG, wanted)
    write_json(path / RECORD, {"versions": versions(), "began": f"{datetime.now(UTC):%FT%TZ}"})


def differences(wanted: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """Which settings differ, and how; the dataset may have moved, its contents are compared."""
    names = [name for name in {**wanted, **found} if name != "demos"]
    return ", ".join(
        f"{name} {found.get(name)!r} there, {wanted.get(name)!r} asked for"
        for name in names
        if wanted.get(name) != found.get(name)
    )


def drop_metrics_after(path: Path, step: int) -> None:
    """Forget reports of steps that the checkpoint does not have: they will come again."""
    if not path.exists():
        return
    kept = [line for line in _whole_lines(path) if json.loads(line)["step"] <= step]
    with write_atomically(path) as file:
        file.write("".join(kept).encode())


def read_metrics(run: Path | str) -> list[dict[str, Any]]:
    """A run's reports, oldest first."""
    return [json.loads(line) for line in _whole_lines(Path(run) / METRICS)]


def _whole_lines(path: Path) -> Sequence[str]:
    """Lines that were written to their end; a crash may have cut the last one."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return [line for line in lines if line.endswith("}\n")]


def versions() -> dict[str, str]:
    """What a stranger needs to repeat the run."""
    found = {name: metadata.version(name) for name in VERSIONED}
    return {"magical": __version__, "python": platform.python_version(), **found}


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; raises `RunFolderError` if it is missing or damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: expected a file of a run, found {error}") from error
    if not isinstance(data, dict):
        raise RunFolderError(f"{path}: expected a JSON object, found {type(data).__name__}")
    return data


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a JSON object, indented, in one go."""
    with write_atomically(path) as file:
        file.write((json.dumps(data, indent=2) + "\n").encode())


def _finite(node: Any) -> bool:
    if isinstance(node, torch.Tensor):
        return not node.is_floating_point() or bool(torch.isfinite(node).all())
    if isinstance(node, Mapping):
        return all(map(_finite, node.values()))
    if isinstance(node, list | tuple):
        return all(map(_finite, node))
    return not isinstance(node, float) or math.isfinite(node)


def _plain(value: float | str) -> float | int | str | None:
    """A number for JSON, which knows no NaN; or a text."""
    if isinstance(value, int | str):
        return value
    return round(float(value), 6) if math.isfinite(value) else None


def _short(fact: Any) -> str:
    text = str(fact)
    return text if len(text) < 100 else f"{text[:97]}..."


def _summary_writer(folder: Path, step: int) -> Any:
    from torch.utils.tensorboard import SummaryWriter  # an extra: only who asks for it needs it

    return SummaryWriter(str(folder), purge_step=step + 1)
