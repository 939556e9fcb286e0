"""A task: its Demo scene, how variants change it, and how final states are scored."""

import operator
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Final, Literal

import numpy as np

from magical.errors import (
    InvalidConfigError,
    InvalidSceneError,
    InvalidTaskError,
    PlacementError,
    UnknownNameError,
)
from magical.messages import quoted
from magical.scene import Dynamics, Poses, Scene
from magical.tasks.axes import TEST_ALL, VARIANTS, Axis
from magical.tasks.placement import Placement, sample_placement, validate_scene

MAX_SCENES = 1000  # sampled at most for one episode; the paper's tasks need only one

Horizon = int | Literal["published"] | None  # steps, the published code's, the appendix's
APPENDIX: Final = "appendix"  # names of horizons
PUBLISHED: Final = "published"
MAX_HORIZON = int(np.iinfo(np.int64).max)


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task of the benchmark.

    Raises `InvalidTaskError` for an impossible name or horizon, and `InvalidSceneError` for a Demo
    scene that does not fit the task; registering it finds overlaps.
    """

    name: str  # as in environment ids, for instance MoveToCorner
    summary: str  # one line: what the robot must do
    rule: str = ""  # how final states are scored, in English; formulas are indented
    section: str = ""  # of the appendix; tasks are listed in its order, those without one last
    horizon: int  # control steps (appendix A.2)
    published_horizon: int | None = None  # the published code's, if different
    demo: Scene  # the Demo variant's scene (docs/specification.md, section 8)
    axes: Axis  # the axes that its variants may change (appendix, Table 2)
    randomise_fn: Callable[[Scene, Axis, np.random.Generator], Scene]  # samples all but poses
    placement: Placement = field(default_factory=Placement)  # how regions and blocks are placed
    score_fn: Callable[[Scene, Poses], float]  # the appendix's score of a final state, 0 to 1
    published_score_fn: Callable[[Scene, Poses], float] | None = None  # the published code's
    instruction_fn: Callable[[Scene], str] | None = None  # in English; by default the summary
    min_blocks: int = 0  # over all variants, as the following
    max_blocks: int = 0
    min_regions: int = 0
    max_regions: int = 0
    validate_fn: Callable[[Scene], str] = lambda scene: ""  # why a scene does not fit, or ""

    def __post_init__(self) -> None:
        if not self.name.isalnum() or self.horizon < 1:
            raise InvalidTaskError(
                "task: expected a name of letters and digits, as in environment ids, and a "
                f"positive horizon, found {self.name!r} and {self.horizon}"
            )
        if problem := self.problem(self.demo):
            raise InvalidSceneError(f"{self.name}: {problem}")

    @property
    def has_two_horizons(self) -> bool:
        """Whether the published code's horizon differs from the appendix's."""
        return self.resolve_horizon("published") != self.horizon

    def resolve_horizon(self, horizon: Horizon) -> int:
        """The control steps of an episode: a given number, the published code's, the appendix's."""
        if horizon == "published":
            horizon = self.published_horizon
        return self.horizon if horizon is None else horizon

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the variants that the task has, in the order of `VARIANTS`."""
        return tuple(
            name for name, axes in VARIANTS.items() if name == TEST_ALL or axes in self.axes
        )

    def axes_of(self, variant: str) -> Axis:
        """The axes along which a variant differs from Demo; `UnknownNameError` if it is lacking.

        TestAll changes everything that the task supports, and jitters poses only if they cannot be
        sampled freely (docs/specification.md, section 8).
        """
        if variant not in self.variants:
            close = () if variant in VARIANTS else get_close_matches(str(variant), self.variants)
            raise UnknownNameError(
                f"{self.name} has no variant {variant!r}; it has: {', '.join(self.variants)}"
                + (f"; did you mean {close[0]!r}?" if close else "")
            )
        axes = VARIANTS[variant] & self.axes
        if variant == TEST_ALL and Axis.LAYOUT not in axes:
            return axes | self.axes & Axis.JITTER
        return axes

    def sample(self, variant: str, rng: np.random.Generator) -> tuple[Scene, Dynamics]:
        """Sample an episode's initial scene and dynamics.

        Raises `UnknownNameError` if the task lacks the variant, `PlacementError` if no scene fits.
        """
        axes = self.axes_of(variant)
        for _ in range(MAX_SCENES):
            scene = self.randomise_fn(self.demo, axes, rng)
            scene = sample_placement(scene, axes, rng, self.placement)
            if not (problem := self.problem(scene)):
                return scene, Dynamics.sample(rng) if Axis.DYNAMICS in axes else Dynamics()
        raise PlacementError(f"{self.name}, {variant}: none of {MAX_SCENES} scenes fits: {problem}")

    def score(self, scene: Scene, poses: Poses) -> float:
        """The appendix's score, 0 to 1, of the poses at the end of an episode from `scene`."""
        return self.score_fn(scene, poses)

    def published_code_score(self, scene: Scene, poses: Poses) -> float:
        """As `score`, by the published code's rule (docs/specification.md, section 9)."""
        return (self.published_score_fn or self.score_fn)(scene, poses)

    def instruction(self, scene: Scene) -> str:
        """The English instruction for an episode that starts from `scene`."""
        return self.instruction_fn(scene) if self.instruction_fn else self.summary

    def problem(self, scene: Scene) -> str:
        """Why a scene does not fit the task, apart from overlaps; or an empty string."""
        for what, found, least, most in (
            ("blocks", len(scene.blocks), self.min_blocks, self.max_blocks),
            ("regions", len(scene.regions), self.min_regions, self.max_regions),
        ):
            if found < least:
                return f"expected at least {least} {what}, found {found}; add some"
            if found > most:
                return f"expected at most {most} {what}, found {found}; remove some"
        return self.validate_fn(scene) or self.placement.problem(scene)

    def validate(self, scene: Scene) -> None:
        """Raise `InvalidSceneError`, with the reason, unless an episode can start from it."""
        if problem := self.problem(scene):
            raise InvalidSceneError(f"{self.name}: {problem}")
        validate_scene(scene)


def parse_horizon(value: Any) -> Horizon:
    """From "appendix", "published" or a number of steps; `InvalidConfigError` for anything else."""
    if value is None or (isinstance(value, str) and value in (APPENDIX, PUBLISHED)):
        return PUBLISHED if value == PUBLISHED else None
    with suppress(TypeError, ValueError):
        steps = int(value) if isinstance(value, str) else operator.index(value)
        if 1 <= steps <= MAX_HORIZON and not isinstance(value, bool):
            return steps
    raise InvalidConfigError(
        f"horizon: expected {APPENDIX}, {PUBLISHED} or a number of control steps from 1 to "
        f"{MAX_HORIZON}, found {quoted(value)}"
    )


def format_horizon(horizon: Horizon) -> str:
    """The inverse of `parse_horizon`, for records and messages."""
    return APPENDIX if horizon is None else str(horizon)
