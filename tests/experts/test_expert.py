"""Scripted experts: every task, any state, without looking ahead in the simulator."""

import math
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidTaskError
from magical.evaluation import evaluate
from magical.evaluation.policy import ExpertPolicy
from magical.experts import Memory, expert_for, modules_of, rollout
from magical.physics import Simulation
from magical.scene import (
    FIRST_BLOCK,
    NOOP,
    NUM_ACTIONS,
    POINTS,
    Action,
    Block,
    Colour,
    Gripper,
    Pose,
    Scene,
    Shape,
)
from magical.tasks import TASKS, get_task, register_task, unregister_task
from tests.experts import outside_task
from tests.experts.scenes import scattered, state_of

STATES = 80  # random states of each task


@pytest.mark.parametrize("task", TASKS)
def test_demo_is_solved(task: str) -> None:
    seeds = range(2) if "Cluster" in task else range(4)
    scores = [rollout(task, "Demo", seed).score for seed in seeds]
    assert np.mean(scores) >= 0.85, scores


@pytest.mark.parametrize("away", [0.33, 0.46])
def test_finished_expert_releases_the_block_and_stays(away: float) -> None:
    """Fingers closed around a star, or its edge, creep on with it: here by 0.23 units."""
    places = ((0.0, 0.0), (0.0, 0.36), (0.0, -0.36))
    blocks = tuple(Block(Shape.STAR, Colour.RED, Pose(x, y, 0.3)) for x, y in places)
    scene = Scene(Pose(away, 0.0, math.pi / 2), blocks)
    simulation, memory, expert = Simulation(scene), None, expert_for("MakeLine", seed=0)
    for _ in range(3):
        simulation.step(POINTS[Action(gripper=Gripper.CLOSED).id])
    before = simulation.read()[FIRST_BLOCK:, :2].copy()
    for step in range(100):
        action, memory = expert.act(state_of(simulation, scene, step), memory)
        simulation.step(POINTS[action])
    assert np.abs(simulation.read()[FIRST_BLOCK:, :2] - before).max() < 0.03
    assert action == Action(gripper=Gripper.CLOSED).id


@pytest.mark.parametrize("task", TASKS)
def test_never_raises_in_any_state(task: str) -> None:
    rng = np.random.default_rng(0)
    spec = get_task(task)
    memory: Memory | None = None
    for number in range(STATES):
        if number % 10 == 0:  # the scene changes, and with it the expert
            variant = spec.variants[number // 10 % len(spec.variants)]
            scene, _ = spec.sample(variant, rng)
            expert, memory = expert_for(task, seed=rng), None
        action, memory = expert.act(scattered(scene, rng), memory)
        assert action in range(NUM_ACTIONS)


class TakesOver(ExpertPolicy):
    """Acts at random in the first third of an episode."""

    def act(self, observations: Any, env_ids: Any, rng: np.random.Generator) -> Any:
        if observations[0].step < observations[0].horizon // 3:
            return rng.integers(NUM_ACTIONS, size=len(env_ids))
        return super().act(observations, env_ids, rng)


@pytest.mark.parametrize("task", ["FindDupe", "FixColour"])
def test_takes_over_after_a_random_policy(task: str) -> None:
    policy, env_id = TakesOver(), f"magical/{task}-Demo-v0"
    scores = [rollout.score for rollout in evaluate(policy, [env_id], rollouts=6, workers=1)]
    assert np.mean(scores) >= 0.7, scores


def test_starts_without_memory_at_any_time() -> None:
    spec = get_task("MoveToCorner")
    scene, dynamics = spec.sample("Demo", np.random.default_rng(0))
    simulation, expert = Simulation(scene, dynamics), expert_for("MoveToCorner", seed=0)
    for step in range(spec.horizon):  # forgetting everything at every step
        action, _ = expert.act(state_of(simulation, scene, step, spec.horizon))
        simulation.step(POINTS[action])
    assert spec.score(scene, simulation.poses()) == 1.0


@pytest.mark.parametrize("task", ["MoveToRegion", "MoveToCorner"])
def test_demonstrators_differ_even_in_short_tasks(task: str) -> None:
    """Demo's scene is always the same in these tasks; what is done in it should not be."""
    episodes = {tuple(rollout(task, "Demo", seed).actions.tolist()) for seed in range(10)}
    assert len(episodes) >= 4


@pytest.mark.parametrize(
    ("task", "changes"),
    [
        ("MoveToRegion", {"regions": ()}),
        ("MoveToCorner", {"blocks": ()}),
        ("FindDupe", {"blocks": get_task("FindDupe").demo.blocks[-1:]}),
        ("FixColour", {"regions": get_task("FixColour").demo.regions[:1]}),
    ],
)
def test_nothing_is_done_in_a_scene_that_does_not_fit(task: str, changes: dict[str, Any]) -> None:
    scene, expert = replace(get_task(task).demo, **changes), expert_for(task, seed=0)
    action, memory = expert.act(state_of(Simulation(scene), scene))
    assert action == NOOP
    assert expert.act(state_of(Simulation(scene), scene), memory)[0] == NOOP


@pytest.fixture
def outside() -> Iterator[list[str]]:
    import_module("tests.experts.outside_expert")
    register_task(outside_task.TASK)
    yield [f"magical/MoveThere-{variant}-v0" for variant in ("TestLayout", "Demo")]
    unregister_task("MoveThere")


def test_workers_import_a_task_and_its_expert(outside: list[str]) -> None:
    modules = ["tests.experts.outside_expert", "tests.experts.outside_task"]
    assert modules_of("MoveThere") == modules
    here, there = (
        evaluate(ExpertPolicy(), outside, rollouts=1, workers=workers) for workers in (1, 2)
    )
    assert here == there


def test_what_workers_could_not_import_is_an_error_at_once() -> None:
    register_task(replace(get_task("MakeLine"), name="MakeOther", section=""))
    try:
        with pytest.raises(InvalidTaskError, match="MakeOther"):
            evaluate(ExpertPolicy(), ["magical/MakeOther-Demo-v0"], rollouts=100, workers=2)
    finally:
        unregister_task("MakeOther")
