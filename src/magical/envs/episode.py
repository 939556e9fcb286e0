"""One episode in progress, for the single and the vector environment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs.saved_state import SavedState
from magical.errors import (
    InvalidConfigError,
    InvalidSceneError,
    InvalidScoreError,
    InvalidStateError,
    UnknownNameError,
)
from magical.messages import quoted
from magical.observe import ObservationSpec
from magical.physics import Simulation
from magical.plugins import is_plugin, load_plugin, plugins
from magical.scene.actions import AnyAction
from magical.scene.constants import MAX_NUDGE
from magical.scene.poses import Poses, State
from magical.scene.scene import Dynamics, Scene
from magical.tasks import Horizon, Task, parse_horizon
from magical.tasks.scoring import SUCCESS

RESET_OPTIONS = ("scene", "dynamics", "nudge")

# A reward is "none", "score", or the name of an entry point in this group: a function from the task
# to a potential, whose increase is the reward. It raises `UnknownNameError` for a task without one.
REWARDS = "magical.rewards"
Reward = str
Potential = Callable[[Scene, NDArray[np.float64]], float]  # of bodies (5 + blocks, 6)


@dataclass(frozen=True, slots=True)
class Scores:
    """A final state's score by both rules, each in [0, 1]."""

    score: float = 0.0
    published_code: float = 0.0

    @property
    def is_success(self) -> bool:
        """Whether the score is above `SUCCESS`."""
        return self.score > SUCCESS


