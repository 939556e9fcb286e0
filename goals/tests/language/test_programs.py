"""The language of goals: types, text, meaning, words, and the dense reward."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magical.envs.env import MagicalEnv
from magical.errors import InvalidProgramError, NoExpertError, UnknownNameError
from magical.experts import rollout
from magical.scene import FIRST_BLOCK, ROBOT, Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical.tasks import TASKS
from magical_goals.language import VOCABULARY, Goal, parse, problem, progress
from magical_goals.language.expressions import Place, Selection
from magical_goals.language.goals import UNFINISHED, Lined, States, ways_at_start
from magical_goals.language.parsing import bits_of_part
from magical_goals.language.planner import program_planner
from magical_goals.language.programs import PROGRAMS, dense, program_of
from tests.tasks.conftest import move

GOALS = (
    "Every(Mismatched(), OutOfRegions())",
    "Each(AllBlocks(), InRegion())",
    "Each(AllBlocks(), InOwnColour())",
    "Each(AllBlocks(), AtWall('left'))",
    "Each(WithColour('green'), Beside(WithColour('green')))",
    "OneOf(AllBlocks(), InCorner('top left'))",
    "OneOf(OddOneOut('colour'), Beside(AllBlocks()))",
    "Exactly(OfRegionColour())",
    "Lined(AllBlocks())",
    "Clustered('shape')",
    "RobotInside()",
    "Undisturbed(AllBlocks())",
    "Together(Every(Mismatched(), OutOfRegions()), Undisturbed(Matched()))",
    "Together(OneOf(AllBlocks(), InRegion()), Lined(AllBlocks()))",
)

# Two red blocks of three outside the blue region, one blue inside.
SCENE = Scene(
    robot=Pose(0.0, -0.7, 0.0),
    blocks=(
        Block(Shape.STAR, Colour.RED, Pose(-0.6, 0.6, 0.0)),
        Block(Shape.SQUARE, Colour.RED, Pose(-0.6, -0.5, 0.0)),
        Block(Shape.STAR, Colour.GREEN, Pose(0.0, 0.0, 0.0)),
        Block(Shape.STAR, Colour.BLUE, Pose(0.6, 0.6, 0.0)),
    ),
    regions=(Region.from_centre(Colour.BLUE, 0.6, 0.6, 0.5, 0.5),),
)


def final(places):
    return move(SCENE, places)


def random_bodies(scene, rng, count=20):
    """Poses (count, 5 + N, 3) with some of the blocks, and the robot, elsewhere."""
    bodies = np.repeat(Poses.at_rest(scene).bodies[None], count, axis=0)
    for state in bodies:
        rows = [row for row in (ROBOT, *range(FIRST_BLOCK, len(state))) if rng.random() < 0.6]
        state[rows, :2] = rng.uniform(-0.85, 0.85, (len(rows), 2))
        for region in scene.regions:
            if rng.random() < 0.5:
                state[rows, :2] = np.add(region.centre, rng.uniform(-0.3, 0.3, (len(rows), 2)))
    return bodies


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_papers_tasks_score_as_their_programs(name):
    task, program, rng, scores = TASKS[name], PROGRAMS[name], np.random.default_rng(0), set()
    for variant in task.variants:
        for _ in range(6):
            scene, _ = task.sample(variant, rng)
            assert task.instruction(scene) == program.instruction(scene)
            for bodies in random_bodies(scene, rng):
                found = task.score(scene, Poses(bodies))
                assert found == pytest.approx(program.score(scene, Poses(bodies)), abs=1e-15)
                scores.add(found)
    assert len(scores) > 1


@pytest.mark.parametrize(
    ("selection", "blocks"),
    [
        ("AllBlocks()", {0, 1, 2, 3}),
        ("WithColour('red')", {0, 1}),
        ("WithShape('star')", {0, 2, 3}),
        ("OfRegionColour()", {3}),
        ("Enclosed()", {3}),
        ("Outside()", {0, 1, 2}),
        ("LikeEnclosed('shape')", {0, 2, 3}),
        ("And(Outside(), LikeEnclosed('shape'))", {0, 2}),
        ("OddOneOut('shape')", {1}),
        ("OddOneOut('colour')", set()),  # two of them
        ("MostCommon('colour')", {0, 1}),
        ("MostCommon('kind')", set()),  # none is
        ("Nearest('region')", {3}),
        ("Farthest('region')", {1}),
        ("Nearest('robot')", set()),  # two are as near
        ("Nearest('centre')", {2}),
        ("AllBut(WithColour('red'))", {2, 3}),
        ("Or(WithColour('green'), WithShape('square'))", {1, 2}),
    ],
)
def test_selections(selection, blocks):
    goal = parse(f"Lined({selection})")
    assert isinstance(goal, Lined)
    assert goal.selection.blocks(SCENE) == blocks


INSIDE, OUTSIDE = (0.6, 0.6), (0.0, 0.5)


@pytest.mark.parametrize(
    ("goal", "places", "expected"),
    [
        ("Each(WithColour('red'), InRegion())", {0: INSIDE}, 0.5),
        ("Each(WithColour('red'), InRegion())", {0: INSIDE, 1: INSIDE}, 1.0),
        ("Exactly(WithColour('red'))", {0: INSIDE, 1: INSIDE}, 2 / 3),  # the blue one is there, too
        ("Exactly(WithColour('red'))", {0: INSIDE, 1: INSIDE, 3: OUTSIDE}, 1.0),
        ("OneOf(WithColour('red'), InRegion())", {1: INSIDE}, 1.0),
        ("Each(WithShape('square'), InCorner('bottom left'))", {}, 1.0),
        ("Each(WithShape('square'), InCorner('bottom left'))", {1: (0.0, 0.0)}, 0.0),
        ("Each(WithShape('square'), InCorner('bottom left'))", {1: (-0.25, -0.25)}, 0.5),
        ("Each(WithColour('red'), AtWall('left'))", {1: (-0.69, 0.0)}, 0.0),
        ("Each(WithColour('red'), AtWall('left'))", {0: (-0.71, 0.0)}, 0.5),
        ("Each(WithColour('green'), AtWall('right'))", {2: (0.71, 0.0)}, 1.0),
        ("Each(WithColour('green'), AtWall('bottom'))", {2: (0.0, -0.71)}, 1.0),
        ("Each(WithColour('green'), AtWall('top'))", {2: (0.0, 0.71)}, 1.0),
        ("Each(WithColour('blue'), InCorner('top right'))", {}, 1.0),
        ("Each(WithColour('red'), Beside(WithColour('green')))", {0: (-0.4, 0.0)}, 0.5),
        ("Lined(WithColour('red'))", {0: (0.0, 0.0), 1: (0.41, 0.0)}, 1.0),
    ],
)
def test_scores(goal, places, expected):
    program = parse(goal)
    assert program.score(SCENE, final(places)) == pytest.approx(expected)
    ways = program.ways(States(SCENE, final(places).bodies[None]))[0]
    assert (~ways.any(axis=1)).any() == (expected == 1.0)


@pytest.mark.parametrize(
    ("goal", "places", "block", "way"),
    [
        # Another block has less to go to the region, and is farther from the robot.
        ("OneOf(WithColour('red'), InRegion())", {0: (0.1, 0.6), 1: (0.05, -0.05)}, 1, 0.5),
        # A line through the first two blocks needs one move, others less in all of two.
        (
            "Lined(AllBut(WithColour('blue')))",
            {0: (0.0, 0.0), 1: (0.4, 0.0), 2: (0.8, 0.48)},
            2,
            0.3,
        ),
    ],
)
def test_progress_is_that_of_the_best_way(goal, places, block, way):
    program, poses = parse(goal), final(places)
    x, y, _ = poses.robot
    between_fingers = x, y + ROBOT_RADIUS + BLOCK_SIZE
    expected = -(UNFINISHED + way) - math.dist(between_fingers, places[block])
    assert progress(program, SCENE, poses) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (
            "Each(WithColour('red'), InRegion())",
            "Push the red star and the red square into the blue region.",
        ),
        ("Each(Nearest('centre'), AtWall('top'))", "Push the green star to the top wall."),
        ("Lined(AllBlocks())", "Arrange all blocks in a line."),
        ("OneOf(AllBlocks(), AtWall('left'))", "Push a block to the left wall."),
        (
            "Exactly(OddOneOut('shape'))",
            "Push the red square into the blue region. Keep all other blocks out of the blue "
            "region.",
        ),
    ],
)
def test_instructions_name_the_blocks(goal, words):
    assert parse(goal).instruction(SCENE) == words


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Each(WithColour('pink'), InRegion())", "WithColour, colour: 'pink' is not a colour"),
        ("Each(InRegion(), InRegion())", "Each, selection: expected a selection, found"),
        ("Each(AllBlocks())", r"Each\(AllBlocks\(\)\)'.*missing 1 required"),
        ("Some(AllBlocks(), InRegion())", "Some is unknown; expected one of: AllBlocks,"),
        ("AllBlocks()", "expected a goal, found a AllBlocks"),
        ("Each(AllBlocks(), InRegion()", "expected an expression such as"),
        ("__import__('os')", "__import__ is unknown"),
        ("Lined(AllBlocks)", "expected a name with its arguments"),
        ("(" * 2000, "expected an expression such as"),
        ("1" + "+1" * 2000, "nested too deeply"),
        ("Lined(AllBlocks())" + " " * 5000, "expected at most 5000 characters"),
    ],
)
def test_text_that_is_no_program_is_refused(text, message):
    with pytest.raises(InvalidProgramError, match=message):
        parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Each(WithColour('yellow'), InRegion())", "WithColour('yellow') selects no block"),
        ("Each(WithColour('red'), InOwnColour())", "there is no such place in the scene"),
        ("Lined(WithColour('green'))", "there is no such place in the scene"),
        ("Each(Enclosed(), InRegion())", "is solved at the start"),
    ],
)
def test_what_no_episode_can_have_as_goal_is_a_problem(text, message):
    assert message in problem(parse(text), SCENE)


def test_a_cluster_that_another_colours_block_lies_in_is_not_done():
    red, blue, green = Colour.RED, Colour.BLUE, Colour.GREEN
    apart = [(green, 0.9, 0.9), (green, -0.9, 0.9)]
    places = [(blue, 0.0, 0.4), (blue, 0.0, 0.1), (red, 0.1, 0.25), *apart]
    blocks = tuple(Block(Shape.SQUARE, colour, Pose(x, y, 0.0)) for colour, x, y in places)
    scene = Scene(Pose(-0.5, -0.5, 0.0), blocks, ())
    (way,) = ways_at_start(parse("Clustered('colour')"), scene)
    assert way[[0, 1]].all()


@pytest.mark.parametrize("text", GOALS)
def test_nothing_is_left_to_do_exactly_where_the_score_is_one(text):
    scene, goal = TASKS["FixColour"].demo, parse(text)
    bodies = random_bodies(scene, np.random.default_rng(0), 60)
    states = States(scene, bodies)
    solved = [goal.score(scene, Poses(each)) == 1.0 for each in bodies]
    assert (states.work(goal) == 0.0).tolist() == solved
    np.testing.assert_allclose(states.best_way(goal).sum(axis=1), states.work(goal))
    alone = [States(scene, each[None]).work(goal)[0] for each in bodies]
    np.testing.assert_allclose(states.work(goal), alone)


def test_every_choice_of_the_prior_is_uniform():
    program = parse("Each(WithColour('red'), InRegion())")
    kinds = (Goal, Selection, Place)
    counts = [sum(issubclass(other, kind) for other in VOCABULARY.values()) for kind in kinds]
    found = sum(map(bits_of_part, program.parts))
    assert found == pytest.approx(math.log2(math.prod(counts) * 4))  # of four colours


@pytest.mark.parametrize("task", ["MatchRegions", "Generated0033"])
def test_dense_rewards_sum_to_the_increase_of_progress(task):
    env = MagicalEnv(task, "Demo", reward="dense")
    env.reset(seed=0)
    before = env.state()
    rewards = [env.step(action)[1] for action in [1, 1, 1, 4, 7, 10, 1, 1]]
    after = env.state()
    gained = [progress(program_of(task), each.scene, each.poses) for each in (before, after)]
    assert sum(rewards) == pytest.approx(gained[1] - gained[0])
    assert any(rewards)


def test_a_task_without_a_program_has_no_dense_reward():
    with pytest.raises(UnknownNameError, match="PushThere has no program; expected one of: "):
        dense(replace(TASKS["MoveToCorner"], name="PushThere"))


@pytest.mark.parametrize("name", ["FindDupe", "Generated0033"])
def test_the_experts_of_programs_solve_them(name, monkeypatch):
    planner = program_planner(program_of(name))
    monkeypatch.setattr("magical.experts.expert.get_planner", lambda task: planner)
    assert rollout(name, "Demo", 0).score == 1.0


def test_a_program_that_no_expert_knows_is_named(monkeypatch):
    planner = program_planner(parse("Together(Clustered('colour'), Clustered('shape'))"))
    monkeypatch.setattr("magical.experts.expert.get_planner", lambda task: planner)
    with pytest.raises(NoExpertError, match="no expert for Clustered"):
        rollout("ClusterColour", "Demo", 0)
