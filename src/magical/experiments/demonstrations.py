"""The demonstrations of an experiment: a dataset of the user's, or the scripted experts'."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from magical.demos.generate import generate
from magical.demos.store.dataset import Dataset
from magical.demos.store.repair import repair
from magical.errors import DatasetError, DemonstrationsError, ResultsError
from magical.evaluation import environments
from magical.experiments.plan import PlannedRun
from magical.experiments.results import DEMOS, EXPERIMENT, Results
from magical.learning.config import ImitationConfig
from magical.runs.folder import read_json, write_json

DIGESTS = "demonstrations"  # in `experiment.json`: task -> digest


def generate_missing(
    folder: Path, tasks: Iterable[str], count: int, *, seed: int = 0, workers: int | None = None
) -> None:
    """Generate those of `count` expert demonstrations of each task's Demo variant that are missing.

    They are the same whether or not an earlier call was interrupted.

    Raises:
        DatasetError, NoExpertError: see `magical.demos.generate.generate`.
    """
    existing = _counts(_repaired(folder)) if folder.exists() else Counter()
    for task in tasks:
        first = existing[task]
        if first < count:
            (demo,) = environments([task], ["Demo"])
            generate(demo, count - first, folder, seed=seed, first=first, workers=workers)


def prepare_demonstrations(
    runs: Sequence[PlannedRun], results: Results, workers: int | None = None
) -> Path | None:
    """The dataset that the runs of a plan learn from; `None` if they learn from none.

    Raises:
        DatasetError: there is no dataset, or a damaged one.
        DemonstrationsError: it has too few demonstrations for a run.
        ResultsError: the results folder holds runs that learned from others.
    """
    imitating = [(run, run.config) for run in runs if isinstance(run.config, ImitationConfig)]
    if not imitating:
        return None
    first, config = imitating[0]
    tasks = list(dict.fromkeys(task for run, _ in imitating for task in run.tasks))
    count = first.expert_demos
    if count is not None:
        folder = results.path / DEMOS / f"expert-{count}"
        generate_missing(folder, tasks, count, workers=workers)
        return folder
    folder = Path(config.demos).absolute()
    dataset = Dataset.open(folder)
    _require_enough(dataset, [config for _, config in imitating])
    _require_same(dataset, tasks, results)
    return folder


def _repaired(folder: Path) -> Dataset:
    """A generated dataset; a kill between writing a file and listing it is mended."""
    try:
        return Dataset.open(folder)
    except DatasetError:
        repair(folder)
        return Dataset.open(folder)


def _counts(dataset: Dataset) -> Counter[str]:
    """The number of demonstrations of each task's Demo variant."""
    return Counter(entry.task for entry in dataset.entries if entry.variant == "Demo")


def _require_enough(dataset: Dataset, configs: Iterable[ImitationConfig]) -> None:
    counts = _counts(dataset)
    for config in configs:
        for task in config.tasks:
            if counts[task] < config.num_demos:
                raise DemonstrationsError(
                    f"{dataset.path}: expected at least {config.num_demos} demonstrations of "
                    f"{task} (Demo), found {counts[task]}; add demonstrations, give another folder "
                    "(--demos), or lower num_demos in the plan"
                )


def _require_same(dataset: Dataset, tasks: Iterable[str], results: Results) -> None:
    """Record a dataset's digests, which must be those of earlier runs in the folder."""
    experiment = read_json(results.path / EXPERIMENT)
    known = experiment.get(DIGESTS, {})
    found = {task: _digest(dataset, task) for task in tasks}
    for task, digest in found.items():
        if known.get(task, digest) != digest:
            raise ResultsError(
                f"{results.path} holds runs that learned from other demonstrations of {task} than "
                f"those in {dataset.path}; choose another folder (--out)"
            )
    if not found.keys() <= known.keys():
        write_json(results.path / EXPERIMENT, {**experiment, DIGESTS: {**known, **found}})


def _digest(dataset: Dataset, task: str) -> str:
    sums = [e.sha256 for e in dataset.entries if e.task == task and e.variant == "Demo"]
    return hashlib.sha256("\n".join(sums).encode()).hexdigest()
