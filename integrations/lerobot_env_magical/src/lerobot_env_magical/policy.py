"""LeRobot's policies as policies of the package: `magical evaluate lerobot:PATH`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import PolicyFeature
from lerobot.envs.utils import env_to_policy_features, preprocess_observation
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import ACTION

from lerobot_env_magical.config import MagicalEnvConfig
from lerobot_env_magical.observation import ROBOT_STATE, VIEWS, VIEWS_AND_ROBOT
from magical.envs import EnvId, parse_env_id
from magical.errors import PolicyError


class LeRobotPolicy:
    """A trained policy of LeRobot, shown what `lerobot-eval` shows it, on the CPU.

    Its instruction is the task's summary. All environments of a batch begin
    their episodes together.

    Args:
        path: a folder that LeRobot's `save_pretrained` wrote, with its processors.

    Raises:
        PolicyError: no such folder, or features that the environment does not have.
    """

    observation = VIEWS_AND_ROBOT
    action_space = "continuous"

    def __init__(self, path: str) -> None:
        if not (Path(path) / "config.json").is_file():
            raise PolicyError(f"lerobot:{path}: expected a folder with LeRobot's config.json")
        config = PreTrainedConfig.from_pretrained(path)
        config.pretrained_path, config.device = Path(path), "cpu"
        _require_known_features(path, {**config.input_features, **config.output_features})
        self._policy = get_policy_class(config.type).from_pretrained(path, config=config).eval()
        self._before, self._after = make_pre_post_processors(
            config,
            pretrained_path=path,
            preprocessor_overrides={"device_processor": {"device": "cpu"}},
        )
        self._begins = True

    def reset(self, mask: np.ndarray[Any, Any]) -> None:
        """Forget the queue of actions."""
        if not mask.all():
            raise PolicyError("a policy of LeRobot has one queue: all episodes begin together")
        self._policy.reset()
        self._begins = True

    def act(self, observations: Any, env_ids: Sequence[EnvId], rng: np.random.Generator) -> Any:
        """Actions (B, 3) float32, clipped to -1 and 1."""
        if self._begins:
            torch.manual_seed(int(rng.integers(2**31, size=len(env_ids))[0]))
            self._begins = False
        pixels = {str(view): observations[view].copy() for view in VIEWS}
        batch = preprocess_observation(
            {"pixels": pixels, ROBOT_STATE: observations[ROBOT_STATE].copy()}
        )
        batch["task"] = [parse_env_id(env_id).task_spec.summary for env_id in env_ids]
        with torch.inference_mode():
            actions = self._after(self._policy.select_action(self._before(batch)))
        return np.clip(actions.numpy(), -1, 1)


def _require_known_features(path: str, found: dict[str, PolicyFeature]) -> None:
    """Raise `PolicyError` for features that the environment lacks, or has of another shape."""
    offered = env_to_policy_features(MagicalEnvConfig())
    wrong = [
        f"{name} {tuple(feature.shape)} (expected {tuple(offered[name].shape)})"
        if name in offered
        else f"{name} (unknown)"
        for name, feature in found.items()
        if name not in offered or tuple(feature.shape) != tuple(offered[name].shape)
    ]
    if wrong or ACTION not in found:
        raise PolicyError(
            f"lerobot:{path}: expected features among {', '.join(sorted(offered))}, with the "
            f"action; found {', '.join(wrong) or 'no action'}"
        )
