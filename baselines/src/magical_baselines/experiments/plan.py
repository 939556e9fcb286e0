"""A plan: which methods are trained on which tasks with which seeds, and how they are evaluated.

docs/experiments.md describes the files of plans, which have the fields of `Plan` and `Method` as
keys.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from magical.errors import MagicalError, PlanError
from magical.evaluation import BUILT_IN
from magical.evaluation.noise import MAX_NOISE
from magical.evaluation.protocol import ROLLOUTS, Evaluation, environments
from magical.experts import get_planner
from magical.messages import quoted
from magical.plugins import require_imported
from magical.runs.plan import ListedRun, file_name
from magical.tasks import TASKS, load_task, parse_horizon
from magical.tasks.axes import full_variant
from magical.untrusted import read_toml
from magical_baselines import Config, find_algorithm
from magical_baselines.config import DemonstrationConfig, options, references

PLANS = Path(str(files("magical_baselines"))) / "plans"  # those of this package
EXPERT = "expert"  # as `demos`: demonstrations of the scripted experts, generated for the plan
DATASET = "dataset"  # in records: demonstrations from a folder, without its path
MAX_RUNS = 100_000
OF_THE_PLAN = {"tasks", "seed", "demos"}  # settings that a method cannot change

AtLeastOne = Meta(min_length=1)
Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Share = Annotated[float, Meta(ge=0, le=1)]
Seed = Annotated[int, Meta(ge=0, le=2**31 - 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One row of the tables: an algorithm with its settings."""

    # A published row's name shows both side by side.
    name: Annotated[str, Meta(min_length=1, max_length=100)]
    algorithm: str
    preset: str = ""  # of the algorithm's configuration; empty for the plan's
    multi_task: bool = False  # one run learns all tasks of the plan, instead of one for each task
    settings: dict[str, Any] = field(default_factory=dict)  # that differ from the preset


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A grid of runs: methods x tasks x seeds; a multi-task method has one run for each seed.

    Raises `PlanError`: unknown names, values out of range, or the same name twice.
    """

    methods: Annotated[tuple[Method, ...], AtLeastOne]
    tasks: Annotated[tuple[str, ...], AtLeastOne] = field(default_factory=lambda: tuple(TASKS))
    seeds: Annotated[tuple[Seed, ...], AtLeastOne] = (0,)  # each also chooses demonstrations
    demos: str = EXPERT  # or a folder with a dataset
    add_expert: bool = False  # add the scripted experts' demonstrations to the folder's
    num_demos: Count = 10  # of each task, that a run learns from
    expert_demos: Count = 25  # generated for each task, to choose from
    perturb: Share = 0.0  # share of their control steps with a random action
    min_score: Share = 0.0  # those that score less are dropped
    preset: str = "paper"  # of methods that name none
    threads: Count = 1  # CPU threads of each run; scores are equal only for the same number
    rollouts: Count = ROLLOUTS  # on each variant
    variants: tuple[str, ...] = ()  # each task is evaluated on those that it has; empty for all
    horizon: int | str | None = None  # of evaluation, as `magical.tasks.parse_horizon` takes it
    nudge: Annotated[float, Meta(ge=0, le=MAX_NOISE)] = 0.0  # of evaluation
    references: tuple[str, ...] = ()  # built-in policies that are evaluated too, such as `expert`

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "horizon", parse_horizon(self.horizon))
            for name in self.tasks:
                require_imported(name, "the plan")
            names = tuple(load_task(name).name for name in self.tasks)
            object.__setattr__(self, "tasks", names)
            variants = tuple(dict.fromkeys(map(full_variant, self.variants)))
            object.__setattr__(self, "variants", variants)
        except (MagicalError, ValueError) as error:
            raise PlanError(str(error)) from error
        if unknown := [name for name in self.references if name not in BUILT_IN]:
            raise PlanError(
                f"references: expected some of {', '.join(BUILT_IN)}, found {quoted(unknown[0])}"
            )
        if len(self.methods) * len(self.tasks) * len(self.seeds) > MAX_RUNS:
            raise PlanError(f"expected at most {MAX_RUNS} runs, found more")


def find_plan(name: str) -> Path:
    """The file of a plan of this package, such as `quick`, or at a path; or a `PlanError`."""
    for path in (PLANS / f"{name}.toml", Path(name)):
        if path.is_file():
            return path
    known = ", ".join(sorted(path.stem for path in PLANS.glob("*.toml")))
    raise PlanError(f"{name}: expected a file with a plan in TOML, or one of {known}; found none")


def read_plan(path: Path, demos: str | None = None) -> Plan:
    """Read a plan from a TOML file; `demos` replaces the file's.

    Raises `PlanError`: not TOML, unknown names, values of other types, settings that cannot be
    combined, or the same run twice.
    """
    plan = read_toml(path, Plan, PlanError)
    try:
        plan = plan if demos is None else replace(plan, demos=demos)
        planned_runs(plan)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from error
    return plan


@dataclass(frozen=True, slots=True)
class DemonstrationSource:
    """Where a run's demonstrations are sampled from; by default there are none."""

    dataset: bool = False  # whether they come from the user's dataset
    expert_demos: int | None = None  # generated for each task; `None` for none
    perturb: float = 0.0  # share of the experts' control steps that have a random action
    min_score: float = 0.0  # the lowest score that the experts' may have

    @property
    def kind(self) -> str:
        """`dataset`, `expert`, or `dataset and expert`."""
        return " and ".join([DATASET] * self.dataset + [EXPERT] * (self.expert_demos is not None))

    @property
    def generation(self) -> dict[str, float]:
        """The settings of generated demonstrations that differ from the default."""
        how = {"perturb": self.perturb, "min_score": self.min_score}
        return {name: value for name, value in how.items() if value}

    def __str__(self) -> str:
        """Such as `dataset`, or `expert, perturb 0.2`."""
        return ", ".join([self.kind, *(f"{key} {x:g}" for key, x in self.generation.items())])


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One training run of a plan, and its evaluation."""

    method: str  # its name
    preset: str  # that `config` was made from
    config: Config  # its `demos` is the plan's; the folder is known only when the run is started
    source: DemonstrationSource
    evaluation: Evaluation
    variants: tuple[str, ...] = ()  # of the evaluation, as the plan names them; empty for all

    @property
    def tasks(self) -> tuple[str, ...]:
        return self.config.tasks

    @property
    def seed(self) -> int:
        return self.config.seed

    @property
    def folder(self) -> str:
        return folder_name(self.method, self.tasks, self.seed)

    def listed(self) -> ListedRun:
        return ListedRun(self.folder, self.method, self.tasks, self.seed, self.config.num_updates)

    def __str__(self) -> str:
        """For messages, for instance `BC (ST), MoveToCorner, seed 0`."""
        return str(self.listed())

    def settings(self) -> dict[str, Any]:
        """Everything that the scores depend on, as plain data for JSON; datasets without paths."""
        config = self.config.to_dict()
        if "demos" in config:
            config["demos"] = self.source.kind
        evaluation = {
            "rollouts": self.evaluation.rollouts,
            "variants": list(self.variants),
            "horizon": self.evaluation.horizon or "appendix",
            "nudge": self.evaluation.nudge,
        }
        source = {"expert_demos": self.source.expert_demos, **self.source.generation}
        return {"config": config, **source, "evaluation": evaluation}


@dataclass(frozen=True, slots=True)
class PlannedReference:
    """The evaluation of a built-in policy on one task, beside the runs of a plan."""

    policy: str
    evaluation: Evaluation

    @property
    def folder(self) -> str:
        return f"{self.policy}-{self.evaluation.env_ids[0].task}"

    def __str__(self) -> str:
        return f"{self.policy}, {self.evaluation.env_ids[0].task}"


def folder_name(method: str, tasks: Sequence[str], seed: int) -> str:
    """The name of a run's folder, such as `bc-st-MoveToCorner-seed0`."""
    of = tasks[0] if len(tasks) == 1 else "multi-task"
    return f"{file_name(method)}-{of}-seed{seed}".lstrip("-")


