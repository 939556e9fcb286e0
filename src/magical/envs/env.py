"""The Gymnasium environment."""

from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical.envs.action_spec import ActionSpaceName, action_spec
from magical.envs.episode import Episode, Reward, Scores
from magical.envs.ids import EnvId
from magical.envs.keys import KEYS_TO_ACTION
from magical.envs.saved_state import parse_state, warn_of_departure
from magical.errors import (
    InvalidConfigError,
    NotPicklableError,
    ResetNeededError,
    UnknownNameError,
)
from magical.messages import quoted
from magical.observe import Observation, make_spec
from magical.observe.arrays import copy_arrays
from magical.scene.constants import CONTROL_RATE
from magical.scene.poses import State
from magical.tasks import Horizon, Task, get_task

SCORE_KEYS = ("eval_score", "published_code_score")  # of `info`


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
    `dense` of magical-goals, since the last step.

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
        reward: "none", "score", or the name of a potential (an entry point in `magical.rewards`).
        render_mode: "rgb_array" (both views side by side) or None; for a window see
            `gymnasium.wrappers.HumanRendering`.
        action_space: "discrete" or "continuous".

    Raises:
        UnknownNameError: there is no such task, variant, observation, reward, render mode or
            action space.
        InvalidConfigError, ObservationError: an invalid horizon or observation.
    """

    # A class attribute, as Gymnasium reads it, although Gymnasium declares it on instances.
    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": int(CONTROL_RATE),
    }

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
        self.observation_spec = make_spec(observation, self.task)
        self._episode = Episode(self.task, variant, self.observation_spec, horizon, reward)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UnknownNameError(
                f"render mode {quoted(render_mode)} is unknown; expected rgb_array or None"
            )
        self.render_mode = render_mode
        self.observation_space = self.observation_spec.space
        self.action_spec = action_spec(action_space)
        self.action_space: spaces.Space[Any] = self.action_spec.space
        self._running = False

    @property
    def env_id(self) -> EnvId:
        """The id of the task and the episode's variant, without a preset."""
        return EnvId(self.task.name, self._episode.variant)

    @property
    def variant(self) -> str:
        """The episode's variant."""
        return self._episode.variant

    @property
    def horizon(self) -> int:
        """Control steps in an episode."""
        return self._episode.horizon

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode from a scene sampled for the variant.

        Args:
            seed: of the random generator; `None` keeps the current generator.
            options: `scene` and `dynamics` (dataclasses, or plain dicts as `to_dict()` makes them)
                to start from instead; `nudge`, which shifts the initial poses by up to that much,
                sampled by the generator (units and radians; docs/determinism.md).

        Raises:
            InvalidSceneError, PlacementError: no episode can start from these.
            InvalidConfigError: unknown options, or a nudge out of range.
        """
        super().reset(seed=seed)
        self._running = False
        self._episode.start(self.np_random, options)
        self._running = True
        words = self.task.instruction(self._episode.simulation.scene)
        info = score_info(Scores()) | {"instruction": words}
        return copy_arrays(self._episode.observer.out), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act for one control step of 1/8 s.

        Raises:
            InvalidActionError: not an integer from 0 to 17, or for continuous actions not three
                numbers from -1 to 1; the episode is unchanged.
            ResetNeededError: before the first reset, or after the episode's end.
            InvalidScoreError: the task's score at the episode's end is not a number from 0 to 1.
        """
        if not self._running:
            raise ResetNeededError(
                "step: expected a running episode, found none (not reset yet, or ended); "
                "call reset() first"
            )
        truncated = self._episode.step(self.action_spec.checked(action))
        self._running = not truncated
        reward, scores = self._episode.outcome(truncated)
        return copy_arrays(self._episode.observer.out), reward, False, truncated, score_info(scores)

    def render(self) -> NDArray[np.uint8] | None:
        """Both views side by side, egocentric left: uint8 (384, 768, 3).

        Returns `None` without a render mode, with a warning.
        """
        if self.render_mode is None:
            gym.logger.warn('no frames: make the environment with render_mode="rgb_array"')
            return None
        from magical.render import render_views  # imports numba: only when something is rendered

        self._require_episode("render")
        return render_views(self._episode.simulation.scene, self._episode.poses)

    def state(self) -> State:
        """The true state, for experts and privileged learners."""
        self._require_episode("state")
        return self._episode.state()

    def scores(self) -> Scores:
        """The current state's scores, at any step; raises `InvalidScoreError`."""
        self._require_episode("scores")
        return self._episode.scores()

    def get_state(self) -> dict[str, Any]:
        """JSON-compatible data from which `set_state` continues.

        It holds the scene, the dynamics, the actions so far, the bodies (poses and velocities) and
        the random generator's state; and `exact`, False if this episode was itself continued from a
        state whose actions led to other bodies here.
        """
        self._require_episode("get_state")
        return self._episode.save(self.np_random)

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
        """
        self._running = False
        saved = parse_state(state, self.task, self.action_spec)
        departure = self._episode.restore(saved)
        saved.restore_rng(self.np_random)
        self._running = len(self._episode.actions) < self._episode.horizon
        warn_of_departure(departure)
        return copy_arrays(self._episode.observer.out)

    def __reduce__(self) -> NoReturn:
        raise not_picklable("MagicalEnv", "MagicalEnv(...)")

    def get_keys_to_action(self) -> dict[tuple[str, ...], Any]:
        """Keys for `gymnasium.utils.play`: w, s drive, a, d turn, space closes the fingers."""
        actions = self.action_spec.convert(np.array(list(KEYS_TO_ACTION.values())))
        return dict(zip(KEYS_TO_ACTION, actions, strict=True))

    def _require_episode(self, what: str) -> None:
        if not hasattr(self._episode, "simulation"):
            raise ResetNeededError(f"{what}: there is no episode yet; call reset() first")


def not_picklable(name: str, constructor: str) -> NotPicklableError:
    """The error for an attempt to pickle or copy an environment."""
    return NotPicklableError(
        f"{name} cannot be pickled or copied: its simulation is not plain data; make another one "
        f"with {constructor}, and carry the episode over with get_state and set_state"
    )


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


def score_info(scores: Scores) -> dict[str, Any]:
    """The entries that every `info` has."""
    values = dict(zip(SCORE_KEYS, (scores.score, scores.published_code), strict=True))
    return {**values, "is_success": scores.is_success}
