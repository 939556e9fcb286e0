"""What finds the objects in place of the parser."""

import numpy as np
import pytest

from baselines.tests.tiny_runs import tiny
from magical.errors import PluginError, UnknownNameError
from magical_baselines import load_policy, train
from magical_goals.object_bc import ObjectBCConfig
from magical_goals.objects.parser import get_perception, parse_frames
from magical_goals.program_bc import ProgramBCConfig

seen = []


def count(frames, robot_alone=False):
    """Parses, and counts frames."""
    seen.append(len(frames))
    return parse_frames(frames, robot_alone)


def nothing(frames, robot_alone=False):
    """No perception."""


def single(frames, robot_alone=False):
    """Of another precision."""
    parsed = parse_frames(frames, robot_alone)
    return parsed._replace(robot=parsed.robot.astype(np.float32))


def plain(frames):
    """A perception that cannot be asked for the robot alone."""
    return parse_frames(frames)


def config(kind, demos, perception):
    fields = {"tasks": ("FixColour",), "demos": str(demos), "batches": 2, "batch_size": 8}
    return tiny(kind, "paper", **fields, perception=perception)


@pytest.mark.parametrize("kind", [ObjectBCConfig, ProgramBCConfig])
def test_training_and_acting_take_it(kind, expert_demos, tmp_path):
    seen.clear()
    assert train(config(kind, expert_demos, f"{__name__}:count"), tmp_path / "run").finished
    assert sum(seen) > 20  # the demonstrations' frames
    policy = load_policy(tmp_path / "run", device="cpu")
    policy.reset(np.ones(1, bool))
    seen.clear()
    stack = np.full((1, 96, 96, 12), 255, np.uint8)
    policy.act(stack, ["magical/FixColour-Demo-v0"], np.random.default_rng(0))
    assert seen


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("seen", r"seen.: fails for a white frame: TypeError: 'list'"),
        ("plain", r"plain.: fails for a white frame: TypeError: plain"),
        ("nothing", "expected ParsedFrames of float64 .*found NoneType"),
        ("single", r"expected ParsedFrames of float64 .*found float32 \(1, 3\), "),
    ],
)
def test_others_are_refused(name, message, expert_demos):
    with pytest.raises(PluginError, match=message):
        get_perception(f"{__name__}:{name}")
    with pytest.raises(UnknownNameError, match=r"perception 'eyes' is unknown; .*module:NAME"):
        config(ObjectBCConfig, expert_demos, "eyes")
