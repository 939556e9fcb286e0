"""Cloning by programs from beginning to end, in the smallest runs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests import tiny_runs
from magical.cli import main
from magical.demos import Dataset, observations
from magical.demos.generate import demonstrate
from magical.errors import CheckpointError
from magical.evaluation import evaluate
from magical.evaluation.seeds import RolloutRng
from magical.scene import NOOP
from magical.tasks import get_task
from magical_baselines import load_policy, train
from magical_goals.intent.posterior import Belief, Explanation
from magical_goals.language import parse
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames
from magical_goals.planning.planner import Planner, Situation
from magical_goals.program_bc import (
    ProgramBCConfig,
    ProgramPolicy,
    beliefs_of,
    infer_beliefs,
)

TASKS = ("MoveToRegion", "FixColour")
FIX = "magical/FixColour-Demo-v0"
OUT = "Every(Mismatched(), OutOfRegions())"


def load(run: Path, unexplained: float = 0.0) -> ProgramPolicy:
    """The policy, which believes of FixColour what moves the mismatched block out, or nothing."""
    policy = load_policy(run)
    assert isinstance(policy, ProgramPolicy)
    policy.network.believe(1, Belief([Explanation(parse(OUT), 1.0)], unexplained, 1.0))
    policy.reset(np.ones(1, np.bool_))
    return policy


@pytest.fixture(scope="module")
def stacks() -> Any:
    """What is observed in a demonstration of FixColour: (T + 1, 96, 96, 12)."""
    return observations(demonstrate(FIX, seed=3), "LoRes4A")


@pytest.fixture(scope="module")
def run(expert_demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("program-bc") / "run"
    fields: dict[str, Any] = {"demos": str(expert_demos), "batches": 2, "batch_size": 8}
    config = tiny_runs.tiny(ProgramBCConfig, "paper", tasks=TASKS, **fields)
    assert train(config, folder).finished
    return folder


def test_programs_of_each_task_are_inferred(run: Path) -> None:
    beliefs = beliefs_of(run)
    assert list(beliefs) == list(TASKS)
    assert repr(beliefs["MoveToRegion"].explanations[0].program) == "RobotInside()"
    assert beliefs["FixColour"].is_explained


def test_a_task_is_believed_the_same_alone(run: Path, expert_demos: Path) -> None:
    fields: dict[str, Any] = {"demos": str(expert_demos), "batches": 2, "batch_size": 8}
    config = tiny_runs.tiny(ProgramBCConfig, "paper", tasks=TASKS[1:], **fields)
    dataset = Dataset.open(expert_demos).filter(task=TASKS[1])
    demonstrations = tuple((TASKS[1], trajectory) for trajectory in dataset)
    alone = infer_beliefs(config, parse_demonstrations(demonstrations, parse_frames))
    assert beliefs_of(run)[TASKS[1]].explanations == alone[TASKS[1]].explanations


def test_the_policy_acts_in_test_variants(run: Path) -> None:
    names = [f"magical/{task}-TestAll-v0" for task in TASKS]
    assert len(evaluate(load_policy(run), names, rollouts=2, workers=0)) == 4


def test_what_is_done_stops_the_robot(run: Path, stacks: Any) -> None:
    policy, rng = load(run), np.random.default_rng(0)
    actions = [int(policy.act(stack[None], [FIX], rng)[0]) for stack in stacks]
    assert NOOP != actions[0]
    assert actions[-1] == NOOP


def test_the_planner_sees_where_the_robot_was_a_step_ago(
    run: Path, stacks: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Situation] = []

    def noted(planner: Planner, situation: Situation, uniform: float | None) -> int:
        seen.append(situation)
        return NOOP

    monkeypatch.setattr(Planner, "act", noted)
    policy = load(run)
    for stack in stacks[:4]:
        policy.act(stack[None], [FIX], np.random.default_rng(0))
    poses = [each.pose.tolist() for each in seen]
    assert [each.before.tolist() for each in seen] == [poses[0], *poses[:-1]]
    assert poses[3] != poses[2] != poses[1]


def test_relations_decide_where_no_program_fits_the_scene(
    run: Path, stacks: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = load(run)
    elsewhere = Explanation(parse("Each(WithColour('red'), InCorner('top left'))"), 1.0)
    policy.network.believe(1, Belief([elsewhere], 0.0, 1.0))
    policy.reset(np.ones(1, np.bool_))
    seen = []

    def control(*inputs: Any) -> torch.Tensor:
        seen.append(inputs)
        return torch.zeros(1, 18)

    monkeypatch.setattr(policy.network, "control", control)
    policy.act(stacks[:1], [FIX], np.random.default_rng(0))
    ((table, _, targets, destinations),) = seen
    expected = policy.network.goals.decide(table, torch.ones(1, dtype=torch.int64))
    assert targets == expected[0]
    torch.testing.assert_close(destinations, expected[1])


def test_what_relations_decide_does_not_depend_on_other_episodes(run: Path, stacks: Any) -> None:
    policy, region = load(run, unexplained=0.9), "magical/MoveToRegion-Demo-v0"
    shown = np.stack([observations(demonstrate(region, seed=1), "LoRes4A", [0])[0], stacks[0]])

    def act(rows: list[int]) -> list[int]:
        policy.reset(np.ones(len(rows), np.bool_))
        env_ids = [(region, FIX)[row] for row in rows]
        actions = policy.act(shown[rows], env_ids, RolloutRng(env_ids, rows))
        return [int(action) for action in actions]

    assert act([0, 1]) == [*act([0]), *act([1])]


def test_a_damaged_belief_is_refused(run: Path) -> None:
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


def test_the_command_prints_beliefs(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_runs_of_other_algorithms_are_refused(
    tmp_path: Path, demos: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from magical_baselines.algorithms.bc import BCConfig

    train(tiny_runs.tiny(BCConfig, demos=str(demos)), tmp_path / "run")
    assert main(["explain", str(tmp_path / "run")]) == 1
    assert "expected a run of program-bc, found one of bc" in capsys.readouterr().err