def planned_runs(plan: Plan) -> list[PlannedRun]:
    """Every run of a plan, by method, then task, then seed.

    Raises `PlanError`: a method's settings are invalid, or two runs are the same.
    """
    if plan.demos == EXPERT and plan.add_expert:
        raise PlanError(f"add_expert: expected demos, or --demos, to be a folder, found {EXPERT}")
    if plan.demos != EXPERT and not plan.add_expert and (plan.perturb or plan.min_score):
        raise PlanError(
            "perturb, min_score: expected 0 for a dataset, found other numbers: they are for "
            f'generated demonstrations (demos = "{EXPERT}", or add_expert)'
        )
    runs: list[PlannedRun] = []
    for number, method in enumerate(plan.methods):
        groups = [plan.tasks] if method.multi_task else [(task,) for task in plan.tasks]
        for tasks in groups:
            try:
                first = _planned_run(plan, method, tasks)
            except MagicalError as error:
                raise PlanError(f"methods[{number}] ({method.name}): {error}") from error
            runs += [replace(first, config=replace(first.config, seed=s)) for s in plan.seeds]
    seen: dict[str, PlannedRun] = {}
    for run in runs:
        for what, key in (("folder", run.folder), ("settings", json.dumps(run.settings()))):
            if (same := seen.setdefault(key, run)) is not run:
                raise PlanError(
                    f"expected each run once, found the same {what} twice: {same}; {run}"
                )
    return runs


