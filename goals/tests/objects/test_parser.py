"""Objects parsed from rendered frames, against the scenes that were rendered."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from magical.render import Renderer
from magical.scene import (
    COLOURS,
    FINGERS,
    FIRST_BLOCK,
    ROBOT,
    SHAPES,
    Block,
    Colour,
    Pose,
    Poses,
    Region,
    Scene,
    Shape,
    View,
)
from magical.scene.constants import FINGER_OPEN, SQUARE_SIDE
from magical.tasks import TASKS, get_task
from magical_goals.objects.parser import parse_frames


def render(scene, bodies):
    frame = np.empty((96, 96, 3), np.uint8)
    states = np.zeros((len(bodies), 6))
    states[:, :3] = bodies
    Renderer(scene, View.ALLO, 96).render(states, frame)
    return frame


@pytest.mark.parametrize("task", list(TASKS))
def test_objects_of_random_scenes(task):
    rng = np.random.default_rng(5)
    scenes = [get_task(task).sample("TestAll", rng)[0] for _ in range(12)]
    bodies = [Poses.at_rest(scene).bodies.copy() for scene in scenes]
    for poses in bodies:
        poses[FINGERS, 2] = poses[ROBOT, 2] + rng.uniform(0, FINGER_OPEN, 2) * (1, -1)
    frames = np.stack([render(*pair) for pair in zip(scenes, bodies, strict=True)])
    parsed = parse_frames(frames)
    for t, (scene, poses) in enumerate(zip(scenes, bodies, strict=True)):
        assert parsed.robot[t, :2] == pytest.approx(poses[ROBOT, :2], abs=0.005)
        turned = (parsed.robot[t, 2] - poses[ROBOT, 2] + np.pi) % (2 * np.pi) - np.pi
        assert abs(turned) < 0.08
        open_ = np.abs(poses[FINGERS, 2] - poses[ROBOT, 2])
        assert parsed.fingers[t] == pytest.approx(open_, abs=0.12)
        assert (parsed.colours[t] >= 0).sum() == len(scene.blocks)
        for block, pose in zip(scene.blocks, poses[FIRST_BLOCK:], strict=True):
            nearest = np.hypot(*(parsed.blocks[t] - pose[:2]).T).argmin()
            assert parsed.blocks[t, nearest] == pytest.approx(pose[:2], abs=0.02)
            assert COLOURS[parsed.colours[t, nearest]] == block.colour
            assert SHAPES[parsed.shapes[t, nearest]] == block.shape
        assert (parsed.region_colours[t] >= 0).sum() == len(scene.regions)
        for region in scene.regions:
            true = np.array([*region.centre, region.width / 2, region.height / 2])
            nearest = np.abs(parsed.regions[t] - true).sum(axis=1).argmin()
            assert parsed.regions[t, nearest] == pytest.approx(true, abs=0.03)
            assert COLOURS[parsed.region_colours[t, nearest]] == region.colour


@pytest.mark.parametrize("colours", list(combinations_with_replacement(Colour, 2)))
def test_touching_blocks_are_kept_apart(colours):
    rng = np.random.default_rng(2)
    scenes = [touching_squares(colours, *rng.uniform(-0.3, 0.3, 3)) for _ in range(16)]
    parsed = parse_frames(
        np.stack([render(scene, Poses.at_rest(scene).bodies) for scene in scenes])
    )
    assert ((parsed.colours >= 0).sum(axis=1) == 2).all()
    for t, scene in enumerate(scenes):
        for block in scene.blocks:
            offsets = parsed.blocks[t, :2] - (block.pose.x, block.pose.y)
            nearest = np.hypot(*offsets.T).argmin()
            assert offsets[nearest] == pytest.approx([0.0, 0.0], abs=0.02)
            assert COLOURS[parsed.colours[t, nearest]] == block.colour


def touching_squares(colours, x, y, angle):
    """Two squares side by side without a gap, turned by an angle together."""
    half = SQUARE_SIDE / 2 * np.array([np.cos(angle), np.sin(angle)])
    poses = Pose(x - half[0], y - half[1], angle), Pose(x + half[0], y + half[1], angle)
    blocks = (Block(Shape.SQUARE, colours[k], poses[k]) for k in range(2))
    return Scene(Pose(0.0, -0.8, 0.0), tuple(blocks))


def test_a_region_split_by_the_robot_is_one_region():
    region = Region(Colour.RED, -0.25, 0.25, 0.5, 0.5)
    scene = Scene(Pose(0.0, 0.0, 0.3), (), (region,))
    parsed = parse_frames(render(scene, Poses.at_rest(scene).bodies)[None])
    assert (parsed.region_colours[0] >= 0).sum() == 1
    assert parsed.regions[0, 0] == pytest.approx([0.0, 0.0, 0.25, 0.25], abs=0.03)


def test_the_robot_alone_is_found_where_it_is_among_others():
    scenes = [get_task("FixColour").sample("TestAll", np.random.default_rng(k))[0] for k in (0, 1)]
    frames = np.stack([render(scene, Poses.at_rest(scene).bodies) for scene in scenes])
    alone = parse_frames(frames, robot_alone=True)
    assert np.array_equal(alone.robot, parse_frames(frames).robot)
    assert (alone.colours == -1).all()
