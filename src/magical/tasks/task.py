"""A task: its Demo scene, how variants change it, and how final states are scored."""

from collections.abc import Callable
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal

import numpy as np

from magical.errors import (
    InvalidProgramError,
    InvalidSceneError,
    InvalidTaskError,
    PlacementError,
    UnknownNameError,
)
from magical.scene import Dynamics, Poses, Scene
from magical.tasks.axes import TEST_ALL, VARIANTS, Axis
from magical.tasks.placement import Placement, sample_placement
from magical.tasks.programs import Goal, instruction
from magical.tasks.programs.validity import problem
from magical.tasks.validation import validate_scene

RandomiseFn = Callable[[Scene, Axis, np.random.Generator], Scene]
ScoreFn = Callable[[Scene, Poses], float]
ValidateFn = Callable[[Scene], str]
MAX_SCENES = 1000  # sampled at most for one episode; the paper's tasks need only one

Horizon = int | Literal["published"] | None  # steps, the published code's, the appendix's


def _accept(scene: Scene) -> str:
    return ""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task of the benchmark.

    Raises:
        InvalidTaskError: fields that contradict each other.
        InvalidSceneError: a Demo scene that does not fit the task.
        InvalidProgramError: a program with which no episode can start from the Demo scene.
    """

    name: str  # as in environment ids, for instance MoveToCorner
    summary: str  # one line: what the robot must do
    section: str = ""  # of the appendix; tasks are listed in its order, those without one last
    horizon: int  # control steps (appendix A.2)
    published_horizon: int | None = None  # the published code's, if different
    demo: Scene  # the Demo variant's scene (docs/specification.md, section 8)
    axes: Axis  # the axes that its variants may change (appendix, Table 2)
    randomise_fn: RandomiseFn  # samples counts, colours and shapes along the given axes; not poses
    placement: Placement = field(default_factory=Placement)  # how regions and blocks are placed
    score_fn: ScoreFn  # the appendix's score of a final state, 0 to 1
    published_score_fn: ScoreFn | None = None  # the published code's, if different (section 9)
    max_blocks: int  # over all variants
    max_regions: int  # over all variants
    program: Goal | None = None  # what the task asks for, in the language of goals
    # The reason why a scene does not fit, or "". The dense reward of a program means nothing in
    # scenes for which `magical.tasks.programs.problem` gives a reason, and is NaN if there is no
    # such place.
    validate_fn: ValidateFn = _accept

    def __post_init__(self) -> None:
        if not self.name.isalnum():
            raise InvalidTaskError(
                f"task name: expected letters and digits as in environment ids, found {self.name!r}"
            )
        for horizon in (self.horizon, self.published_horizon):
            if horizon is not None and horizon < 1:
                raise InvalidTaskError(f"{self.name}: expected a positive horizon, found {horizon}")
        needed = VARIANTS["TestCountPlus"]
        if Axis.COUNT in self.axes and needed not in self.axes:
            raise InvalidTaskError(
                f"{self.name}: expected {needed} for the axis COUNT, found {self.axes}"
            )
        self.validate(self.demo)
        if self.program is not None and (reason := problem(self.program, self.demo)):
            raise InvalidProgramError(f"{self.name}: {reason}")

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
        """The axes along which a variant differs from Demo.

        TestAll changes everything that the task supports, and jitters poses only if they cannot be
        sampled freely (docs/specification.md, section 8).

        Raises:
            UnknownNameError: the task lacks the variant; the message lists those it has.
        """
        if variant not in self.variants:
            known, close = ", ".join(self.variants), get_close_matches(str(variant), self.variants)
            if variant in VARIANTS:
                raise UnknownNameError(f"{self.name} has no variant {variant!r}; it has: {known}")
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise UnknownNameError(f"{variant!r} is not a variant; {self.name} has: {known}{hint}")
        axes = VARIANTS[variant] & self.axes
        if variant == TEST_ALL and Axis.LAYOUT not in axes:
            return axes | self.axes & Axis.JITTER
        return axes

    def sample(self, variant: str, rng: np.random.Generator) -> tuple[Scene, Dynamics]:
        """Sample an episode's initial scene and dynamics.

        Raises:
            UnknownNameError: the task lacks the variant; the message lists those it has.
            PlacementError: no room was found for a body, or no sampled scene fits the task.
        """
        axes = self.axes_of(variant)
        for _ in range(MAX_SCENES):
            scene = self.randomise_fn(self.demo, axes, rng)
            scene = sample_placement(scene, axes, rng, self.placement)
            if not (problem := self.validate_fn(scene)):
                return scene, Dynamics.sample(rng) if Axis.DYNAMICS in axes else Dynamics()
        raise PlacementError(f"{self.name}, {variant}: none of {MAX_SCENES} scenes fits: {problem}")

    def nudge(self, scene: Scene, size: float, rng: np.random.Generator) -> Scene:
        """A scene whose initial poses are shifted by at most `size` units and radians.

        Raises:
            PlacementError: none of `MAX_SCENES` such scenes fits the task.
        """
        for _ in range(MAX_SCENES):
            nudged = scene.nudged(size, rng)
            if not (problem := self.validate_fn(nudged)):
                return nudged
        raise PlacementError(f"{self.name}: none of {MAX_SCENES} nudged scenes fits: {problem}")

    def score(self, scene: Scene, poses: Poses) -> float:
        """The appendix's score, 0 to 1, of the poses at the end of an episode from `scene`."""
        return self.score_fn(scene, poses)

    def published_code_score(self, scene: Scene, poses: Poses) -> float:
        """As `score`, by the published code's rule (docs/specification.md, section 9)."""
        return (self.published_score_fn or self.score_fn)(scene, poses)

    def instruction(self, scene: Scene, *, paraphrase: int = 0, attributes: bool = True) -> str:
        """The English instruction for an episode that starts from `scene`.

        Args:
            scene: the initial scene.
            paraphrase: index of the wording.
            attributes: whether blocks and regions are named by colour and shape.

        Returns:
            The instruction of the task's program, or the task's summary if it has no program.
        """
        if self.program is None:
            return self.summary
        return instruction(self.program, scene, paraphrase=paraphrase, attributes=attributes)

    def validate(self, scene: Scene, nudge: float = 0.0) -> None:
        """Check that an episode of this task can start from a scene nudged by at most `nudge`.

        Raises:
            InvalidSceneError: it cannot; the message says why and what to change.
        """
        found = len(scene.blocks), len(scene.regions)
        if found[0] > self.max_blocks or found[1] > self.max_regions:
            raise InvalidSceneError(
                f"{self.name}: expected at most {self.max_blocks} blocks and {self.max_regions} "
                f"regions, found {found[0]} and {found[1]}; remove some"
            )
        validate_scene(scene, nudge)
        if problem := self.validate_fn(scene):
            raise InvalidSceneError(f"{self.name}: {problem}")
