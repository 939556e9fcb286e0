"""How long training the runs of a plan would take, from a few updates of each method."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from magical_baselines import train
from magical_baselines.experiments.demonstrations import prepare_demonstrations
from magical_baselines.experiments.plan import PlannedRun

UPDATES = 6  # of each method; the first is not counted
UNITS = (("day", 86_400.0), ("hour", 3_600.0), ("minute", 60.0), ("second", 1.0))


def training_seconds(runs: Sequence[PlannedRun]) -> float:
    """The seconds of training the runs one after another here; raises what training does."""
    first = {run.method: run for run in reversed(runs)}
    with TemporaryDirectory() as name:
        each = {method: _update_seconds(run, Path(name)) for method, run in first.items()}
    return sum(each[run.method] * run.config.num_updates for run in runs)


def _update_seconds(run: PlannedRun, folder: Path) -> float:
    """The time of an update, measured on the run's first task."""
    config = run.config.replace(tasks=run.tasks[:1])
    wanted = config.to_dict()
    source = replace(run.source, expert_demos=run.source.expert_demos and wanted["num_demos"])
    demos = prepare_demonstrations([replace(run, config=config, source=source)], folder)
    settings = {"demos": str(demos), "log_every": 1}
    config = config.replace(**{name: settings[name] for name in settings if name in wanted})
    times: list[float] = []
    train(
        config,
        folder / run.folder,
        stop_after=UPDATES,
        callback=lambda step, metrics: times.append(time.perf_counter()),
    )
    return (times[-1] - times[0]) / max(1, len(times) - 1)


def in_words(seconds: float) -> str:
    """A duration as a person would say it, such as `about 3 hours`."""
    name, size = next(unit for unit in UNITS if seconds >= 1.5 * unit[1] or unit[1] == 1)
    number = round(seconds / size, -1 if seconds > 20 * size else None)
    return f"about {number:,.0f} {name}{'s' * (number != 1)}"
