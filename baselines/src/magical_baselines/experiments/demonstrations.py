"""The demonstrations of an experiment: the user's dataset, the scripted experts', or both."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

from magical.demos.generate import MAX_DROPPED, generate
from magical.demos.store.dataset import Dataset
from magical.demos.store.manifest import ManifestEntry
from magical.demos.store.repair import open_repaired
from magical.demos.store.writer import DatasetWriter
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, DemonstrationsError, WorkerDiedError
from magical.evaluation import environments
from magical_baselines.config import DemonstrationConfig
from magical_baselines.experiments.plan import DemonstrationSource, PlannedRun
from magical_baselines.experiments.results import DEMOS, Results, read_experiment


def generate_missing(folder: Path, tasks: Iterable[str], count: int, **settings: Any) -> None:
    """Generate expert demonstrations of each task's Demo variant until it has `count`.

    They are the same whether or not an earlier call was interrupted. `settings` are those of
    `magical.demos.generate.generate`.

    Raises:
        DatasetError, NoExpertError: see `magical.demos.generate.generate`.
    """
    existing = _kept(folder)
    for task in tasks:
        seeds = [entry.seed for entry in existing if entry.task == task]
        first = _next_attempt(folder, seeds, count) if seeds else 0
        if len(seeds) < count:
            (demo,) = environments([task], ["Demo"])
            generate(demo, count - len(seeds), folder, first=first, **settings)


def _next_attempt(folder: Path, seeds: Sequence[int | None], count: int) -> int:
    """The number of the attempt after the one that gave the last of `seeds`.

    `count` is the number of demonstrations wanted in all. Raises `DatasetError` if the last seed is
    not in the series.
    """
    # Every call may drop MAX_DROPPED for each demonstration that it has to generate.
    for number in range((MAX_DROPPED + 1) * count * len(seeds) + 1):
        if episode_seed(0, number) == seeds[-1]:
            return number + 1
    raise DatasetError(
        f"{folder}: expected demonstrations generated with seed 0, found one of scene {seeds[-1]}; "
        "remove the folder or choose another"
    )


def require_same_demonstrations(runs: Sequence[PlannedRun], results: Results) -> None:
    """Check that finished runs learned from the dataset that the plan names now.

    Raises:
        DatasetError: the dataset is damaged. A missing one is not read.
        ResultsError: they learned from other demonstrations.
    """
    for config in [run.config for run in runs if run.source.dataset][:1]:
        if isinstance(config, DemonstrationConfig) and Path(config.demos).exists():
            known = read_experiment(results.path).demonstrations
            _require_same(Dataset.open(Path(config.demos)), known, results)


def open_dataset(runs: Sequence[PlannedRun], results: Results) -> Dataset | None:
    """The user's dataset that runs learn from; `None` if they do not learn from one.

    Raises:
        DatasetError: it is missing or damaged.
        DemonstrationsError: it has too few demonstrations for a run.
        ResultsError: the results folder holds runs that learned from other demonstrations.
    """
    counts, source, folder = _wanted(runs)
    if not source.dataset:
        return None
    dataset = Dataset.open(Path(folder).absolute())
    _require_enough(dataset, counts if source.expert_demos is None else dict.fromkeys(counts, 1))
    _require_same(dataset, list(counts), results)
    return dataset


def _wanted(runs: Iterable[PlannedRun]) -> tuple[dict[str, int], DemonstrationSource, str]:
    """The most demonstrations of each task that any run needs, their source, and the dataset."""
    counts: dict[str, int] = {}
    source, folder = DemonstrationSource(), ""
    for run in runs:
        wanted = run.config
        if isinstance(wanted, DemonstrationConfig):
            folder, source = wanted.demos, run.source  # the plan's
            counts |= {task: max(wanted.num_demos, counts.get(task, 0)) for task in run.tasks}
    return counts, source, folder


def prepare_demonstrations(
    runs: Sequence[PlannedRun],
    results: Results,
    workers: int | None,
    progress: Callable[[int], None],
) -> Path | None:
    """The dataset that the runs of a plan learn from; `None` if they need no demonstrations.

    `progress` is called after each demonstration that is generated.

    Raises:
        DatasetError, DemonstrationsError, ResultsError: see `open_dataset`.
    """
    counts, source, _ = _wanted(runs)
    if not counts:
        return None
    tasks = list(counts)
    dataset = open_dataset(runs, results)
    if dataset is not None and source.expert_demos is None:
        return dataset.path
    generated = _generated(source, tasks, results, workers, progress)
    if dataset is None:
        return generated.path
    pooled = results.path / DEMOS / f"dataset-and-{generated.path.name}"
    _pool([dataset, generated], tasks, pooled)
    _require_enough(Dataset.open(pooled), counts)
    return pooled


def _generated(
    source: DemonstrationSource,
    tasks: Iterable[str],
    results: Results,
    workers: int | None,
    progress: Callable[[int], None],
) -> Dataset:
    """The scripted experts' demonstrations; missing ones are generated."""
    assert source.expert_demos is not None
    parts = (f"{name.replace('_', '-')}-{value:g}" for name, value in source.generation.items())
    folder = results.path / DEMOS / "-".join([f"expert-{source.expert_demos}", *parts])
    settings = {**source.generation, "workers": workers, "progress": progress}
    try:
        generate_missing(folder, tasks, source.expert_demos, **settings)
    except WorkerDiedError:  # what it had made stays; one killed process does not end the plan
        generate_missing(folder, tasks, source.expert_demos, **settings)
    dataset = Dataset.open(folder)
    digests = {f"{folder.name}/{task}": _digest_of_actions(dataset, task) for task in tasks}
    _require_known(digests, dataset, results, "generated_demonstrations")
    return dataset


