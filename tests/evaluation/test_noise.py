"""Evaluation noise: initial poses that are shifted by less than anything can show."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError
from magical.evaluation.noise import MAX_NOISE, checked_noise, noisy_start, reset_options
from magical.scene import Poses
from magical.tasks import TASKS

NOISE = 1e-9


@pytest.mark.parametrize("task", TASKS)
def test_noise_moves_robot_and_blocks_and_cannot_be_seen(task: str) -> None:
    env = MagicalEnv(task, "Demo", observation="LoRes4E")
    exact_frames, _ = env.reset(seed=0)
    exact = env.state().poses.bodies
    scene, dynamics = noisy_start(EnvId(task, "Demo"), 0, NOISE)
    frames, _ = env.reset(seed=0, options={"scene": scene, "dynamics": dynamics})
    moved = np.r_[0, 5 : len(exact)]  # the robot and the blocks
    shift = np.abs(env.state().poses.bodies - exact)[moved]
    assert 0 < shift.min() <= shift.max() <= NOISE * 1.001
    assert np.array_equal(frames, exact_frames)


def test_noise_is_sampled_from_the_seed_after_the_scene() -> None:
    env_id = EnvId("MoveToCorner", "TestAll")
    scene, dynamics = noisy_start(env_id, 3, NOISE)
    assert (scene, dynamics) == noisy_start(env_id, 3, NOISE)
    assert scene != noisy_start(env_id, 4, NOISE)[0]
    env = MagicalEnv("MoveToCorner", "TestAll", observation="state")
    env.reset(seed=3)
    assert env.simulation.dynamics == dynamics
    sampled, noisy = (Poses.at_rest(each).bodies for each in (env.state().scene, scene))
    assert 0 < np.abs(sampled - noisy).max() < 1e-8


def test_each_row_of_a_vector_environment_starts_with_its_own_noise() -> None:
    ids, seeds = [EnvId("FindDupe", "Demo")] * 2, [1, 2]
    with closing(MagicalVectorEnv(ids, workers=1, observation="state")) as envs:
        envs.reset(seed=seeds, options=reset_options(ids, seeds, NOISE))
        scenes = [state.scene for state in envs.states()]
    assert scenes == [noisy_start(ids[0], seed, NOISE)[0] for seed in seeds]
    assert reset_options(ids, seeds, 0.0) is None


@pytest.mark.parametrize(
    "env_id", [EnvId("ClusterShape", "TestShape"), EnvId("ClusterColour", "Demo")]
)
def test_scenes_that_touch_still_fit_with_the_most_noise(env_id: EnvId) -> None:
    """The poses of ClusterShape's Demo reach into a wall, and ClusterColour's overlap."""
    for seed in range(20):
        noisy_start(env_id, seed, MAX_NOISE)


@pytest.mark.parametrize("noise", [-1e-9, 2 * MAX_NOISE, float("nan"), "1e-9", True, None])
def test_noise_out_of_range(noise: Any) -> None:
    with pytest.raises(InvalidConfigError, match="evaluation noise: expected a number from 0 to"):
        checked_noise(noise)
