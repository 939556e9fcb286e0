"""One episode in progress: what the single and the vector environment have in common."""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.errors import InvalidStateError, MagicalError, UnknownNameError
from magical.observe import ObservationSpec
from magical.physics import Simulation
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
    """A task's variant in progress, observed by an observer.

    Nothing is checked here that would cost time at every step; the environments do that.
    """

    def __init__(
        self,
        task: Task,
        variant: str,
        spec: ObservationSpec,
        horizon: int | None = None,
        reward: str = "none",
        out: Any = None,
    ) -> None:
        check_options(task, horizon, reward)
        self.task = task
        self.variant = variant
        self.horizon = task.horizon if horizon is None else horizon
        self.reward = reward
        self.observer = spec.observer(out)
        self._frames = spec.frames
        self.actions: list[int] = []
        self._progress = 0.0
        self.simulation: Simulation
        self.bodies: NDArray[np.float64]  # (5 + blocks, 6): poses and velocities

    def start(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> None:
        """Begin an episode from a sampled scene, or from the one that `options` give.

        Raises `InvalidSceneError` for an impossible scene, `ValueError` for unknown options.
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
        """Advance by one control step and observe it; returns whether the horizon is reached."""
        self.simulation.step(action)
        self.actions.append(action)
        self.bodies = self.simulation.read()
        self.observer.update(self.bodies)
        return len(self.actions) >= self.horizon

    def outcome(self, ended: bool) -> tuple[float, Scores]:
        """The last step's reward, and the scores (0.0 before the episode's end).

        Call it once after each step: the dense reward is the change since the last call.
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
        """The present pose of every body."""
        return Poses(self.bodies[:, :3])

    def scores(self) -> Scores:
        """The present state's scores."""
        scene, poses = self.simulation.scene, self.poses
        return Scores(
            float(self.task.score(scene, poses)),
            float(self.task.published_code_score(scene, poses)),
        )

    def state(self) -> State:
        """The true state."""
        return State(
            self.simulation.scene, self.poses, self.bodies[:, 3:], len(self.actions), self.horizon
        )

    def save(self) -> dict[str, Any]:
        """Plain data from which `restore` continues bit-equally: the start and all actions.

        Poses and velocities alone would not be enough: the solver keeps impulses between steps.
        """
        return {
            "task": self.task.name,
            "variant": self.variant,
            "horizon": self.horizon,
            "scene": self.simulation.scene.to_dict(exact=True),
            "dynamics": self.simulation.dynamics.to_dict(),
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
        self.simulation = Simulation(scene, dynamics)
        unobserved = max(0, len(actions) - self._frames + 1)
        for action in actions[:unobserved]:
            self.simulation.step(action)
        self.bodies = self.simulation.read()
        self.observer.start(scene, self.bodies)
        self.actions = list(actions[:unobserved])
        for action in actions[unobserved:]:
            self.step(action)
        self._progress = self._measure_progress()

    def _measure_progress(self) -> float:
        if self.reward != "dense" or self.task.progress_fn is None:
            return 0.0
        return float(self.task.progress_fn(self.simulation.scene, self.poses))


def check_options(task: Task, horizon: int | None, reward: str) -> None:
    """Raise `ValueError` or `UnknownNameError` for an impossible horizon or reward."""
    if horizon is not None and operator.index(horizon) < 1:
        raise ValueError(f"horizon: expected a positive integer or None, found {horizon!r}")
    if reward not in REWARDS:
        raise UnknownNameError(f"reward {reward!r} is unknown; expected one of {REWARDS}")
    if reward == "dense" and task.progress_fn is None:
        having = [name for name, other in TASKS.items() if other.progress_fn is not None]
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
