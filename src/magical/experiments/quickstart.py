"""The quickstart: demonstrations, behavioural cloning and evaluation on two tasks."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from magical import __version__
from magical.evaluation import Entry, Policy, environments, evaluate, load_policy
from magical.evaluation.policy import is_privileged, observation_for
from magical.experiments.demonstrations import generate_missing
from magical.learning import NetworkPolicy, find_algorithm, is_run, train

TASKS = ("MoveToRegion", "MoveToCorner")
BC, EXPERT, RANDOM = "BC quick", "scripted expert", "random policy"


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of a quickstart."""

    out: Path
    seed: int = 0
    tasks: Sequence[str] = TASKS
    demos: int = 25  # of each task's Demo variant
    rollouts: int = 100  # on each variant
    batches: int | None = None  # of training; default: the preset's
    workers: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "out", Path(self.out))

    def run_folder(self, task: str) -> Path:
        """The run folder of a task."""
        return self.out / f"bc-{task}"


@dataclass
class Stopwatch:
    """Announces and times the parts of a job."""

    log: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Announce and time a part."""
        self.log(f"{name} ...")
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


@dataclass(frozen=True, slots=True)
class Result:
    """What a quickstart produces."""

    policies: dict[str, NetworkPolicy]  # by task
    entries: dict[str, list[Entry]]  # by task: the policy, the expert, the random policy


def quickstart(settings: Settings, stopwatch: Stopwatch) -> Result:
    """Generate demonstrations, train on them, and evaluate on all variants.

    What an earlier or interrupted quickstart with the same settings has left in the folder is
    reused.

    Raises:
        RunFolderError, DatasetError: the folder holds something else.
    """
    tasks = settings.tasks
    with stopwatch.part(f"{settings.demos} demonstrations each of {' and '.join(tasks)}"):
        generate_missing(
            settings.out / "demos",
            tasks,
            settings.demos,
            seed=settings.seed,
            workers=settings.workers,
        )
    policies: dict[str, NetworkPolicy] = {}
    for task in tasks:
        with stopwatch.part(f"training on {task}"):
            policies[task] = train_policy(settings, task)
    entries: dict[str, list[Entry]] = {}
    for task, policy in policies.items():
        with stopwatch.part(f"evaluation on all variants of {task}"):
            entries[task] = evaluate_policies(settings, task, policy)
    return Result(policies, entries)


def train_policy(settings: Settings, task: str) -> NetworkPolicy:
    """Clone all demonstrations of a task, with the preset `quick`."""
    folder = settings.run_folder(task)
    changed = {} if settings.batches is None else {"batches": settings.batches}
    config = find_algorithm("bc").config.preset(
        "quick",
        tasks=(task,),
        demos=str(settings.out / "demos"),
        num_demos=settings.demos,
        seed=settings.seed,
        **changed,
    )
    result = train(config, folder, resume=is_run(folder), progress=True)
    if result.interrupted:
        raise KeyboardInterrupt
    return result.policy()


def evaluate_policies(settings: Settings, task: str, trained: Policy) -> list[Entry]:
    """Evaluate the trained policy, the expert and the random policy on all variants of a task."""
    policies = {BC: trained, EXPERT: load_policy("expert"), RANDOM: load_policy("random")}
    entries = []
    for method, policy in policies.items():
        scores = evaluate(
            policy, environments([task]), rollouts=settings.rollouts, workers=settings.workers
        )
        entry = Entry(
            method=method,
            scores=scores,
            observation=str(observation_for(policy)),
            privileged=is_privileged(policy),
            version=__version__,
        )
        entry.write(settings.out / "evaluation" / f"{method.replace(' ', '-')}-{task}")
        entries.append(entry)
    return entries
