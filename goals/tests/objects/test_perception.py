"""What finds the objects in place of the parser."""

from pathlib import Path

import numpy as np
import pytest

from baselines.tests.tiny_runs import tiny
from magical.demos import observations
from magical.demos.generate import demonstrate
from magical.errors import PluginError, UnknownNameError
from magical_baselines import load_policy, train
from magical_goals.object_bc import ObjectBCConfig
from magical_goals.objects.parser import ABSENT, ParsedFrames, Pixels, get_perception, parse_frames
from magical_goals.program_bc import ProgramBCConfig

NAME = f"{__name__}:count"
seen: list[int] = []


def count(frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """Parses, and counts frames."""
    seen.append(len(frames))
    return parse_frames(frames, robot_alone)


def nothing(frames: Pixels, robot_alone: bool = False) -> None:
    """No perception."""


def single(frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """Of another precision."""
    parsed = parse_frames(frames, robot_alone)
    return parsed._replace(robot=parsed.robot.astype(np.float32))


def config(kind: type[ObjectBCConfig], demos: Path, perception: str) -> ObjectBCConfig:
    fields = {"tasks": ("FixColour",), "demos": str(demos), "batches": 2, "batch_size": 8}
    return tiny(kind, "paper", **fields, perception=perception)


@pytest.mark.parametrize("kind", [ObjectBCConfig, ProgramBCConfig])
def test_training_and_acting_take_it(
    kind: type[ObjectBCConfig], expert_demos: Path, tmp_path: Path
) -> None:
    seen.clear()
    assert train(config(kind, expert_demos, NAME), tmp_path / "run").finished
    assert sum(seen) > 20  # the demonstrations' frames
    policy = load_policy(tmp_path / "run", device="cpu")
    policy.reset(np.ones(1, bool))
    seen.clear()
    stack = np.full((1, 96, 96, 12), 255, np.uint8)
    policy.act(stack, ["magical/FixColour-Demo-v0"], np.random.default_rng(0))
    assert seen


def shuffled(frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """The parser's blocks, backwards: those that are there come last."""
    parsed = parse_frames(frames, robot_alone)
    names = ("blocks", "colours", "shapes")
    return parsed._replace(**{name: getattr(parsed, name)[:, ::-1] for name in names})


def plain(frames: Pixels) -> ParsedFrames:
    """A perception that cannot be asked for the robot alone."""
    return parse_frames(frames)


def test_blocks_may_come_in_any_order() -> None:
    trajectory = demonstrate("magical/FixColour-Demo-v0", seed=3)
    frames = observations(trajectory, "LoRes4A", np.arange(2))[..., -3:]
    found, parsed = get_perception(f"{__name__}:shuffled")(frames), parse_frames(frames)
    blocks = (parsed.colours != ABSENT).sum(axis=1).tolist()
    assert blocks == (found.colours[:, : blocks[0]] != ABSENT).sum(axis=1).tolist()


def test_other_names_are_refused(expert_demos: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"perception 'eyes' is unknown; .*module:NAME"):
        config(ObjectBCConfig, expert_demos, "eyes")
    with pytest.raises(PluginError, match=r"seen.: fails for a white frame: TypeError: 'list'"):
        get_perception(f"{__name__}:seen")
    with pytest.raises(PluginError, match=r"plain.: fails for a white frame: TypeError: plain"):
        get_perception(f"{__name__}:plain")


@pytest.mark.parametrize(
    ("name", "found"), [("nothing", "found NoneType"), ("single", r"found float32 \(1, 3\), ")]
)
def test_what_returns_something_else_is_refused(name: str, found: str) -> None:
    with pytest.raises(PluginError, match=f"expected ParsedFrames of float64 .*{found}"):
        get_perception(f"{__name__}:{name}")
