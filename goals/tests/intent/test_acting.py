"""What is moved, and where to, by a belief."""

import numpy as np
import pytest

from magical.scene import FIRST_BLOCK, Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.tasks import TASKS
from magical_goals.intent.acting import Intention
from magical_goals.intent.posterior import Belief, Explanation
from magical_goals.language import parse
from magical_goals.language.expressions import Mismatched
from magical_goals.language.programs import program_of
from magical_goals.objects.control import ROBOT_TARGET

FIX, MATCH = TASKS["FixColour"].demo, TASKS["MatchRegions"].demo
OUT = "Every(Mismatched(), OutOfRegions())"
IN_REGION = "Exactly(OfRegionColour())"


def belief(*programs, unexplained=0.0):
    return Belief([Explanation(parse(text), weight) for text, weight in programs], unexplained, 1.0)


def carry_out(intention, scene, moves):
    """The poses after what was decided was done, as often as anything was."""
    bodies = Poses.at_rest(scene).bodies
    for _ in range(moves):
        decision = intention.decide(Poses(bodies))
        assert decision is not None
        target, place = decision
        bodies[0 if target == ROBOT_TARGET else FIRST_BLOCK + target, :2] = place
    assert intention.decide(Poses(bodies)) is None
    return Poses(bodies)


@pytest.mark.parametrize(
    ("task", "moves"), [("FixColour", 1), ("MatchRegions", 2), ("MoveToRegion", 1), ("MakeLine", 2)]
)
def test_the_papers_programs_are_carried_out_in_the_fewest_moves(task, moves):
    program, scene = program_of(task), TASKS[task].demo
    assert program is not None
    intention = Intention(belief((repr(program), 1.0)), scene)
    assert program.score(scene, carry_out(intention, scene, moves)) == 1.0


def test_the_nearest_of_the_blocks_is_moved_first():
    intention = Intention(belief((IN_REGION, 1.0)), MATCH)
    poses = Poses.at_rest(MATCH)
    (first, _), blocks = intention.decide(poses) or (None, None), parse(IN_REGION).moved(MATCH)
    distances = {i: np.linalg.norm(poses.blocks[i, :2] - poses.robot[:2]) for i in blocks}
    assert first == min(distances, key=lambda i: distances[i])


def test_a_decision_is_kept_while_the_thing_has_to_move():
    intention = Intention(belief((IN_REGION, 1.0)), MATCH)
    first = intention.decide(Poses.at_rest(MATCH))
    bodies = Poses.at_rest(MATCH).bodies
    bodies[0, :2] = 0.8, -0.8  # another block is nearer now
    assert intention.decide(Poses(bodies)) == first


def test_probabilities_are_those_of_the_programs_that_move_a_block():
    all_in = "Each(AllBlocks(), InRegion())"
    intention = Intention(belief((IN_REGION, 0.6), (all_in, 0.2)), MATCH)
    found = intention.probabilities(Poses.at_rest(MATCH))
    of_colour = parse(IN_REGION).moved(MATCH)
    assert set(found) == set(range(len(MATCH.blocks)))
    for block, probability in found.items():
        assert probability == pytest.approx(1.0 if block in of_colour else 0.25)


def test_confidence_is_the_probability_of_what_is_decided():
    poses = Poses.at_rest(FIX)
    divided = Intention(belief((OUT, 0.6), ("RobotInside()", 0.4)), FIX)
    assert divided.confidence(poses) == pytest.approx(0.6)
    done = Intention(belief((OUT, 1.0)), FIX)
    assert done.confidence(carry_out(done, FIX, 1)) == pytest.approx(1.0)
    assert Intention(belief((OUT, 0.2), unexplained=0.8), FIX).confidence(poses) == 0.0


def test_programs_that_are_the_same_goal_in_the_scene_count_together():
    green, yellow = (f"Exactly(WithColour('{name}'))" for name in ("green", "yellow"))
    programs = ((yellow, 0.4), (IN_REGION, 0.35), (green, 0.25))  # the region is green
    intention = Intention(belief(*programs), MATCH)
    assert [weight for _, weight in intention.goals] == pytest.approx([0.6, 0.4])
    assert intention.goals[0][0].moved(MATCH) == parse(green).moved(MATCH)


def test_programs_that_are_no_task_in_the_scene_are_left_out():
    (mismatched,) = Mismatched().blocks(FIX)
    solved = "Every(Enclosed(), InRegion())"
    intention = Intention(belief((solved, 0.9), (OUT, 0.1)), FIX)
    assert intention.probabilities(Poses.at_rest(FIX)) == {mismatched: pytest.approx(1.0)}
    assert not Intention(belief((solved, 1.0)), FIX).is_known
    assert not Intention(belief((OUT, 1.0), unexplained=0.9), FIX).is_known


def test_blocks_go_where_no_others_are_in_the_way():
    circle = Block(Shape.CIRCLE, Colour.RED, Pose(-0.8, 0.0, 0.0))
    wall = [Block(Shape.SQUARE, Colour.BLUE, Pose(-0.5, y, 0.0)) for y in np.linspace(-0.9, 0.9, 9)]
    here = Region.from_centre(Colour.GREEN, -0.75, 0.8, 0.3, 0.4)
    there = Region.from_centre(Colour.GREEN, -0.1, 0.0, 0.4, 0.4)  # nearer, but behind the wall
    scene = Scene(Pose(-0.7, -0.7, 0.0), (circle, *wall), (here, there))
    intention = Intention(belief(("Each(WithShape('circle'), InRegion())", 1.0)), scene)
    decision = intention.decide(Poses.at_rest(scene))
    assert decision is not None
    target, place = decision
    assert target == 0
    assert here.contains(*place)
