"""One world being acted in: what the single and the vector environment have in common."""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.errors import InvalidStateError, MagicalError, UnknownNameError
from magical.observe.observer import Observer, frames_shown, make_observer
from magical.observe.spec import PixelSpec
from magical.observe.vector import StateLayout
from magical.physics import World
from magical.scene.actions import NUM_ACTIONS
from magical.scene.poses import Poses
from magical.scene.scene import Dynamics, Scene
from magical.scene.state import State
from magical.tasks import TASKS, Task

RESET_OPTIONS = ("scene", "dynamics")
REWARDS = ("none", "score", "dense")


@dataclass(frozen=True, slots=True)
class Scores:
    """A final state's score by both rules, each in [0, 1]."""

    score: float = 0.0
    published_code: float = 0.0


class Episode:
    """A task's variant in progress, shown by an observer.

    Nothing is checked here that costs time at every step; the environments do that.
    """

    def __init__(
        self,
        task: Task,
        variant: str,
        form: PixelSpec | StateLayout,
        horizon: int | None = None,
        reward: str = "none",
        out: Any = None,
    ) -> None:
        check_options(task, horizon, reward)
        self.task = task
        self.variant = variant
        self.horizon = task.horizon if horizon is None else horizon
        self.reward = reward
        self.observer: Observer = make_observer(form, out)
        self._frames = frames_shown(form)
        self.actions: list[int] = []
        self._progress = 0.0
        self.world: World
        self.table: NDArray[np.float64]  # (5 + blocks, 6): poses and velocities

    def start(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> None:
        """Begin an episode from the variant's draw, or from what `options` give in its place.

        Raises `InvalidSceneError` for a scene that cannot be, `ValueError` for unknown options.
        """
        scene, dynamics = self.task.sample(self.variant, rng)
        chosen = options or {}
        unknown = set(chosen) - set(RESET_OPTIONS)
        if unknown:
            raise ValueError(f"reset options: expected {RESET_OPTIONS}, found {sorted(unknown)}")
        if chosen.get("scene") is not None:
            scene = _as_scene(chosen["scene"])
            self.task.validate(scene)
        if chosen.get("dynamics") is not None:
            dynamics = _as_dynamics(chosen["dynamics"])
        self._begin(scene, dynamics)

    def step(self, action: int) -> bool:
        """Advance by one control step and show it; returns whether the horizon is reached."""
        self.world.step(action)
        self.actions.append(action)
        self.table = self.world.read()
        self.observer.update(self.table)
        return len(self.actions) >= self.horizon

    def outcome(self, ended: bool) -> tuple[float, Scores]:
        """The last step's reward, and the scores (0.0 before the episode's end).

        To be asked for once after each step: the dense reward is what changed since the last time.
        """
        scores = self.scores() if ended else Scores()
        if self.reward == "score":
            return scores.score, scores
        if self.reward == "none":
            return 0.0, scores
        before, self._progress = self._progress, self._measure_progress()
        return self._progress - before, scores

    @property
    def poses(self) -> Poses:
        """Where every body is now."""
        return Poses(self.table[:, :3])

    def scores(self) -> Scores:
        """The present state's scores."""
        scene, poses = self.world.scene, self.poses
        return Scores(
            float(self.task.score(scene, poses)),
            float(self.task.published_code_score(scene, poses)),
        )

    def state(self) -> State:
        """The true state, as experts see it."""
        return State(
            self.world.scene, self.poses, self.table[:, 3:], len(self.actions), self.horizon
        )

    def save(self) -> dict[str, Any]:
        """Plain data from which `restore` continues bit-equally: the start and all actions.

        Poses and velocities alone would not do: the solver keeps impulses between steps.
        """
        return {
            "task": self.task.name,
            "variant": self.variant,
            "horizon": self.horizon,
            "scene": self.world.scene.to_dict(exact=True),
            "dynamics": self.world.dynamics.to_dict(),
            "actions": list(self.actions),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from what `save` returned, by simulating its actions again.

        Raises `InvalidStateError` if it is damaged or of another task.
        """
        if saved.get("task") != self.task.name:
            raise InvalidStateError(
                f"saved state: expected one of {self.task.name}, found {saved.get('task')!r}"
            )
        try:
            scene, dynamics = _as_scene(saved["scene"]), _as_dynamics(saved["dynamics"])
            actions = _actions(saved["actions"])
            horizon = int(saved["horizon"])
        except (KeyError, TypeError, ValueError, MagicalError) as error:
            raise InvalidStateError(f"saved state is damaged: {error!r}") from error
        self.horizon = horizon
        self._begin(scene, dynamics, actions)

    def _begin(self, scene: Scene, dynamics: Dynamics, actions: Sequence[int] = ()) -> None:
        self.world = World(scene, dynamics)
        first_shown = max(0, len(actions) - self._frames + 1)
        for action in actions[:first_shown]:
            self.world.step(action)
        self.table = self.world.read()
        self.observer.start(scene, self.table)
        self.actions = list(actions[:first_shown])
        for action in actions[first_shown:]:
            self.step(action)
        self._progress = self._measure_progress()

    def _measure_progress(self) -> float:
        if self.reward != "dense" or self.task.progress is None:
            return 0.0
        return float(self.task.progress(self.world.scene, self.poses))


def check_options(task: Task, horizon: int | None, reward: str) -> None:
    """Raise `ValueError` or `UnknownNameError` for a horizon or reward that cannot be."""
    if horizon is not None and operator.index(horizon) < 1:
        raise ValueError(f"horizon: expected a positive integer or None, found {horizon!r}")
    if reward not in REWARDS:
        raise UnknownNameError(f"reward {reward!r} is unknown; expected one of {REWARDS}")
    if reward == "dense" and task.progress is None:
        having = [name for name, other in TASKS.items() if other.progress is not None]
        raise UnknownNameError(
            f"{task.name} has no dense reward; expected one of: {', '.join(having)}"
        )


def _as_scene(scene: Scene | Mapping[str, Any]) -> Scene:
    return scene if isinstance(scene, Scene) else Scene.from_dict(scene)


def _as_dynamics(dynamics: Dynamics | Mapping[str, Any]) -> Dynamics:
    return dynamics if isinstance(dynamics, Dynamics) else Dynamics.from_dict(dynamics)


def _actions(values: Sequence[Any]) -> list[int]:
    actions = [int(value) for value in values]
    if any(not 0 <= action < NUM_ACTIONS for action in actions):
        raise ValueError(f"actions: expected integers from 0 to {NUM_ACTIONS - 1}")
    return actions
