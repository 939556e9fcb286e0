"""Scenes, poses and episodes from parsed frames."""

import numpy as np

from magical.scene import COLOURS, SHAPES, Block, Poses, Region, Scene
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical.scene.scene import Pose
from magical_goals.intent.demonstrator import Episode
from magical_goals.objects.data import ParsedDemonstration
from magical_goals.objects.parser import ABSENT, ParsedFrames


def parsed_scene(parsed: ParsedFrames, frame: int) -> Scene:
    """The scene of one frame; blocks are numbered as parsed, with unknown angles set to 0."""
    blocks = [
        Block(SHAPES[shape], COLOURS[colour], Pose(x, y, 0.0))
        for (x, y), colour, shape in zip(
            parsed.blocks[frame], parsed.colours[frame], parsed.shapes[frame], strict=True
        )
        if colour != ABSENT
    ]
    regions = [
        Region.from_centre(COLOURS[colour], x, y, 2 * half_height, 2 * half_width)
        for (x, y, half_width, half_height), colour in zip(
            parsed.regions[frame], parsed.region_colours[frame], strict=True
        )
        if colour != ABSENT
    ]
    return Scene(Pose(*parsed.robot[frame]), tuple(blocks), tuple(regions))


def parsed_poses(parsed: ParsedFrames, frame: int, scene: Scene) -> Poses:
    """The poses in a frame of an episode that started from the scene and was tracked since."""
    bodies = Poses.at_rest(scene).bodies
    bodies[ROBOT] = parsed.robot[frame]
    bodies[FIRST_BLOCK:, :2] = parsed.blocks[frame, : len(scene.blocks)]
    return Poses(bodies)


def parsed_episode(shown: ParsedDemonstration, rng: np.random.Generator) -> Episode:
    """A demonstration as the moves that were made."""
    parsed, scene = shown.parsed, parsed_scene(shown.parsed, 0)
    if shown.carries:  # where a carry leaves the robot is not a goal
        parsed = parsed._replace(robot=np.repeat(parsed.robot[:1], len(parsed.robot), axis=0))
    states, ends = ([parsed_poses(parsed, t, scene) for t in frames] for frames in moves(shown))
    return Episode(scene, states, ends, rng)


def moves(shown: ParsedDemonstration) -> tuple[list[int], list[int]]:
    """The frames in which moves start, with the final one, and those in which they end.

    Moves are the carries or, without any, the way of the robot. Each starts where the last one
    ended, unless a watched policy acted in between.
    """
    demonstrated = shown.trajectory.is_demonstrated
    spans = [(first, last + 1) for _, first, last in shown.carries]
    if not spans:
        others = np.flatnonzero(~demonstrated[: shown.end])
        spans = [(int(others[-1]) + 1 if len(others) else 0, shown.end)]
    ends = [end for _, end in spans]
    starts = [
        before if demonstrated[before:start].all() else start
        for before, (start, _) in zip([0, *ends], [*spans, (shown.end, shown.end)], strict=True)
    ]
    return starts, ends