def planned_references(plan: Plan) -> list[PlannedReference]:
    """A plan's reference policies, one task at a time."""
    evaluations = [_evaluation(plan, (task,)) for task in plan.tasks]
    return [PlannedReference(name, each) for name in plan.references for each in evaluations]


def _planned_run(plan: Plan, method: Method, tasks: tuple[str, ...]) -> PlannedRun:
    """The run of a method on tasks with the plan's first seed."""
    require_imported(method.algorithm, "the plan")
    kind = find_algorithm(method.algorithm).config
    for name in references(kind, method.settings):
        require_imported(name, "the plan")
    if fixed := OF_THE_PLAN & method.settings.keys():
        raise PlanError(f"settings: expected {min(fixed)} in the plan instead")
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
    preset = method.preset or plan.preset
    given |= {"algorithm": method.algorithm, **method.settings}
    config = kind.preset(preset, **given)
    if config.threads < 1:
        raise PlanError(f"threads: expected at least 1, found {config.threads}")
    source = DemonstrationSource()
    if isinstance(config, DemonstrationConfig):
        source = DemonstrationSource(dataset=plan.demos != EXPERT)
        if plan.add_expert or not source.dataset:
            for task in tasks:
                get_planner(task)  # raises for a task without an expert
            source = replace(
                source,
                expert_demos=plan.expert_demos,
                perturb=plan.perturb,
                min_score=plan.min_score,
            )
        if not source.dataset and plan.expert_demos < config.num_demos:
            raise PlanError(
                f"expert_demos: expected at least num_demos, {config.num_demos}, found "
                f"{plan.expert_demos}"
            )
    evaluation = _evaluation(plan, tasks)
    return PlannedRun(method.name, preset, config, source, evaluation, plan.variants)


def _evaluation(plan: Plan, tasks: Sequence[str]) -> Evaluation:
    """How runs on some tasks are evaluated; `UnknownNameError` if one has none of the variants."""
    return Evaluation(
        env_ids=tuple(environments(tasks, plan.variants or None)),
        rollouts=plan.rollouts,
        horizon=parse_horizon(plan.horizon),
        nudge=plan.nudge,
    )
