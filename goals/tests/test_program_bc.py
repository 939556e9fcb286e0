"""Cloning by programs from beginning to end, in the smallest runs."""

import json

import numpy as np
import pytest
import torch

from baselines.tests import tiny_runs
from magical.cli import main
from magical.demos import Dataset, observations
from magical.demos.generate import demonstrate
from magical.errors import CheckpointError
from magical.evaluation import evaluate
from magical.evaluation.rollouts import RolloutRng
from magical.scene import NOOP
from magical.tasks import get_task
from magical_baselines import load_policy, train
from magical_goals.intent.posterior import Belief, Explanation
from magical_goals.language import parse
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames
from magical_goals.program_bc import (
    ProgramBCConfig,
    ProgramPolicy,
    beliefs_of,
    infer_beliefs,
)

TASKS = ("MoveToRegion", "FixColour")
FIX = "magical/FixColour-Demo-v0"
OUT = "Every(Mismatched(), OutOfRegions())"


def load(run, unexplained=0.0):
    """The policy, which believes of FixColour what moves the mismatched block out, or nothing."""
    policy = load_policy(run)
    assert isinstance(policy, ProgramPolicy)
    policy.network.believe(1, Belief([Explanation(parse(OUT), 1.0)], unexplained, 1.0))
    policy.reset(np.ones(1, np.bool_))
    return policy


@pytest.fixture(scope="module")
def stacks():
    """What is observed in a demonstration of FixColour: (T + 1, 96, 96, 12)."""
    return observations(demonstrate(FIX, seed=3), "LoRes4A")


@pytest.fixture(scope="module")
def run(expert_demos, tmp_path_factory):
    folder = tmp_path_factory.mktemp("program-bc") / "run"
    fields = {"demos": str(expert_demos), "batches": 2, "batch_size": 8}
    config = tiny_runs.tiny(ProgramBCConfig, "paper", tasks=TASKS, **fields)
    assert train(config, folder).finished
    return folder


def test_programs_of_each_task_are_inferred(run):
    beliefs = beliefs_of(run)
    assert list(beliefs) == list(TASKS)
    assert repr(beliefs["MoveToRegion"].explanations[0].program) == "RobotInside()"
    assert beliefs["FixColour"].is_explained


def test_a_task_is_believed_the_same_alone(run, expert_demos):
    fields = {"demos": str(expert_demos), "batches": 2, "batch_size": 8}
    config = tiny_runs.tiny(ProgramBCConfig, "paper", tasks=TASKS[1:], **fields)
    dataset = Dataset.open(expert_demos).filter(task=TASKS[1])
    demonstrations = tuple((TASKS[1], trajectory) for trajectory in dataset)
    alone = infer_beliefs(config, parse_demonstrations(demonstrations, parse_frames))
    assert beliefs_of(run)[TASKS[1]].explanations == alone[TASKS[1]].explanations


def test_programs_are_carried_out(run):
    names = [f"magical/{name}-v0" for name in ("FixColour-TestDynamics", "MoveToRegion-TestAll")]
    scores = evaluate(load(run), names, rollouts=4, workers=0)
    assert np.mean([row.score for row in scores]) > 0.8


def test_what_is_done_stops_the_robot(run, stacks):
    policy, rng = load(run), np.random.default_rng(0)
    actions = [int(policy.act(stack[None], [FIX], rng)[0]) for stack in stacks]
    assert NOOP != actions[0]
    assert actions[-1] == NOOP


def test_what_relations_decide_does_not_depend_on_other_episodes(run, stacks):
    policy, region = load(run, unexplained=0.9), "magical/MoveToRegion-Demo-v0"
    shown = np.stack([observations(demonstrate(region, seed=1), "LoRes4A", [0])[0], stacks[0]])

    def act(rows):
        policy.reset(np.ones(len(rows), np.bool_))
        env_ids = [(region, FIX)[row] for row in rows]
        actions = policy.act(shown[rows], env_ids, RolloutRng(env_ids, rows))
        return [int(action) for action in actions]

    assert act([0, 1]) == [*act([0]), *act([1])]


def test_a_damaged_belief_is_refused(run):
    network = load(run).network
    for text, message in (
        (b"?", "expected JSON"),
        (b'[[], "x", 1]', "expected float, found str"),
        (b'[[["f()", 1]], 0, 1]', "policy: expression"),
        (b'[[["RobotInside()", 0.0]], 0, 1]', "> 0.0"),
        (b"[[], 0, 1]", "policy: no programs, but 0"),
    ):
        network.beliefs[0] = 0
        network.beliefs[0, : len(text)] = torch.frombuffer(bytearray(text), dtype=torch.uint8)
        with pytest.raises(CheckpointError, match=message):
            network.belief(0)


def test_the_command_prints_beliefs(run, capsys):
    options = ["--top", "2", "--scenes", "2", "--json"]
    assert main(["explain", str(run), *options]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    found = json.loads(last)
    assert list(found) == list(TASKS)
    assert found["MoveToRegion"]["programs"][0][0] == "RobotInside()"
    assert found["MoveToRegion"]["known"] == beliefs_of(run)["MoveToRegion"].is_known
    assert len(found["FixColour"]["programs"]) == 2
    assert list(found["MoveToRegion"]["confidence"]) == list(get_task("MoveToRegion").variants)
    assert found["MoveToRegion"]["confidence"]["Demo"] == pytest.approx(1.0, abs=0.05)
    assert any("RobotInside()" in line for line in lines)


def test_runs_of_other_algorithms_are_refused(tmp_path, demos, capsys):
    from magical_baselines.algorithms.bc import BCConfig

    train(tiny_runs.tiny(BCConfig, demos=str(demos)), tmp_path / "run")
    assert main(["explain", str(tmp_path / "run")]) == 1
    assert "expected a run of program-bc, found one of bc" in capsys.readouterr().err
