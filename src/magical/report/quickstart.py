"""The main job from nothing to a result: demonstrations, training, evaluation, the page."""

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from magical import __version__
from magical.demos.generate import generate
from magical.demos.store.dataset import Dataset
from magical.evaluation import (
    Entry,
    Policy,
    environments,
    evaluate,
    load_policy,
)
from magical.evaluation.policy import is_privileged
from magical.evaluation.rollouts import observation_for
from magical.files import write_atomically
from magical.learning import NetworkPolicy, find_algorithm, train
from magical.processes import available_cores
from magical.report.clips import png, record_clips
from magical.report.contact_sheet import Pixels, contact_sheet
from magical.report.curves import learning_curves
from magical.report.page import Page
from magical.report.tables import Table, task_table

TASKS = ("MoveToRegion", "MoveToCorner")
PUBLISHED = ("BC (ST)",)
TOP_UP = 1_000_000  # times the demonstrations there are: seeds' distance from the first ones'
OURS, EXPERT, RANDOM = "BC quick", "scripted expert", "random policy"


@dataclass(frozen=True, slots=True)
class Settings:
    """What a quickstart does, and where."""

    out: Path
    seed: int = 0
    tasks: Sequence[str] = TASKS
    demos: int = 25  # of each task's Demo variant
    rollouts: int = 100  # on each variant
    batches: int | None = None  # of training, in place of the preset's
    workers: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "out", Path(self.out))


@dataclass
class Clock:
    """How long each part took, and who is told when it begins."""

    say: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Announce and time a part."""
        self.say(f"{name} ...")
        began = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - began


def quickstart(settings: Settings, say: Callable[[str], None]) -> tuple[list[Table], Path]:
    """Run everything; returns the tables and where the page is.

    What an interrupted or earlier quickstart with the same settings has left in the folder is
    taken up, not done again.

    Raises:
        RunFolderError, DatasetError: the folder holds something else.
    """
    clock = Clock(say)
    with clock.part(f"{settings.demos} demonstrations each of {' and '.join(settings.tasks)}"):
        make_demonstrations(settings)
    policies: dict[str, NetworkPolicy] = {}
    for task in settings.tasks:
        with clock.part(f"training on {task}"):
            policies[task] = train_policy(settings, task)
    entries: list[Entry] = []
    for task, policy in policies.items():
        with clock.part(f"evaluation on all variants of {task}"):
            entries += evaluate_all(settings, task, policy)
    tables = [
        task_table(task, [e for e in entries if _is_of(e, task)], PUBLISHED)
        for task in settings.tasks
    ]
    with clock.part("the page"):
        page = settings.out / "report.html"
        sheet = contact_sheet()
        with write_atomically(settings.out / "contact-sheet.png") as file:
            file.write(png(sheet))
        _page(settings, policies, tables, sheet, clock).write(page)
    say(f"done in {sum(clock.seconds.values()):.0f} s")
    return tables, page


def make_demonstrations(settings: Settings) -> Path:
    """Expert demonstrations of each task's Demo variant, as far as they are not there yet."""
    folder = settings.out / "demos"
    there = Dataset.open(folder) if folder.exists() else None
    for task in settings.tasks:
        have = len(there.filter(task=task)) if there else 0
        if have < settings.demos:
            # What an interrupted quickstart has left is topped up with episodes of other seeds.
            seed = settings.seed + TOP_UP * have
            missing = settings.demos - have
            (demo,) = environments([task], ["Demo"])
            generate(demo, missing, folder, seed=seed, workers=settings.workers)
    return folder


def train_policy(settings: Settings, task: str) -> NetworkPolicy:
    """Behavioural cloning, preset `quick`, on all demonstrations of the task."""
    folder = run_folder(settings, task)
    changed = {} if settings.batches is None else {"batches": settings.batches}
    config = find_algorithm("bc").config.preset(
        "quick",
        tasks=(task,),
        demos=str(settings.out / "demos"),
        num_demos=settings.demos,
        seed=settings.seed,
        **changed,
    )
    done = train(config, folder, resume=(folder / "config.json").exists(), progress=True)
    if done.interrupted:
        raise KeyboardInterrupt
    return done.policy()


def run_folder(settings: Settings, task: str) -> Path:
    """Where a task's training run is."""
    return settings.out / f"bc-{task}"


def evaluate_all(settings: Settings, task: str, trained: Policy) -> list[Entry]:
    """The trained policy's, the expert's and the random policy's scores on all variants."""
    folder = settings.out / "evaluation"
    policies = {OURS: trained, EXPERT: load_policy("expert"), RANDOM: load_policy("random")}
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
        entry.write(folder / f"{method.replace(' ', '-')}-{task}")
        entries.append(entry)
    return entries


def _is_of(entry: Entry, task: str) -> bool:
    return entry.scores[0].env_id.task == task


def _page(
    settings: Settings,
    policies: dict[str, NetworkPolicy],
    tables: Sequence[Table],
    sheet: Pixels,
    clock: Clock,
) -> Page:
    facts = {
        "demonstrations": f"{settings.demos} of each task's Demo variant, by the scripted expert",
        "training": "behavioural cloning, preset quick, one policy for each task, pixels "
        f"({policies[settings.tasks[0]].observation})",
        "evaluation": f"{settings.rollouts} rollouts on each variant, fixed seeds",
        "published rows": "appendix, Table 5: ten human demonstrations, 20,000 batches, five runs",
        "seed": str(settings.seed),
        "versions": f"magical {__version__}, Python {platform.python_version()}",
        "machine": f"{platform.machine()}, {available_cores()} cores",
        **{f"seconds for {name}": f"{spent:.0f}" for name, spent in clock.seconds.items()},
    }
    return Page(
        title="MAGICAL quickstart",
        subtitle="A policy is trained on demonstrations of the Demo variant alone, then has to do "
        "the same where something else has changed: the less a score drops, the better it "
        "generalises.",
        tables=tables,
        rollouts=settings.rollouts,
        curves=learning_curves({task: run_folder(settings, task) for task in settings.tasks}),
        reels={
            f"{OURS} on {task}": record_clips(policy, environments([task]))
            for task, policy in policies.items()
        },
        sheet=sheet,
        facts=facts,
    )
