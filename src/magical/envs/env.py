"""The Gymnasium environment, and the states that are saved of it."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from msgspec import Meta
from numpy.typing import NDArray

from magical.envs.action_spec import ActionSpaceName, Point, action_spec
from magical.envs.ids import EnvId
from magical.envs.keys import KEYS_TO_ACTION
from magical.errors import (
    InvalidConfigError,
    InvalidStateError,
    InvalidTaskError,
    MagicalError,
    ResetNeededError,
    UnknownNameError,
)
from magical.files import convert
from magical.messages import quoted
from magical.observe import Observation, copy_arrays, make_spec
from magical.physics import Simulation
from magical.plugins import is_plugin, load_plugin, plugins
from magical.scene import FIRST_BLOCK, Dynamics, Poses, Scene, State
from magical.scene.constants import CONTROL_RATE, MAX_COORDINATE
from magical.tasks import MAX_HORIZON, Horizon, Task, get_task, parse_horizon
from magical.tasks.scoring import SUCCESS

SCORE_KEYS = ("eval_score", "published_code_score")  # of `info`
RESET_OPTIONS = ("scene", "dynamics")
RENDER_MODES = (None, "rgb_array")

# A reward is "none", "score", or the name of an entry point in this group: a function from the task
# to a potential, whose increase is the reward. It raises `UnknownNameError` for a task without one.
REWARDS = "magical.rewards"
Reward = str
Bodies = NDArray[np.float64]  # (5 + blocks, 6): x, y, angle and their velocities
Potential = Callable[[Scene, Bodies], float]


class Scores(NamedTuple):
    """A final state's score by both rules, each in [0, 1]."""

    score: float = 0.0
    published_code: float = 0.0

    def to_info(self) -> dict[str, Any]:
        """The entries that every `info` has."""
        return {**dict(zip(SCORE_KEYS, self, strict=True)), "is_success": self.score > SUCCESS}


_Part = Annotated[float, Meta(ge=-1.0, le=1.0)]  # of an action
_Number = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedState:
    """What `MagicalEnv.get_state` returns, from which an episode is continued.

    The bodies alone would not be enough to continue to the last bit: the solver keeps impulses
    between steps.
    """

    task: str
    variant: str
    horizon: Annotated[int, Meta(ge=1, le=MAX_HORIZON)]  # control steps in the episode
    scene: dict[str, Any]
    dynamics: dict[str, Any]
    actions: tuple[tuple[_Part, _Part, _Part], ...]  # so far: drive, turn, grip
    # After the actions: x, y, angle and their velocities, in units, radians and seconds.
    bodies: tuple[tuple[_Number, _Number, _Number, _Number, _Number, _Number], ...]
    # Whether the actions lead to these bodies. They do not in an episode that was itself restored
    # from a state whose actions led elsewhere.
    exact: bool
    rng: dict[str, Any]  # the state of a PCG64 generator, as NumPy represents it

    def start(self, task: Task) -> tuple[Scene, Dynamics, NDArray[np.float64]]:
        """The scene, the dynamics and the bodies (5 + blocks, 6).

        Raises `InvalidStateError` if the state is of another task, or a part is damaged.
        """
        if self.task != task.name or self.variant not in task.variants:
            raise InvalidStateError(
                f"saved state: expected task {task.name} and one of its variants, found "
                f"{quoted(self.task)} and {quoted(self.variant)}"
            )
        try:
            scene, dynamics = Scene.from_dict(self.scene), Dynamics.from_dict(self.dynamics)
            task.validate(scene)
            np.random.PCG64().state = cast(Any, self.rng)
        except (MagicalError, TypeError, ValueError, KeyError, OverflowError) as error:
            raise InvalidStateError(f"saved state: scene, dynamics or rng: {error}") from error
        if (found := len(self.actions)) > self.horizon:
            raise InvalidStateError(f"saved state: {found} actions, beyond its horizon")
        if (found := len(self.bodies)) != (count := FIRST_BLOCK + len(scene.blocks)):
            raise InvalidStateError(f"saved state: bodies: expected {count}, found {found}")
        return scene, dynamics, np.array(self.bodies)