def _pool(datasets: Sequence[Dataset], tasks: Iterable[str], folder: Path) -> None:
    """Copy each task's Demo demonstrations from the datasets, one after another, into one dataset.

    What an interrupted call has copied is kept. Within a task the order is always the same, and so
    is what a run samples.
    """
    copied = Counter(entry.task for entry in _kept(folder))
    writer = DatasetWriter(folder)
    for task in tasks:
        all_of_task = chain.from_iterable(d.filter(task=task, variant="Demo") for d in datasets)
        for trajectory in islice(all_of_task, copied[task], None):
            writer.append(trajectory)


def _kept(folder: Path) -> list[ManifestEntry]:
    """The Demo demonstrations of a dataset, which need not exist.

    If a process was killed between writing a file and listing it, the dataset is repaired.
    """
    return _demos(open_repaired(folder)) if folder.exists() else []


def _demos(dataset: Dataset) -> list[ManifestEntry]:
    return [entry for entry in dataset.entries if entry.variant == "Demo"]


def _require_enough(dataset: Dataset, counts: Mapping[str, int]) -> None:
    """Raise `DemonstrationsError` unless the dataset has at least these counts of each task."""
    found = Counter(entry.task for entry in _demos(dataset))
    for task, count in counts.items():
        if found[task] < count:
            raise DemonstrationsError(
                f"{dataset.path}: expected at least {count} demonstrations of {task} (Demo), "
                f"found {found[task]}; add demonstrations, give another folder (--demos), or lower "
                "num_demos in the plan"
            )


def _require_same(dataset: Dataset, tasks: Iterable[str], results: Results) -> None:
    """Record digests of the user's dataset, which must equal those of runs in the folder."""
    found = {task: _digest(dataset, task) for task in tasks}
    _require_known(found, dataset, results, "demonstrations")


def _require_known(
    found: Mapping[str, str], dataset: Dataset, results: Results, field: str
) -> None:
    results.require_same(
        field,
        found,
        lambda name: (
            f"other demonstrations of {name.rpartition('/')[2]} than those in {dataset.path}"
        ),
    )


def _digest(dataset: Dataset, task: str) -> str:
    sums = [entry.sha256 for entry in _demos(dataset) if entry.task == task]
    return hashlib.sha256("\n".join(sums).encode()).hexdigest()


def _digest_of_actions(dataset: Dataset, task: str) -> str:
    """The same for generated demonstrations, whose files differ in the time of recording."""
    digest = hashlib.sha256()
    for trajectory in dataset.filter(task=task, variant="Demo"):
        for column in (trajectory.actions, trajectory.labels):
            digest.update(column.astype("<i8" if column.ndim == 1 else "<f8").tobytes())
    return digest.hexdigest()
