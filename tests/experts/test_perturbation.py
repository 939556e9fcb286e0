"""Perturbed demonstrations: what is executed, what the expert says, and how it recovers."""

import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

from magical.experts import (
    Memory,
    Move,
    expert_for,
    note_other_action,
    rollout,
    strategy_seed,
)
from magical.experts.noise import MAX_PERTURBED_STEPS, RandomActions
from magical.physics import Simulation
from magical.scene import NOOP, NUM_ACTIONS, POINTS, Action, Gripper
from magical.tasks import get_task
from tests.experts.scenes import state_of

OTHER = NUM_ACTIONS  # no action: tells the expert's from random ones


def executed(share: float, steps: int = 20_000) -> list[int]:
    actions = RandomActions(share, np.random.default_rng(0))
    return [actions.execute(OTHER) for _ in range(steps)]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_the_share_is_that_of_the_control_steps(share: float) -> None:
    found = np.mean([action != OTHER for action in executed(share)])
    assert found == pytest.approx(share, abs=0.0 if share in (0.0, 1.0) else 0.02)


def test_random_actions_are_all_actions_held_for_some_steps() -> None:
    actions = np.array(executed(0.01))
    starts = np.flatnonzero(np.diff(actions, prepend=OTHER))
    runs = [part for part in np.split(actions, starts) if len(part) and part[0] != OTHER]
    assert set(actions.tolist()) == set(range(NUM_ACTIONS + 1))
    lengths = np.array([len(run) for run in runs])
    assert set(range(1, MAX_PERTURBED_STEPS + 1)) <= set(lengths.tolist())
    assert lengths.mean() == pytest.approx((1 + MAX_PERTURBED_STEPS) / 2, rel=0.15)


def test_without_perturbation_everything_stays_as_it_is() -> None:
    plain, other = rollout("FixColour", "TestAll", 3), rollout("FixColour", "TestAll", 3, perturb=0)
    assert np.array_equal(plain.poses, other.poses)
    assert np.array_equal(plain.actions, plain.expert_actions)


def test_perturbations_do_not_depend_on_the_experts_strategy() -> None:
    """On Demo the scene takes no random numbers, so both were once sampled from the same ones."""
    begun = []  # the first number of the strategy where a perturbation begins in the first step
    for seed in range(120):
        episode = rollout("MoveToRegion", seed=seed, perturb=0.2)
        if episode.actions[0] != episode.expert_actions[0]:
            begun.append(np.random.default_rng(seed).random())
    assert len(begun) > 3
    assert max(begun) > 0.2


def test_preferences_do_not_depend_on_the_scene() -> None:
    """Both were once sampled from the same numbers, wherever the scene takes any."""
    task, heights, costs = get_task("MoveToRegion"), list[float](), list[float]()
    for seed in range(300):
        scene, _ = task.sample("TestLayout", np_random(seed)[0])
        strategy = expert_for(task.name, seed=strategy_seed("TestLayout", seed)).strategy
        heights.append(scene.regions[0].height)
        costs.append(strategy.side_costs[0])
    assert abs(np.corrcoef(heights, costs)[0, 1]) < 0.2
    again = expert_for(task.name, seed=strategy_seed("TestLayout", 299)).strategy
    assert again == strategy


def test_preferences_on_demo_are_those_of_stored_demonstrations() -> None:
    """The scene takes no numbers there, so they may be the seed's first ones."""
    strategy = expert_for("MoveToRegion", seed=strategy_seed("Demo", 7)).strategy
    assert strategy.side_costs[0] == 4.0 * np.random.default_rng(7).random()


def test_labels_are_those_of_an_expert_that_observes_what_is_executed() -> None:
    episode = rollout("MoveToCorner", "TestAll", 5, perturb=0.4)
    assert 0.2 < (episode.actions != episode.expert_actions).mean() < 0.6
    expert, memory = expert_for("MoveToCorner", seed=strategy_seed("TestAll", 5)), Memory()
    simulation = Simulation(episode.scene, episode.dynamics)
    labels = []
    for step, action in enumerate(episode.actions.tolist()):
        label, memory = expert.act(state_of(simulation, episode.scene, step, 80), memory)
        memory = memory if label == action else note_other_action(memory, action)
        labels.append(label)
        simulation.step(POINTS[action])
    assert labels == episode.expert_actions.tolist()
    assert np.array_equal(simulation.poses().bodies, episode.poses[-1])


def test_the_same_seed_gives_the_same_episode() -> None:
    first, again = (rollout("MoveToCorner", seed=1, perturb=0.3) for _ in range(2))
    assert np.array_equal(first.actions, again.actions)
    other = rollout("MoveToCorner", seed=1, perturb=0.2)
    assert not np.array_equal(first.actions, other.actions)
    assert first.scene == other.scene == rollout("MoveToCorner", seed=1).scene


@pytest.mark.parametrize("task", ["MoveToRegion", "MoveToCorner", "FixColour"])
def test_the_expert_recovers(task: str) -> None:
    scores = [rollout(task, seed=seed, perturb=0.1).score for seed in range(6)]
    assert np.mean(scores) >= 0.9, scores


def test_an_expert_does_not_escape_from_what_others_do() -> None:
    """A robot that others keep standing is not stuck: the same state, the same label."""
    scene = get_task("MoveToCorner").demo
    expert = expert_for("MoveToCorner", seed=0)
    simulation, memory = Simulation(scene), Memory()
    first, _ = expert.act(state_of(simulation, scene, 0), None)
    for step in range(30):
        label, memory = expert.act(state_of(simulation, scene, step), memory)
        assert label == first, step
        memory = note_other_action(memory, NOOP)
        simulation.step(POINTS[NOOP])


def test_the_move_stays_and_a_block_is_held_while_the_fingers_stay_closed() -> None:
    move = Move((0.5, 0.5), 0.1, block=0)
    memory = Memory(move=move, held_steps=5, stalled_steps=6, escape_steps=2)
    closed, opened = (
        note_other_action(memory, Action(gripper=gripper).id)
        for gripper in (Gripper.CLOSED, Gripper.OPEN)
    )
    assert (closed.held_steps, opened.held_steps) == (5, 0)
    assert closed == Memory(move=move, held_steps=5)