class MagicalEnv(gym.Env[Any, Any]):
    """One task in one variant (appendix A.1; docs/specification.md, sections 1 and 7).

    ## Action space
    `Discrete(18)`: combinations of driving, turning and gripping, named in `ACTION_NAMES`. With
    `action_space="continuous"`, `Box(-1, 1, (3,))`: drive (fraction of the full speed, which is 0.8
    units / s forward and 0.6 back), turn (fraction of 2.5 rad / s, left is positive) and grip (-1
    open, 1 closed). The 18 discrete actions correspond to points in this space, which produce the
    same motions to the last bit (`scene.to_continuous`).

    ## Observation space
    By default a dict of the views `allo` and `ego`, 384 x 384 x 3 uint8; see `observe.PixelSpec`
    and `observe.StateSpec` for the others.

    ## Rewards
    0, or with `reward="score"` the score at the last step, or the increase of a potential, such as
    "dense", since the last step.

    ## Episode end
    Episodes are truncated at the horizon and never terminate.

    ## Info
    `eval_score` and `published_code_score` at every step, as in the published environments: 0.0
    before the last step, then the final state's scores (`scores()` has the current state's).
    `is_success`, whether the score is above 0.5, False before the last step. `instruction` at
    `reset`: what to do, in English (`Task.instruction`).

    Args:
        task: the task's name.
        variant: the variant's name.
        observation: see `observe.make_spec`.
        horizon: control steps in an episode; by default the task's; "published" takes the published
            code's, which differs for some tasks.
        reward: "none", "score", or the name of a potential (`REWARDS`).
        render_mode: "rgb_array" (both views side by side) or None; for a window see
            `gymnasium.wrappers.HumanRendering`.
        action_space: "discrete" or "continuous".

    Raises:
        UnknownNameError: there is no such task, variant, observation, reward, render mode
            or action space.
        InvalidConfigError, ObservationError: an invalid horizon or observation.

    Attributes:
        simulation: the episode's physics.
        bodies: poses and velocities of all bodies.
        actions: those of the episode so far, as drive, turn and grip.
        observer: has the current observation, which it overwrites at every step.
    """

    # A class attribute, as Gymnasium reads it, although Gymnasium declares it on instances.
    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": int(CONTROL_RATE),
    }
    simulation: Simulation
    bodies: Bodies

    def __init__(
        self,
        task: str,
        variant: str,
        *,
        observation: Observation = None,
        horizon: Horizon = None,
        reward: Reward = "none",
        render_mode: str | None = None,
        action_space: ActionSpaceName = "discrete",
    ) -> None:
        self.task: Task = get_task(task)
        self.task.axes_of(variant)  # raises for a variant that the task lacks
        self._own = self.task.resolve_horizon(parse_horizon(horizon)), variant
        self.horizon, self.variant = self._own
        self.reward, self.potential = reward, find_potential(reward, self.task)
        self.render_mode = known("render mode", render_mode, RENDER_MODES)
        self.observation_spec = make_spec(observation, self.task)
        self.observation_space = self.observation_spec.space
        self.observer = self.observation_spec.observer()
        self.action_spec = action_spec(action_space)
        self.action_space: spaces.Space[Any] = self.action_spec.space
        self.actions: list[Point] = []
        self.is_running = False
        self._exact = True  # whether the actions lead to the bodies; see `SavedState`
        self._last_potential = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode from a scene sampled for the variant.

        Args:
            seed: of the random generator; `None` keeps the current generator.
            options: `scene` and `dynamics` (dataclasses, or plain dicts as `to_dict()` makes them)
                to start from instead.

        Raises:
            InvalidSceneError, PlacementError: no episode can start from these.
            InvalidConfigError: unknown options.
        """
        info = self.start(seed, options or {})
        return copy_arrays(self.observer.out), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act for one control step of 1/8 s.

        Raises:
            InvalidActionError: not an integer from 0 to 17, or for continuous actions not three
                numbers from -1 to 1; the episode is unchanged.
            ResetNeededError: before the first reset, or after the episode's end.
            InvalidTaskError: the task's score at the episode's end is not a number from 0 to 1.
        """
        if not self.is_running:
            raise ResetNeededError(
                "step: expected a running episode, found none (not reset yet, or ended); "
                "call reset() first"
            )
        point = self.action_spec.point(action)
        self.observe(point, self.simulation.step(point))
        reward, scores = self.outcome()
        truncated = not self.is_running
        return copy_arrays(self.observer.out), reward, False, truncated, scores.to_info()

    def start(self, seed: int | None, options: Mapping[str, Any]) -> dict[str, Any]:
        """As `reset`, but leave the observation in the observer; returns the info."""
        super().reset(seed=seed)
        self.is_running = False
        if not set(options) <= set(RESET_OPTIONS):
            raise InvalidConfigError(
                f"reset options: expected some of {RESET_OPTIONS}, found {quoted(dict(options))}"
            )
        self.horizon, self.variant = self._own  # a restored episode may have had others
        scene, dynamics = self.task.sample(self.variant, self.np_random)
        if (given := options.get("scene")) is not None:
            scene = given if isinstance(given, Scene) else Scene.from_dict(given)
            self.task.validate(scene)
        if (given := options.get("dynamics")) is not None:
            dynamics = given if isinstance(given, Dynamics) else Dynamics.from_dict(given)
        self._exact = True
        self._begin(Simulation(scene, dynamics), [])
        return Scores().to_info() | {"instruction": self.task.instruction(scene)}

    def _begin(self, simulation: Simulation, actions: list[Point], *earlier: Bodies) -> None:
        """Continue from a simulation's current state, with the bodies that a stack shows before."""
        self.simulation, self.actions, self.bodies = simulation, actions, simulation.read()
        first, *later = *earlier, self.bodies
        self.observer.start(simulation.scene, first)  # raises for a scene that it cannot show
        for bodies in later:
            self.observer.update(bodies)
        if self.potential:
            self._last_potential = self.potential(simulation.scene, self.bodies)
        self.is_running = len(actions) < self.horizon

    def observe(self, action: Point, bodies: Bodies) -> None:
        """Note a simulated step: the action, and the bodies that it led to."""
        self.actions.append(action)
        self.bodies = bodies
        self.observer.update(bodies)

    def outcome(self) -> tuple[float, Scores]:
        """The reward of the step observed last, and the scores if the episode ends with it."""
        self.is_running = len(self.actions) < self.horizon
        scores = Scores() if self.is_running else self.scores()
        if self.potential is None:
            return (scores.score if self.reward == "score" else 0.0), scores
        before = self._last_potential
        self._last_potential = self.potential(self.simulation.scene, self.bodies)
        return self._last_potential - before, scores

    def scores(self) -> Scores:
        """The current state's scores, at any step; raises `InvalidTaskError`."""
        self._require_episode("scores")
        task, scene, poses = self.task, self.simulation.scene, Poses(self.bodies[:, :3])
        score = _checked_score(task, "score", task.score(scene, poses))
        if task.published_score_fn is None:  # both rules are the same
            return Scores(score, score)
        published = task.published_code_score(scene, poses)
        return Scores(score, _checked_score(task, "published code's score", published))

    def render(self) -> NDArray[np.uint8] | None:
        """Both views side by side, egocentric left: uint8 (384, 768, 3).

        Returns `None` without a render mode, with a warning.
        """
        if self.render_mode is None:
            gym.logger.warn('no frames: make the environment with render_mode="rgb_array"')
            return None
        from magical.render import render_views  # imports numba: only when something is rendered

        self._require_episode("render")
        return render_views(self.simulation.scene, Poses(self.bodies[:, :3]))

    def state(self) -> State:
        """A copy of the true state, for experts and privileged learners."""
        self._require_episode("state")
        scene, bodies = self.simulation.scene, self.bodies.copy()
        return State(scene, Poses(bodies[:, :3]), bodies[:, 3:], len(self.actions), self.horizon)

    def get_state(self) -> dict[str, Any]:
        """JSON-compatible data from which `set_state` continues: see `SavedState`."""
        self._require_episode("get_state")
        return {
            "task": self.task.name,
            "variant": self.variant,
            "horizon": self.horizon,
            "scene": self.simulation.scene.to_dict(),
            "dynamics": self.simulation.dynamics.to_dict(),
            "actions": list(map(list, self.actions)),
            "bodies": self.bodies.tolist(),
            "exact": self._exact,
            "rng": dict(self.np_random.bit_generator.state),
        }

    def set_state(self, state: Mapping[str, Any]) -> Any:
        """Continue from a saved state by simulating its actions again.

        Where they lead to the saved bodies, as with the same build of pymunk on the same platform,
        the episode continues to the last bit. Otherwise the saved bodies are set, with a
        `RuntimeWarning` that has the largest difference; all frames of a stack then show these, and
        `get_state()["exact"]` is False.

        Args:
            state: what `get_state` returned, in this or another process.

        Returns:
            The observation.

        Raises:
            InvalidStateError: data of another task, or damaged; the next call must be `reset` or
                `set_state`.
            InvalidSceneError: the observation cannot show the scene.
        """
        self.is_running = False
        saved: SavedState = convert(state, SavedState, "saved state", InvalidStateError)
        scene, dynamics, bodies = saved.start(self.task)
        simulation = Simulation(scene, dynamics)
        seen = [simulation.read(), *map(simulation.step, saved.actions)]
        departure = float(np.abs(seen[-1] - bodies).max())
        if departure:
            simulation.write(bodies)
            seen = [bodies]
            warnings.warn(
                f"set_state: the saved actions led to other bodies, by up to {departure:.2g} "
                "units, radians or these per second (another platform or build of pymunk?); the "
                "saved bodies were set, but not what the solver keeps between steps",
                RuntimeWarning,
                stacklevel=2,
            )
        self.horizon, self.variant = saved.horizon, saved.variant
        self._exact = saved.exact and not departure
        self._begin(simulation, list(saved.actions), *seen[-self.observation_spec.frames : -1])
        self.np_random.bit_generator.state = saved.rng
        return copy_arrays(self.observer.out)

    @property
    def env_id(self) -> EnvId:
        """The id of the task and the episode's variant, without a preset."""
        return EnvId(self.task.name, self.variant)

    def get_keys_to_action(self) -> dict[tuple[str, ...], Any]:
        """Keys for `gymnasium.utils.play`: w, s drive, a, d turn, space closes the fingers."""
        actions = self.action_spec.convert(np.array(list(KEYS_TO_ACTION.values())))
        return dict(zip(KEYS_TO_ACTION, actions, strict=True))

    def _require_episode(self, what: str) -> None:
        if not hasattr(self, "simulation"):
            raise ResetNeededError(f"{what}: there is no episode yet; call reset() first")


