"""An adapter to Stable-Baselines3's `VecEnv`; only this module needs Stable-Baselines3."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from magical.envs.env import SCORE_KEYS
from magical.envs.vector import MagicalVectorEnv
from magical.extras import require

require("sb3")

from stable_baselines3.common.vec_env import VecEnv  # noqa: E402

Indices = int | Iterable[int] | None


class MagicalSB3VecEnv(VecEnv):
    """A `MagicalVectorEnv` as Stable-Baselines3 expects it.

    Observations, actions and autoreset follow its conventions: a step that ends an episode
    returns the next episode's first observation, and `infos[i]` holds the last one as
    `terminal_observation`, `TimeLimit.truncated` (always True: episodes end at the horizon only)
    and the scores (0.0 in all other infos). Images keep their layout; Stable-Baselines3 transposes
    channels-last images itself if its networks need it.

    `get_attr` returns attributes of the vector environment, and for `env_ids` each
    sub-environment's own. `env_method` calls methods that take an index (`get_state`,
    `set_state`).

    Args:
        envs: made with `autoreset_mode="SameStep"`, and with `reward="score"` or `"dense"` if
            a policy will be trained on rewards.

    Raises `ValueError` for another autoreset mode, and for `copy=False`: Stable-Baselines3 keeps
    observations beyond the next step.
    """

    def __init__(self, envs: MagicalVectorEnv) -> None:
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                "Stable-Baselines3 expects autoreset_mode='SameStep', found "
                f"{envs.autoreset_mode.value!r}; make the vector environment with "
                "'SameStep'"
            )
        if not envs.copy:
            raise ValueError(
                "Stable-Baselines3 keeps observations: expected copy=True, found copy=False; make "
                "the vector environment with copy=True"
            )
        self.envs = envs
        self._actions: Any = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self.metadata = {**self.metadata, "render_fps": envs.metadata["render_fps"]}

    def reset(self) -> Any:
        """Start an episode in every sub-environment, with the seeds and options set beforehand."""
        first = self._options[0]
        if any(options != first for options in self._options):
            raise ValueError("reset options: expected the same for all environments; see set_state")
        seeded = any(seed is not None for seed in self._seeds)
        observations, infos = self.envs.reset(
            seed=self._seeds if seeded else None, options=first or None
        )
        self.reset_infos = [_scores(infos, row) for row in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.integer[Any]]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Act; returns observations, rewards, episode ends and infos."""
        observations, rewards, _, ended, infos = self.envs.step(self._actions)
        each = [
            _scores(infos, row) | {"TimeLimit.truncated": False} for row in range(self.num_envs)
        ]
        for row in np.flatnonzero(ended).tolist():
            each[row] = {
                **_scores(infos["final_info"], row),
                "TimeLimit.truncated": True,
                "terminal_observation": infos["final_obs"][row],
            }
        return observations, rewards.astype(np.float32), ended, each

    def close(self) -> None:
        """End the workers."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the vector environment, once for each sub-environment."""
        value = getattr(self.envs, attr_name)
        each = value if attr_name == "env_ids" else [value] * self.num_envs
        return [each[row] for row in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Raises `AttributeError`: sub-environments can be in other processes."""
        raise AttributeError(f"set_attr: {attr_name!r} of a sub-environment cannot be set")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method that takes a sub-environment's index as its first argument."""
        method = getattr(self.envs, method_name)
        return [method(row, *method_args, **method_kwargs) for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Always False: sub-environments have no wrappers."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Every sub-environment's frame, with `render_mode="rgb_array"`."""
        return self.envs.render() or [None] * self.num_envs


def _scores(infos: dict[str, Any], row: int) -> dict[str, Any]:
    scores = {key: float(infos[key][row]) for key in SCORE_KEYS}
    return {**scores, "is_success": bool(infos["is_success"][row])}
