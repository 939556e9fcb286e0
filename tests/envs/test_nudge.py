"""Initial poses that are shifted by less than anything can show."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError, InvalidSceneError
from magical.scene import Block, Colour, Pose, Scene, Shape
from magical.scene.constants import MAX_NUDGE, SQUARE_SIDE
from magical.scene.geometry import to_workspace
from magical.tasks import TASKS

NUDGE = 1e-9


def _poses(env: MagicalEnv) -> Any:
    return env.state().poses.bodies.copy()


@pytest.mark.parametrize("task", TASKS)
def test_a_nudge_moves_robot_and_blocks_and_cannot_be_seen(task: str) -> None:
    env = MagicalEnv(task, "Demo", observation="LoRes4E")
    exact_frames, _ = env.reset(seed=0)
    exact = _poses(env)
    frames, _ = env.reset(seed=0, options={"nudge": NUDGE})
    shift = np.abs(_poses(env) - exact)
    moved = np.r_[0, 5 : len(shift)]  # the robot and the blocks
    assert shift[moved].max() <= NUDGE * 1.001
    assert shift[moved].min() > 0
    assert np.array_equal(frames, exact_frames)


def test_a_nudge_is_sampled_from_the_seed() -> None:
    env = MagicalEnv("MoveToCorner", "TestJitter", observation="state")
    starts = []
    for seed, nudge in ((3, NUDGE), (3, NUDGE), (4, NUDGE), (3, 0.0)):
        env.reset(seed=seed, options={"nudge": nudge})
        starts.append(_poses(env))
    assert np.array_equal(starts[0], starts[1])
    assert np.abs(starts[0] - starts[2]).max() > 1e-3  # another scene
    assert 0 < np.abs(starts[0] - starts[3]).max() < 1e-8
    env.reset(seed=3, options={"nudge": np.float64(NUDGE)})
    assert np.array_equal(starts[0], _poses(env))
    env.reset(seed=3, options={"nudge": np.float32(NUDGE)})


def test_a_nudged_episode_can_be_saved_and_continued() -> None:
    env = MagicalEnv("MoveToRegion", "Demo", observation="state")
    env.reset(seed=5, options={"nudge": NUDGE})
    env.step(1)
    other = MagicalEnv("MoveToRegion", "Demo", observation="state")
    other.set_state(env.get_state())
    assert np.array_equal(_poses(env), _poses(other))


def test_the_vector_environment_nudges_each_episode_as_the_single_one_does() -> None:
    seeds = [1, 2]
    ids = [EnvId("FindDupe", "Demo")] * 2
    with closing(MagicalVectorEnv(ids, workers=0, observation="state")) as envs:
        envs.reset(seed=seeds, options={"nudge": NUDGE})
        starts = [state.poses.bodies.copy() for state in envs.states()]
    assert not np.array_equal(starts[0], starts[1])
    for seed, start in zip(seeds, starts, strict=True):
        env = MagicalEnv("FindDupe", "Demo", observation="state")
        env.reset(seed=seed, options={"nudge": NUDGE})
        assert np.array_equal(start, _poses(env))


def test_a_state_after_the_largest_nudge_can_be_set() -> None:
    """The Demo poses of ClusterShape's TestShape already reach into a wall."""
    env = MagicalEnv("ClusterShape", "TestShape", observation="state")
    for seed in range(40):
        env.reset(seed=seed, options={"nudge": MAX_NUDGE})
        env.set_state(env.get_state())


def test_whatever_scene_can_be_nudged_its_state_can_be_set() -> None:
    """Blocks that overlap as far as a scene may, and then by the nudge; further ones cannot start.

    Two squares at one pose once passed, and only their nudged scene was found to overlap.
    """
    env, started = MagicalEnv("MakeLine", "Demo", observation="state"), 0
    for seed in range(40):
        x, y, angle = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
        first = Pose(0.6 + 0.1 * x, -0.6 + 0.1 * y, np.pi * angle)
        second = Pose(*to_workspace((0.0, (seed % 2) * (SQUARE_SIDE - 0.005)), first), first.angle)
        pair = tuple(Block(Shape.SQUARE, Colour.RED, pose) for pose in (first, second))
        scene = Scene(Pose(0.0, 0.0, 0.0), pair)
        try:
            env.reset(seed=seed, options={"scene": scene, "nudge": MAX_NUDGE})
        except InvalidSceneError:
            continue
        started += 1
        env.set_state(env.get_state())
    assert started == 20


@pytest.mark.parametrize("nudge", [-1e-9, 2 * MAX_NUDGE, float("nan"), "1e-9", True])
def test_nudges_out_of_range(nudge: Any) -> None:
    with pytest.raises(InvalidConfigError, match="nudge: expected a number from 0 to"):
        MagicalEnv("MoveToRegion", "Demo").reset(options={"nudge": nudge})
