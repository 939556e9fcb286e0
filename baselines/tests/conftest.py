"""Small demonstrations made of pictures; everything here needs PyTorch."""

from importlib.util import find_spec

import numpy as np
import pytest

from magical.demos import DatasetWriter, Trajectory
from magical.demos.generate import demonstrate
from magical.envs import EnvId
from magical.tasks import get_task

# What needs PyTorch cannot even be imported without it.
collect_ignore_glob = [] if find_spec("torch") else ["*test_*.py"]

STEPS = 12
TASKS = ("MoveToCorner", "MoveToRegion")


def picture_demo(task, seed, actions=None):
    """Random pictures; the brightness of a corner tells the action."""
    rng = np.random.default_rng((seed, sum(task.encode())))
    if actions is None:
        actions = rng.integers(0, 18, STEPS)
        actions[0], actions[1] = 0, 5  # a no-op, and something else
    frames = rng.integers(0, 256, (2, len(actions) + 1, 96, 96, 3), dtype=np.uint8)
    frames[:, :-1, :48, :48] = (np.asarray(actions) * 14)[None, :, None, None, None]
    scene, _ = get_task(task).sample("Demo", rng)
    return Trajectory(
        env_id=EnvId(task, "Demo"),
        scene=scene,
        actions=np.asarray(actions),
        published_code_score=1.0,
        frames={"ego": frames[0], "allo": frames[1]},
    )


def write_demos(path, trajectories):
    writer = DatasetWriter(path)
    for trajectory in trajectories:
        writer.append(trajectory)
    return path


@pytest.fixture(scope="session")
def trajectories():
    """Four demonstrations of each of two tasks."""
    return [picture_demo(task, seed) for seed in range(4) for task in TASKS]


@pytest.fixture(scope="session")
def demos(tmp_path_factory, trajectories):
    """The same as a dataset."""
    return write_demos(tmp_path_factory.mktemp("demos") / "data", trajectories)


@pytest.fixture(scope="session")
def expert_demos(tmp_path_factory):
    """Two demonstrations of each of two tasks by the scripted experts, with poses."""
    demonstrations = [
        demonstrate(EnvId(task, "Demo"), seed=seed)
        for task in ("MoveToRegion", "FixColour")
        for seed in range(2)
    ]
    return write_demos(tmp_path_factory.mktemp("expert") / "data", demonstrations)
