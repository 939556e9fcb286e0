"""The demonstrations of a plan, shared by its runs: a dataset's, the scripted experts', or both."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

from magical.demos.generate import generate
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.repair import open_repaired
from magical.demos.store.writer import DatasetWriter
from magical.envs.ids import EnvId
from magical.envs.seeds import episode_seed
from magical.errors import DemonstrationsError
from magical_baselines.config import DemonstrationConfig
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.status import DEMOS


def prepare_demonstrations(
    runs: Sequence[PlannedRun],
    out: Path,
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Path | None:
    """The dataset that the runs of a plan learn from; `None` if they need no demonstrations.

    Missing ones are generated in the results folder `out`, by `workers` processes; they are the
    same whether or not an earlier call was interrupted. `progress` is called after each.

    Raises:
        DatasetError: the user's dataset is missing or damaged, or too few attempts succeed.
        DemonstrationsError: it has too few demonstrations for a run.
    """
    counts: dict[str, int] = {}
    for run in runs:
        if isinstance(wanted := run.config, DemonstrationConfig):
            counts |= {task: max(wanted.num_demos, counts.get(task, 0)) for task in run.tasks}
            source, given = run.source, Path(wanted.demos).absolute()  # all have the plan's
    if not counts:
        return None
    if source.dataset:
        alone = source.expert_demos is None
        _require_enough(Dataset.open(given), counts if alone else dict.fromkeys(counts, 1))
    if source.expert_demos is None:
        return given
    parts = (f"{name.replace('_', '-')}-{value:g}" for name, value in source.generation.items())
    folder = out / DEMOS / "-".join([f"expert-{source.expert_demos}", *parts])
    settings = {**source.generation, "workers": workers, "progress": progress}
    for task in counts:
        _generate(folder, task, source.expert_demos, **settings)
    if not source.dataset:
        return folder
    pooled = out / DEMOS / f"dataset-and-{folder.name}"
    _pool([Dataset.open(given), Dataset.open(folder)], counts, pooled)
    _require_enough(Dataset.open(pooled), counts)
    return pooled


def _generate(folder: Path, task: str, number: int, **settings: Any) -> None:
    """Generate demonstrations of a task until there are `number`, in the order of the attempts."""
    seeds = [entry.seed for entry in _kept(folder) if entry.task == task]
    first = 0
    if seeds:  # the attempt after the one that gave the last
        first = next(i for i in count(1) if episode_seed(0, i - 1) == seeds[-1])
    if len(seeds) < number:
        generate(EnvId(task, "Demo"), number - len(seeds), folder, first=first, **settings)


def _pool(datasets: Sequence[Dataset], tasks: Iterable[str], folder: Path) -> None:
    """Copy each task's demonstrations from the datasets, one after another, into one dataset.

    Within a task the order is always the same, and so is what a run samples.
    """
    copied = Counter(entry.task for entry in _kept(folder))
    writer = DatasetWriter(folder)
    for task in tasks:
        all_of_task = chain.from_iterable(d.filter(task=task, variant="Demo") for d in datasets)
        for trajectory in islice(all_of_task, copied[task], None):
            writer.append(trajectory)


def _kept(folder: Path) -> Sequence[ManifestEntry]:
    """What a dataset, which need not exist, has been left with by a process that was killed."""
    return open_repaired(folder).entries if folder.exists() else []


def _require_enough(dataset: Dataset, counts: Mapping[str, int]) -> None:
    found = Counter(entry.task for entry in dataset.entries if entry.variant == "Demo")
    for task, number in counts.items():
        if found[task] < number:
            raise DemonstrationsError(
                f"{dataset.path}: expected at least {number} demonstrations of {task} (Demo), "
                f"found {found[task]}; add demonstrations, give another folder (--demos), or lower "
                "num_demos in the plan"
            )
