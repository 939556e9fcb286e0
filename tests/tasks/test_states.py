"""What goals leave to be done in many states at once, beside the plain computation."""

import numpy as np
import pytest

from magical.scene import Pose, Poses, Scene
from magical.scene.poses import FIRST_BLOCK
from magical.tasks import TASKS
from magical.tasks.programs import parse, problem
from magical.tasks.programs.states import Floats, States
from tests.tasks.plain_ways import plain_ways, work

GOALS = (
    "Every(Mismatched(), OutOfRegions())",
    "Each(AllBlocks(), InRegion())",
    "Each(AllBlocks(), InOwnColour())",
    "Each(AllBlocks(), AtWall('left'))",
    "Each(WithColour('red'), Beside(WithColour('red')))",
    "OneOf(AllBlocks(), InCorner('top left'))",
    "OneOf(OddOneOut('colour'), Beside(AllBlocks()))",
    "Exactly(OfRegionColour())",
    "Lined(AllBlocks())",
    "Clustered('shape')",
    "Clustered('colour')",
    "RobotInside()",
    "Undisturbed(AllBlocks())",
    "Together(Every(Mismatched(), OutOfRegions()), Undisturbed(Matched()))",
    "Together(OneOf(AllBlocks(), InRegion()), Lined(AllBlocks()))",
    "Together(Each(AllBlocks(), AtWall('left')), OneOf(AllBlocks(), InRegion()))",
)


def random_bodies(scene: Scene) -> Floats:
    rng = np.random.default_rng(0)
    bodies = np.repeat(Poses.at_rest(scene).bodies[None], 40, axis=0)
    for state in bodies:
        for row in (0, *range(FIRST_BLOCK, len(state))):
            if rng.random() < 0.5:
                state[row, :2] = rng.uniform(-0.85, 0.85, 2)
    return bodies


@pytest.mark.parametrize("task", ["FixColour", "MatchRegions"])
@pytest.mark.parametrize("text", GOALS)
def test_work_is_that_of_the_best_of_the_plain_ways(task: str, text: str) -> None:
    scene, goal = TASKS[task].demo, parse(text)
    bodies = random_bodies(scene)
    states = States(scene, bodies)
    expected = [min(map(work, plain_ways(goal, scene, Poses(each)))) for each in bodies]
    np.testing.assert_allclose(states.work(goal), expected, atol=1e-12)
    np.testing.assert_allclose(states.best_way(goal).sum(axis=1), expected, atol=1e-12)


@pytest.mark.parametrize("text", GOALS)
def test_without_blocks_every_goal_is_a_problem(text: str) -> None:
    scene, goal = Scene(Pose(0.0, 0.0, 0.0), (), ()), parse(text)
    assert problem(goal, scene)
