"""The Gymnasium environment."""

import operator
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from magical.envs.episode import Episode, Scores
from magical.envs.ids import EnvId
from magical.envs.keys import KEYS_TO_ACTION
from magical.errors import InvalidActionError, InvalidStateError, ResetNeededError, UnknownNameError
from magical.observe.spec import Observation, PixelSpec, parse_observation
from magical.observe.vector import StateLayout
from magical.scene.actions import ACTION_NAMES, NUM_ACTIONS
from magical.scene.constants import CONTROL_RATE
from magical.scene.state import State
from magical.tasks import Task, get_task

Reward = Literal["none", "score", "dense"]
RENDER_SIZE = 384  # pixels: the published raw frame


class MagicalEnv(gym.Env[Any, np.int64]):
    """One task in one variant (appendix A.1; docs/specification.md, sections 1 and 7).

    Actions: `Discrete(18)`, named in `ACTION_NAMES`. Observations: see `observe.PixelSpec` and
    `observe.StateLayout`. Episodes are truncated at the horizon and never terminate. The reward is
    0, or with `reward="score"` the score at the last step, or with `reward="dense"` (MoveToCorner,
    MoveToRegion) the increase of the task's `progress` since the last step. `info` always holds
    `eval_score` and `published_code_score`, 0.0 before the last step. `render()` shows both views
    side by side.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": int(CONTROL_RATE),
    }
    action_names = ACTION_NAMES

    def __init__(
        self,
        task: str,
        variant: str,
        observation: Observation = None,
        horizon: int | None = None,
        reward: Reward = "none",
        render_mode: str | None = None,
    ) -> None:
        self.task: Task = get_task(task)
        self.task.axes_of(variant)  # raises for a variant that the task lacks
        self.variant = variant
        self.form = observation_form(self.task, observation)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UnknownNameError(
                f"render mode {render_mode!r} is unknown; expected rgb_array or None"
            )
        self.render_mode = render_mode
        self.observation_space = self.form.space
        self.action_space = spaces.Discrete(NUM_ACTIONS)
        self._episode = Episode(self.task, variant, self.form, horizon, reward)
        self._running = False

    @property
    def env_id(self) -> str:
        """The id of this task and variant, without a preset."""
        return str(EnvId(self.task.name, self.variant))

    @property
    def horizon(self) -> int:
        """Control steps in an episode."""
        return self._episode.horizon

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode from the variant's draw.

        `options` may hold `scene` and `dynamics` (dataclasses, or plain dicts as `to_dict()` makes
        them) to start from instead. Raises `InvalidSceneError` or `PlacementError`.
        """
        super().reset(seed=seed)
        self._running = False
        self._episode.start(self.np_random, options)
        self._running = True
        return self._episode.observer.copy(), score_info(Scores())

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act for one control step of 1/8 s.

        Raises `InvalidActionError`, or `ResetNeededError` before reset and after the end.
        """
        if not self._running:
            raise ResetNeededError(
                "step: expected a running episode, found none (not reset yet, or ended); "
                "call reset() first"
            )
        truncated = self._episode.step(checked_action(action))
        reward, scores = self._episode.outcome(truncated)
        self._running = not truncated
        return self._episode.observer.copy(), reward, False, truncated, score_info(scores)

    def render(self) -> Any:
        """Both views side by side, egocentric left: uint8 (384, 768, 3)."""
        if self.render_mode is None:
            return None
        from magical.render import draw_both  # drawing brings in numba: only when needed

        self._require_episode("render")
        return draw_both(self._episode.world.scene, self._episode.poses, size=RENDER_SIZE)

    def state(self) -> State:
        """The true state, for experts and privileged learners."""
        self._require_episode("state")
        return self._episode.state()

    def scores(self) -> Scores:
        """The present state's scores, at any step."""
        self._require_episode("scores")
        return self._episode.scores()

    def get_state(self) -> dict[str, Any]:
        """Plain data (JSON will do) from which `set_state` continues bit-equally.

        It holds the scene, the dynamics, the actions so far and the random generator's state.
        """
        self._require_episode("get_state")
        return {**self._episode.save(), "rng": self.np_random.bit_generator.state}

    def set_state(self, state: Mapping[str, Any]) -> Any:
        """Continue from `get_state()`'s data, of this or another process; returns the observation.

        The actions so far are simulated again. Raises `InvalidStateError` for data of another task
        or damaged data.
        """
        self._running = False
        self._episode.restore(state)
        try:
            self.np_random.bit_generator.state = state["rng"]
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidStateError(f"saved state has no usable 'rng': {error!r}") from error
        self._running = len(self._episode.actions) < self._episode.horizon
        return self._episode.observer.copy()

    def get_keys_to_action(self) -> dict[tuple[str, ...], int]:
        """Keys for `gymnasium.utils.play`: w, s drive, a, d turn, space closes the fingers."""
        return dict(KEYS_TO_ACTION)

    def _require_episode(self, what: str) -> None:
        if not hasattr(self._episode, "world"):
            raise ResetNeededError(f"{what}: there is no episode yet; call reset() first")


def observation_form(task: Task, observation: Observation) -> PixelSpec | StateLayout:
    """What `observation=` means for a task; raises `UnknownNameError`."""
    form = parse_observation(observation)
    return form if isinstance(form, PixelSpec) else StateLayout(task.max_blocks, task.max_regions)


def checked_action(action: Any) -> int:
    """The action as a Python integer; raises `InvalidActionError`."""
    try:
        number = operator.index(action)
    except TypeError:
        number = -1
    if isinstance(action, (bool, np.bool_)) or not 0 <= number < NUM_ACTIONS:
        raise InvalidActionError(
            f"action: expected an integer from 0 to {NUM_ACTIONS - 1}, found {action!r}"
        )
    return number


def score_info(scores: Scores) -> dict[str, Any]:
    """The keys that every `info` has."""
    return {"eval_score": scores.score, "published_code_score": scores.published_code}
