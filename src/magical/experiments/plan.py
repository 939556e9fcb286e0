"""A plan: which methods are trained on which tasks with which seeds, and how they are evaluated.

Plans are read from files by `magical.experiments.plan_file`; docs/experiments.md describes those.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from magical.errors import MagicalError, PlanError
from magical.evaluation.rollouts import ROLLOUTS, environments
from magical.experts import get_planner
from magical.learning import Config, find_algorithm
from magical.learning.config import ImitationConfig, options
from magical.tasks import Horizon, get_task

EXPERT = "expert"  # as `demos`: the scripted experts' demonstrations, generated for the plan
DATASET = "dataset"  # in records: demonstrations of a folder, whose path says nothing
DIGITS = 10  # of a run's identity, hexadecimal
MAX_SLUG = 40  # characters of a method's name in a folder's name


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One row of the tables: an algorithm with its settings.

    Attributes:
        name: the row's name; a name of the published tables is shown beside theirs.
        algorithm: for instance `bc`.
        preset: of the algorithm's configuration.
        multi_task: one run learns all tasks of the plan, instead of a run for each task.
        settings: fields of the configuration that differ from the preset.
    """

    name: str
    algorithm: str
    preset: str = "paper"
    multi_task: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """How the policy of every run is evaluated.

    Attributes:
        rollouts: on each variant.
        variants: names in ids; a task is evaluated on those of them that it has. Empty: all.
        horizon: `appendix`, `published` (the published code's), or a number of control steps.
        nudge: the largest shift of initial poses, in units and radians; the protocol's is 1e-9, and
            0 is for comparison with published scores (docs/protocol.md).
    """

    rollouts: int = ROLLOUTS
    variants: tuple[str, ...] = ()
    horizon: int | Literal["appendix", "published"] = "appendix"
    nudge: float = 0.0

    def steps(self, task: str) -> int:
        """The control steps of a task's episodes."""
        if isinstance(self.horizon, int):
            return self.horizon
        found = get_task(task)
        return found.horizon if self.horizon == "appendix" else found.published_horizon

    def horizon_of(self, tasks: Sequence[str]) -> Horizon:
        """The horizon as `magical.evaluation.evaluate` takes it; `None` where it is the appendix's.

        The published code's is the same for most tasks.
        """
        same = all(self.steps(task) == get_task(task).horizon for task in tasks)
        return None if same or self.horizon == "appendix" else self.horizon


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A grid of runs: methods x tasks x seeds; a multi-task method has one run for each seed.

    Attributes:
        methods: the rows of the tables.
        tasks: the tasks' names.
        seeds: of training; each also chooses the run's demonstrations.
        demos: `expert`, or a folder with a dataset.
        add_expert: add the scripted experts' demonstrations to the folder's.
        num_demos: demonstrations of each task that a run learns from.
        expert_demos: the experts' demonstrations generated of each task, to choose from.
        perturb: the share of control steps in which these have a random action.
        min_score: those that score less are dropped, and others generated.
        threads: CPU threads of each run. Scores are equal for the same number only, so it belongs
            to the plan, not to the machine.
        evaluation: of every run.
    """

    methods: tuple[Method, ...]
    tasks: tuple[str, ...]
    seeds: tuple[int, ...] = (0,)
    demos: str = EXPERT
    add_expert: bool = False
    num_demos: int = 10
    expert_demos: int = 25
    perturb: float = 0.0
    min_score: float = 0.0
    threads: int = 1
    evaluation: Evaluation = Evaluation()


@dataclass(frozen=True, slots=True)
class Source:
    """Where a run's demonstrations are sampled from; by default there are none.

    Attributes:
        dataset: whether from a dataset of the user's.
        expert_demos: the number of the scripted experts' that are generated of each task; `None`
            for none.
        perturb: the share of control steps in which these have a random action.
        min_score: the least score of these.
    """

    dataset: bool = False
    expert_demos: int | None = None
    perturb: float = 0.0
    min_score: float = 0.0

    @property
    def kind(self) -> str:
        """`dataset`, `expert`, or `dataset and expert`."""
        return " and ".join([DATASET] * self.dataset + [EXPERT] * (self.expert_demos is not None))

    @property
    def generation(self) -> dict[str, float]:
        """How the experts' are generated, where it is not the default."""
        how = {"perturb": self.perturb, "min_score": self.min_score}
        return {name: value for name, value in how.items() if value}

    def __str__(self) -> str:
        """Such as `dataset`, or `expert, perturb 0.2`."""
        how = (f"{name} {value:g}" for name, value in self.generation.items())
        return ", ".join([self.kind, *how])

    def settings(self) -> dict[str, Any]:
        """What scores depend on besides the kind."""
        return {"expert_demos": self.expert_demos, **self.generation}


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One training run of a plan, and its evaluation.

    Attributes:
        method: the method's name.
        preset: the preset that `config` was made from.
        config: of training. `demos` is the plan's; the folder is known when the run is started.
        source: of the demonstrations.
        evaluation: of the policy.
    """

    method: str
    preset: str
    config: Config
    source: Source
    evaluation: Evaluation

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that are learned, several in a multi-task run."""
        return self.config.tasks

    @property
    def seed(self) -> int:
        """The seed of training."""
        return self.config.seed

    @property
    def identity(self) -> str:
        """A digest of the name and of all that the scores depend on."""
        text = json.dumps({"method": self.method, **self.settings()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]

    @property
    def folder(self) -> str:
        """The name of the run's folder: readable, and different for different settings."""
        method = re.sub(r"[^a-z0-9]+", "-", self.method.lower()).strip("-")[:MAX_SLUG]
        tasks = self.tasks[0] if len(self.tasks) == 1 else "multi-task"
        return f"{method}-{tasks}-seed{self.seed}-{self.identity}".lstrip("-")

    def __str__(self) -> str:
        """For messages, for instance `BC (ST), MoveToCorner, seed 0`."""
        return f"{self.method}, {in_words(self.tasks)}, seed {self.seed}"

    def settings(self) -> dict[str, Any]:
        """All that the scores depend on, as plain data for JSON; datasets without their paths."""
        config = self.config.to_dict()
        if "demos" in config:
            config["demos"] = self.source.kind
        evaluation = dataclasses.asdict(self.evaluation)
        evaluation["variants"] = list(self.evaluation.variants)
        return {"config": config, **self.source.settings(), "evaluation": evaluation}


def in_words(tasks: Sequence[str]) -> str:
    """The name of the task, or the number of tasks."""
    return tasks[0] if len(tasks) == 1 else f"{len(tasks)} tasks"


def planned_runs(plan: Plan) -> list[PlannedRun]:
    """Every run of a plan, by method, then task, then seed.

    Raises:
        PlanError: a method's settings cannot be, or two runs are the same.
    """
    runs: list[PlannedRun] = []
    for number, method in enumerate(plan.methods):
        groups = [plan.tasks] if method.multi_task else [(task,) for task in plan.tasks]
        for tasks in groups:
            try:
                first = _planned_run(plan, method, tasks)
            except MagicalError as error:
                raise PlanError(f"methods[{number}] ({method.name}): {error}") from error
            runs += [replace(first, config=replace(first.config, seed=s)) for s in plan.seeds]
    _require_distinct(runs)
    return runs


def _planned_run(plan: Plan, method: Method, tasks: tuple[str, ...]) -> PlannedRun:
    """The run of a method on tasks with the plan's first seed."""
    kind = find_algorithm(method.algorithm).config
    names = {option.name for option in options(kind)}
    from_plan: dict[str, Any] = {
        "tasks": tasks,
        "seed": plan.seeds[0],
        "threads": plan.threads,
        "demos": plan.demos,
        "num_demos": plan.num_demos,
        "workers": 0 if plan.threads == 1 else plan.threads,
    }
    given = {name: value for name, value in from_plan.items() if name in names}
    config = kind.preset(method.preset, **{**given, **method.settings})
    if config.threads < 1:
        raise PlanError(f"threads: expected at least 1, found {config.threads}")
    environments(tasks, plan.evaluation.variants or None)  # raises for a task with none of them
    source = _source(plan, config) if isinstance(config, ImitationConfig) else Source()
    return PlannedRun(method.name, method.preset, config, source, plan.evaluation)


def _source(plan: Plan, config: ImitationConfig) -> Source:
    """Where the demonstrations of a run come from."""
    dataset = plan.demos != EXPERT
    if plan.add_expert and not dataset:
        raise PlanError(
            f"add_expert: expected demos, or --demos, to be a folder with a dataset, found {EXPERT}"
        )
    if dataset and not plan.add_expert:
        for name in ("perturb", "min_score"):
            if getattr(plan, name):
                raise PlanError(
                    f"{name}: expected 0 for a dataset, found {getattr(plan, name)}: it is for "
                    f'generated demonstrations (demos = "{EXPERT}", or add_expert)'
                )
        return Source(dataset=True)
    for task in config.tasks:
        get_planner(task)  # raises for a task without an expert
    if not dataset and plan.expert_demos < config.num_demos:
        raise PlanError(
            f"expert_demos: expected at least num_demos, {config.num_demos}, "
            f"found {plan.expert_demos}"
        )
    return Source(dataset, plan.expert_demos, plan.perturb, plan.min_score)


def _require_distinct(runs: Iterable[PlannedRun]) -> None:
    seen: dict[str, PlannedRun] = {}
    for run in runs:
        same = seen.setdefault(json.dumps(run.settings(), sort_keys=True), run)
        if same is not run:
            raise PlanError(f"expected each run once, found the same settings twice: {same}; {run}")