class Episode:
    """An episode of a task's variant, observed by an observer.

    Checks that would cost time at every step are left to the environments.
    """

    def __init__(
        self,
        task: Task,
        variant: str,
        spec: ObservationSpec,
        horizon: Horizon = None,
        reward: Reward = "none",
        out: Any = None,
    ) -> None:
        self.task = task
        self._own = task.resolve_horizon(parse_horizon(horizon)), variant
        self.horizon, self.variant = self._own
        self.reward, self.potential = reward, find_potential(reward, task)
        self.observer = spec.observer(out)
        self._frames = spec.frames
        self.actions: list[AnyAction] = []
        self.exact = True  # whether the actions led to the bodies; see `saved_state.Record`
        self._last_potential = 0.0
        self.simulation: Simulation
        self.bodies: NDArray[np.float64]  # (5 + blocks, 6): poses and velocities

    def start(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> None:
        """Start an episode from a sampled scene, or from the one in `options`.

        The option `nudge` then shifts the initial poses by up to that many units and radians,
        sampled from `rng` (docs/determinism.md).

        Raises:
            InvalidSceneError: no episode can start from the scene.
            InvalidConfigError: unknown options, or a nudge that is not from 0 to `MAX_NUDGE`.
            PlacementError: no scene that fits the task was found, or none after a nudge.
        """
        # A restored episode may have had other values.
        self.horizon, self.variant = self._own
        scene, dynamics = self.task.sample(self.variant, rng)
        chosen = options or {}
        if not set(chosen) <= set(RESET_OPTIONS):
            raise InvalidConfigError(
                f"reset options: expected some of {RESET_OPTIONS}, found {quoted(dict(chosen))}"
            )
        if (given := chosen.get("scene")) is not None:
            scene = given if isinstance(given, Scene) else Scene.from_dict(given)
            self.task.validate(scene)
        if (given := chosen.get("dynamics")) is not None:
            dynamics = given if isinstance(given, Dynamics) else Dynamics.from_dict(given)
        if nudge := checked_nudge(chosen.get("nudge")):
            scene = self.task.nudge(scene, nudge, rng)
        self._start_from(scene, dynamics)

    def step(self, action: AnyAction) -> bool:
        """Advance by one control step and observe it; returns whether the horizon is reached."""
        self.simulation.step(action)
        self.actions.append(action)
        self.bodies = self.simulation.read()
        self.observer.update(self.bodies)
        return len(self.actions) >= self.horizon

    def outcome(self, ended: bool) -> tuple[float, Scores]:
        """The last step's reward, and the scores (0.0 before the episode's end).

        Call it once after each step: the reward of a potential is the change since the last call.
        """
        scores = self.scores() if ended else Scores()
        if self.reward == "score":
            return scores.score, scores
        if self.potential is None:
            return 0.0, scores
        before, self._last_potential = self._last_potential, self._measure_potential()
        return self._last_potential - before, scores

    @property
    def poses(self) -> Poses:
        """The current pose of every body."""
        return Poses(self.bodies[:, :3])

    def scores(self) -> Scores:
        """The current state's scores; raises `InvalidScoreError`."""
        task, scene, poses = self.task, self.simulation.scene, self.poses
        score = _checked_score(task, "score", task.score(scene, poses))
        if task.published_score_fn is None:  # both rules are the same
            return Scores(score, score)
        published = task.published_code_score(scene, poses)
        return Scores(score, _checked_score(task, "published code's score", published))

    def state(self) -> State:
        """A copy of the true state."""
        scene, bodies = self.simulation.scene, self.bodies.copy()
        return State(scene, Poses(bodies[:, :3]), bodies[:, 3:], len(self.actions), self.horizon)

    def save(self, rng: np.random.Generator) -> dict[str, Any]:
        """Plain data from which `restore` continues: the start, all actions, and the bodies.

        The bodies alone would not be enough to continue identically: the solver keeps impulses
        between steps.
        """
        scene, dynamics = self.simulation.scene, self.simulation.dynamics
        return {
            "task": self.task.name,
            "variant": self.variant,
            "horizon": self.horizon,
            "scene": scene.to_dict(),
            "dynamics": dynamics.to_dict(),
            "actions": np.array(self.actions).tolist(),
            "rng": dict(rng.bit_generator.state),
            "bodies": self.bodies.tolist(),
            "exact": self.exact,
        }

    def restore(self, state: SavedState) -> float:
        """Continue from a saved state by simulating its actions again.

        If these lead to other bodies than the saved ones, the saved ones are set, and the frames of
        a stack are all of these, as after a reset. Its horizon and variant are the episode's until
        the next start.

        Returns:
            The largest difference of a number in the two `bodies`; 0.0: they are equal.

        Raises `InvalidStateError` if this episode's observation cannot show its scene.
        """
        self.horizon, self.variant = state.record.horizon, state.record.variant
        try:
            departure = self._start_from(state.scene, state.dynamics, state.actions, state.bodies)
        except InvalidSceneError as error:
            raise InvalidStateError(f"saved state, 'scene': {error}") from error
        self.exact = state.record.exact and not departure
        return departure

    def _start_from(
        self,
        scene: Scene,
        dynamics: Dynamics,
        actions: Sequence[AnyAction] = (),
        saved: NDArray[np.float64] | None = None,
    ) -> float:
        """Start, simulate the actions, and set the `saved` bodies if these led to others."""
        self.simulation, self.exact = Simulation(scene, dynamics), True
        seen = [self.simulation.read()]
        for action in actions:
            self.simulation.step(action)
            seen.append(self.simulation.read())
        departure = 0.0 if saved is None else float(np.abs(seen[-1] - saved).max())
        if saved is not None and departure:
            self.simulation.write(saved)
            seen = [self.simulation.read()]
        self.bodies, self.actions = seen[-1], list(actions)
        first, *later = seen[-self._frames :]
        self.observer.start(scene, first)  # raises for a scene that it cannot show
        for bodies in later:
            self.observer.update(bodies)
        self._last_potential = self._measure_potential()
        return departure

    def _measure_potential(self) -> float:
        return self.potential(self.simulation.scene, self.bodies) if self.potential else 0.0


def find_potential(reward: Reward, task: Task) -> Potential | None:
    """The potential of a reward, None for "none" and "score"; raises `UnknownNameError`."""
    if reward in ("none", "score"):
        return None
    if not isinstance(reward, str) or not is_plugin(REWARDS, reward):
        names = ", ".join(("none", "score", *plugins(REWARDS)))
        raise UnknownNameError(f"reward {quoted(reward)} is unknown; expected one of: {names}")
    potential: Potential = load_plugin(REWARDS, reward)(task)
    return potential


def checked_nudge(nudge: Any) -> float:
    """The largest shift of initial poses, 0.0 for `None`.

    Raises `InvalidConfigError` unless it is from 0 to `MAX_NUDGE`.
    """
    if nudge is None:
        return 0.0
    number = isinstance(nudge, float | int | np.floating | np.integer)
    if not number or isinstance(nudge, bool) or not 0.0 <= nudge <= MAX_NUDGE:
        raise InvalidConfigError(
            f"nudge: expected a number from 0 to {MAX_NUDGE}, found {quoted(nudge)}"
        )
    return float(nudge)


def _checked_score(task: Task, name: str, value: Any) -> float:
    """The score as a float; raises `InvalidScoreError`."""
    number = isinstance(value, float | int | np.number | np.bool_)
    if not number or not 0.0 <= value <= 1.0:
        raise InvalidScoreError(
            f"task {task.name}: expected a {name} from 0 to 1, found {quoted(value)}; "
            "correct the task's score function"
        )
    return float(value)
