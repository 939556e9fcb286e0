"""Which programs explain demonstrations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magical.demos import Actor
from magical.demos.generate import demonstrate
from magical.scene import FIRST_BLOCK, Poses
from magical.tasks import TASKS
from magical_goals.intent import posterior
from magical_goals.intent.meanings import Language
from magical_goals.intent.posterior import (
    MOVE_COST,
    RATIONALITY,
    SLIPS,
    Belief,
    Episode,
    infer,
    parsed_episode,
)
from magical_goals.language import parse
from magical_goals.language.goals import States, Together, ways_at_start
from magical_goals.language.parsing import bits_of_part
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames

FIX = TASKS["FixColour"].demo
MISMATCHED = "Every(Mismatched(), OutOfRegions())"
ALL_IN = "Each(AllBlocks(), InRegion())"


def rng():
    return np.random.default_rng(0)


def moved(scene, block, place):
    bodies = Poses.at_rest(scene).bodies
    bodies[FIRST_BLOCK + block, :2] = place
    return Poses(bodies)


@pytest.fixture(scope="module")
def fixed():
    shown = [("FixColour", demonstrate("magical/FixColour-Demo-v0", seed)) for seed in range(2)]
    return [
        parsed_episode(each, rng()) for each in parse_demonstrations(tuple(shown), parse_frames)
    ]


def plain_work(goal, scene, poses):
    (work,) = States(scene, poses.bodies[None]).work(goal)
    return float(work)


def test_the_likelihood_is_that_of_a_softly_rational_demonstrator(monkeypatch):
    start, end = Poses.at_rest(FIX), moved(FIX, 1, (0.0, 0.9))
    other = moved(FIX, 0, (0.3, 0.3))
    monkeypatch.setattr(
        posterior, "_random_moves", lambda bodies, rng: np.stack([other.bodies] * 3)
    )
    goal = parse(ALL_IN)
    found = Episode(FIX, [start, end], [end], rng()).log_likelihood(goal)
    before, after, elsewhere = (plain_work(goal, FIX, each) for each in (start, end, other))

    def preference(here, there):
        return math.exp(RATIONALITY * (here - there - MOVE_COST))

    move = preference(before, after) / (1.0 + preference(before, elsewhere))
    stop = 1.0 / (1.0 + preference(after, elsewhere))
    expected = [(1.0 - SLIPS) * each + SLIPS / 2 for each in (move, stop)]
    assert found == pytest.approx(math.log(expected[0]) + math.log(expected[1]))


def test_meanings_are_told_apart_by_what_selections_name_in_all_scenes():
    colour = FIX.blocks[0].colour
    same_colour = replace(FIX, blocks=tuple(replace(b, colour=colour) for b in FIX.blocks))
    one, both = (Language(scenes) for scenes in ([FIX], [FIX, same_colour]))
    selection = parse(MISMATCHED).selection
    alone = one.alternatives[one.named_by(selection)]
    assert selection in alone
    assert len(both.alternatives[both.named_by(selection)]) < len(alone)


@pytest.fixture(scope="module")
def belief(fixed):
    return infer(fixed)


def test_weights_are_those_of_priors_and_of_the_square_root_of_as_many_likelihoods(fixed, belief):
    constants = []
    for program, weight in belief.explanations:
        orders = 2 if isinstance(program, Together) else 1
        prior = math.log(orders) - math.log(2.0) * sum(map(bits_of_part, program.parts))
        likelihoods = [episode.log_likelihood(program) for episode in fixed]
        evidence = math.sqrt(len(fixed)) * float(np.mean(likelihoods))
        constants.append(math.log(weight) - prior - evidence)
    assert np.ptp(constants) == pytest.approx(0.0, abs=1e-9)
    assert {type(program) for program, _ in belief.explanations} > {Together}


def test_the_programs_that_explain_demonstrations_move_what_was_moved(belief):
    assert belief.is_explained
    assert "known: " in belief.verdict
    assert 0.5 < sum(each.weight for each in belief.explanations) <= 1.0 + 1e-9
    matched, mismatched = (parse(f"Exactly({s}())") for s in ("Matched", "Mismatched"))
    for program, _ in belief.explanations[:10]:
        (way,) = ways_at_start(program, FIX)
        moves = set(np.flatnonzero(way).tolist())
        assert moves <= set(mismatched.moved(FIX)), program
        assert not moves & set(matched.moved(FIX))


def test_what_a_watched_policy_moved_is_no_evidence():
    shown = demonstrate("magical/FixColour-Demo-v0", 0)
    actors = np.full(len(shown), Actor.POLICY)
    actors[-3:] = Actor.HUMAN
    demonstrations = (("FixColour", replace(shown, actors=actors)),)
    (parsed,) = parse_demonstrations(demonstrations, parse_frames)
    assert not parsed.carries
    belief = infer([parsed_episode(parsed, rng())])
    assert repr(belief.explanations[0].program) == "RobotInside()"


def test_nothing_explains_scenes_for_which_the_language_has_no_goal():
    empty = replace(FIX, blocks=(), regions=())
    start = Poses.at_rest(empty)
    belief = infer([Episode(empty, [start, start], [start], rng())])
    assert belief == Belief([], unexplained=1.0, largest=0.0)


def test_random_motion_is_not_explained():
    generator = np.random.default_rng(3)
    scene = TASKS["MoveToRegion"].demo
    scene = replace(scene, blocks=TASKS["MatchRegions"].demo.blocks[:2])
    episodes = []
    for _ in range(10):
        states = [Poses.at_rest(scene)]
        for _ in range(3):
            bodies = states[-1].bodies.copy()
            block = int(generator.integers(FIRST_BLOCK, len(bodies)))
            bodies[block, :2] = generator.uniform(-0.85, 0.85, 2)
            states.append(Poses(bodies))
        episodes.append(Episode(scene, states, states[1:], generator))
    belief = infer(episodes)
    assert not belief.is_explained
    assert "no program explains" in belief.verdict
