"""Evaluation noise: initial poses, shifted by less than anything can show.

On Demo every rollout starts from one scene, so rounding decides what a deterministic policy scores.
With noise, an average over rollouts is one over roundings (docs/determinism.md).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from magical.envs import EnvId
from magical.errors import InvalidConfigError, InvalidSceneError, PlacementError
from magical.messages import quoted
from magical.scene import Dynamics, Pose, Scene

# Units and radians. Two bodies may then still overlap as far as those of any sampled scene.
MAX_NOISE = 1e-4
MAX_SCENES = 1000  # shifted at most for one rollout


def checked_noise(noise: Any) -> float:
    """The largest shift, in units and radians; raises `InvalidConfigError`."""
    number = isinstance(noise, float | int | np.floating | np.integer)
    if not number or isinstance(noise, bool) or not 0.0 <= noise <= MAX_NOISE:
        raise InvalidConfigError(
            f"evaluation noise: expected a number from 0 to {MAX_NOISE}, found {quoted(noise)}"
        )
    return float(noise)


def noisy_start(env_id: EnvId, seed: int, noise: float) -> tuple[Scene, Dynamics]:
    """The scene and dynamics that an environment samples for a seed, with noise from this seed.

    Robot and blocks are shifted and turned by uniform samples up to `noise`. Raises
    `PlacementError` if none of `MAX_SCENES` such scenes fits the task.
    """
    task, (rng, _) = env_id.task_spec, seeding.np_random(seed)
    scene, dynamics = task.sample(env_id.variant, rng)

    def shift(pose: Pose) -> Pose:
        return Pose(*(pose + rng.uniform(-noise, noise, size=3)).tolist())

    for _ in range(MAX_SCENES):
        robot = shift(scene.robot)
        blocks = tuple(replace(block, pose=shift(block.pose)) for block in scene.blocks)
        noisy = replace(scene, robot=robot, blocks=blocks)
        with suppress(InvalidSceneError):
            task.validate(noisy)
            return noisy, dynamics
    raise PlacementError(f"{env_id}: none of {MAX_SCENES} scenes with noise {noise:g} fits")


def reset_options(
    env_ids: Sequence[EnvId], seeds: Sequence[int], noise: float
) -> dict[str, Any] | None:
    """The options to reset a vector environment with, so that each row starts with noise."""
    if not noise:
        return None
    starts = [noisy_start(each, seed, noise) for each, seed in zip(env_ids, seeds, strict=True)]
    return {"scene": [scene for scene, _ in starts], "dynamics": [forces for _, forces in starts]}