def find_potential(reward: Reward, task: Task) -> Potential | None:
    """The potential of a reward, None for "none" and "score"; raises `UnknownNameError`."""
    if reward in ("none", "score"):
        return None
    if not isinstance(reward, str) or not is_plugin(REWARDS, reward):
        names = ", ".join(("none", "score", *plugins(REWARDS)))
        raise UnknownNameError(f"reward {quoted(reward)} is unknown; expected one of: {names}")
    potential: Potential = load_plugin(REWARDS, reward)(task)
    return potential


def refuse_time_limit(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """The environment; raises `InvalidConfigError` if it is in Gymnasium's `TimeLimit`."""
    if isinstance(env, gym.wrappers.TimeLimit) and env.spec is not None:
        raise time_limit_error(env.spec.max_episode_steps)
    return env


def time_limit_error(steps: Any) -> InvalidConfigError:
    """The error for `max_episode_steps`, by which Gymnasium ends episodes without their scores."""
    return InvalidConfigError(
        f"max_episode_steps={quoted(steps)}: episodes would be cut off before they are scored; "
        f"expected horizon={quoted(steps)} instead"
    )


def known(what: str, value: Any, choices: Sequence[Any]) -> Any:
    """The value; raises `UnknownNameError` unless it is one of the choices."""
    if value not in choices:
        raise UnknownNameError(
            f"{what} {quoted(value)} is unknown; expected {' or '.join(map(str, choices))}"
        )
    return value


def _checked_score(task: Task, name: str, value: Any) -> float:
    """The score as a float; raises `InvalidTaskError`."""
    number = isinstance(value, float | int | np.number | np.bool_)
    if not number or not 0.0 <= value <= 1.0:
        raise InvalidTaskError(
            f"task {task.name}: expected a {name} from 0 to 1, found {quoted(value)}; "
            "correct the task's score function"
        )
    return float(value)
