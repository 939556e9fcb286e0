"""The language of goals: types, text, meaning, words."""

import math

import pytest

from magical.errors import InvalidProgramError
from magical.scene import Block, Colour, Pose, Poses, Region, Scene, Shape
from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS
from magical.tasks import TASKS, Task
from magical.tasks.programs import Lined, instruction, parse, problem, progress
from magical.tasks.programs.goals import UNFINISHED, ways_at_start
from magical.tasks.programs.states import States
from tests.reference import scores
from tests.reference.recordings import DATA
from tests.tasks.conftest import Move

PAPER = [task for task in TASKS.values() if task.section]

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


@pytest.fixture
def final(moved: Move) -> Move:
    return lambda places: moved(SCENE, places)


def test_the_papers_tasks_are_programs_with_the_same_scores_on_all_recorded_states() -> None:
    assert len(PAPER) == 8
    compared = 0
    for state in scores.load(DATA / "scores.json.gz"):
        task, scene = TASKS[state["task"]], Scene.from_dict(state["scene"])
        poses = Poses.at_rest(Scene.from_dict(state["final"]))
        assert task.program is not None
        assert task.program.score(scene, poses) == pytest.approx(task.score(scene, poses), abs=1e-9)
        compared += 1
    assert compared >= 1800


@pytest.mark.parametrize("task", PAPER, ids=lambda task: task.name)
def test_programs_of_the_paper_are_valid_text_and_have_a_way_to_go(task: Task) -> None:
    program = task.program
    assert program is not None
    assert parse(repr(program)) == program
    assert problem(program, task.demo) == ""
    assert progress(program, task.demo, Poses.at_rest(task.demo)) < -1.0


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
def test_selections(selection: str, blocks: set[int]) -> None:
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
def test_scores(
    goal: str, places: dict[int, tuple[float, float]], expected: float, final: Move
) -> None:
    program = parse(goal)
    assert program.score(SCENE, final(places)) == pytest.approx(expected)
    ways = program.ways(States(SCENE, final(places).bodies[None]))[0]
    assert (~ways.any(axis=1)).any() == (expected == 1.0)


def test_progress_rises_to_zero_and_is_a_function_of_the_state(final: Move) -> None:
    goal = parse("Each(WithColour('green'), InRegion())")
    values = [
        progress(goal, SCENE, final({2: place}))
        for place in ((0.0, 0.0), (0.2, 0.2), (0.34, 0.34), INSIDE)
    ]
    assert values == sorted(values)
    assert len(set(values)) == 4
    assert values[-1] == 0.0


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
def test_progress_is_that_of_the_best_way(
    goal: str, places: dict[int, tuple[float, float]], block: int, way: float, final: Move
) -> None:
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
def test_instructions_name_the_blocks(goal: str, words: str) -> None:
    program = parse(goal)
    assert instruction(program, SCENE) == words
    assert instruction(program, SCENE, paraphrase=1) != words
    assert instruction(program, SCENE, paraphrase=3) == words


@pytest.mark.parametrize("task", PAPER, ids=lambda task: task.name)
def test_without_attributes_an_instruction_is_the_same_in_every_colour(task: Task) -> None:
    program = task.program
    assert program is not None
    words = instruction(program, task.demo, attributes=False)
    assert not any(name in words.split() for name in ("red", "green", "blue", "yellow", "star"))


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
def test_text_that_is_no_program_is_refused(text: str, message: str) -> None:
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
def test_what_no_episode_can_have_as_goal_is_a_problem(text: str, message: str) -> None:
    assert message in problem(parse(text), SCENE)


def test_a_cluster_that_another_colours_block_lies_in_is_not_done() -> None:
    red, blue, green = Colour.RED, Colour.BLUE, Colour.GREEN
    apart = [(green, 0.9, 0.9), (green, -0.9, 0.9)]
    places = [(blue, 0.0, 0.4), (blue, 0.0, 0.1), (red, 0.1, 0.25), *apart]
    blocks = tuple(Block(Shape.SQUARE, colour, Pose(x, y, 0.0)) for colour, x, y in places)
    scene = Scene(Pose(-0.5, -0.5, 0.0), blocks, ())
    (way,) = ways_at_start(parse("Clustered('colour')"), scene)
    assert way[[0, 1]].all()
