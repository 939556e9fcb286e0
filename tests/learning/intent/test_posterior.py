"""Which programs explain demonstrations."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Trajectory
from magical.demos.generate import demonstrate
from magical.errors import DemonstrationsError
from magical.learning.intent.demonstrator import MOVE_COST, RATIONALITY, Episode, work_of
from magical.learning.intent.episodes import make_episode
from magical.learning.intent.meanings import Language
from magical.learning.intent.posterior import infer
from magical.scene import Poses, Scene
from magical.scene.poses import FIRST_BLOCK
from magical.tasks import TASKS
from magical.tasks.programs import Goal, parse
from magical.tasks.programs.prior import Prior

FIX = TASKS["FixColour"].demo
MISMATCHED = "Every(Mismatched(), OutOfRegions())"


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def moved(scene: Scene, block: int, place: tuple[float, float]) -> Poses:
    bodies = Poses.at_rest(scene).bodies
    bodies[FIRST_BLOCK + block, :2] = place
    return Poses(bodies)


@pytest.fixture(scope="module")
def fixed() -> list[Trajectory]:
    return [demonstrate("magical/FixColour-Demo-v0", seed=seed) for seed in range(2)]


def plain_log_likelihood(goal: Goal, episode: Episode, states: int) -> float:
    works = [work_of(goal, episode.scene, poses).sum(axis=1).min() for poses in episode.poses]
    others = (len(works) - states) // states
    total = 0.0
    for k in range(states):
        alternatives = works[states + k * others : states + (k + 1) * others]
        preferences = [math.exp(RATIONALITY * (works[k] - w - MOVE_COST)) for w in alternatives]
        total -= math.log(1.0 + sum(preferences) / others)
        if k + 1 < states:
            total += RATIONALITY * (works[k] - works[k + 1] - MOVE_COST)
    return total


@pytest.mark.parametrize(
    "text",
    [MISMATCHED, "Lined(AllBlocks())", f"Together({MISMATCHED}, OneOf(AllBlocks(), InRegion()))"],
)
def test_the_likelihood_is_that_of_a_softly_rational_demonstrator(text: str) -> None:
    states = [Poses.at_rest(FIX), moved(FIX, 1, (0.0, 0.9))]
    episode = Episode(FIX, states, rng())
    goal = parse(text)
    assert episode.log_likelihood(goal) == pytest.approx(plain_log_likelihood(goal, episode, 2))


def test_moves_that_a_goal_asks_for_are_more_likely_under_it(fixed: list[Trajectory]) -> None:
    episode = make_episode(fixed[0], rng())
    assert episode.log_likelihood(parse(MISMATCHED)) > 1.0
    assert episode.log_likelihood(parse("Each(AllBlocks(), InCorner('top left'))")) < -1.0


def test_meanings_are_told_apart_by_what_selections_name_in_all_scenes() -> None:
    colour = FIX.blocks[0].colour
    same_colour = replace(FIX, blocks=tuple(replace(b, colour=colour) for b in FIX.blocks))
    one, both = (Language(scenes, Prior()) for scenes in ([FIX], [FIX, same_colour]))
    selection = parse(MISMATCHED).selection  # type: ignore[attr-defined]
    alone = one.alternatives[one.named_by(selection)].selections
    assert selection in alone
    assert len(both.alternatives[both.named_by(selection)].selections) < len(alone)


def test_wordings_mean_the_same_and_share_the_weight() -> None:
    language = Language([FIX], Prior())
    goal = parse(MISMATCHED)
    found = list(language.wordings(goal, 1000))
    assert sum(share for _, share in found) == pytest.approx(1.0)
    assert goal in [program for program, _ in found]
    named = {program.moved(FIX) for program, _ in found}
    assert named == {goal.moved(FIX)}


def test_the_programs_that_explain_demonstrations_move_what_was_moved(
    fixed: list[Trajectory],
) -> None:
    belief = infer([make_episode(trajectory, rng()) for trajectory in fixed], Prior())
    assert belief.is_explained
    assert sum(each.weight for each in belief.explanations) <= 1.0 + 1e-9
    ends = [Poses(trajectory.poses[-1]) for trajectory in fixed if trajectory.poses is not None]
    for program, _ in belief.explanations[:10]:
        assert all(program.score(FIX, poses) == 1.0 for poses in ends)


def test_random_motion_is_not_explained() -> None:
    generator = np.random.default_rng(3)
    scene = TASKS["MatchRegions"].demo
    episodes = []
    for _ in range(4):
        states = [Poses.at_rest(scene)]
        for _ in range(3):
            bodies = states[-1].bodies.copy()
            block = int(generator.integers(FIRST_BLOCK, len(bodies)))
            bodies[block, :2] = generator.uniform(-0.85, 0.85, 2)
            states.append(Poses(bodies))
        episodes.append(Episode(scene, states, generator))
    assert not infer(episodes, Prior()).is_known


def test_demonstrations_without_poses_are_refused(fixed: list[Trajectory]) -> None:
    with pytest.raises(DemonstrationsError, match="expected demonstrations with poses"):
        make_episode(replace(fixed[0], poses=None), rng())


def test_the_command_prints_programs_of_each_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    demos = str(tmp_path / "demos")
    assert (
        main(["demos", "generate", "--env", "MoveToRegion-Demo-v0", "-n", "2", "--out", demos]) == 0
    )
    capsys.readouterr()
    assert main(["explain", demos, "--prior", "suite", "--json"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert any("RobotInside()" in line for line in lines)
    found = json.loads(last)["MoveToRegion"]
    assert found["programs"][0][0] == "RobotInside()"
    assert found["known"]
