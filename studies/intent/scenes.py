"""What program-bc would believe, and how it would act, after demonstrations of several scenes.

python -m studies.intent.scenes RUN... [--moves 100] [--rollouts 20]

RUN is a run folder with weights, trained on demonstrations of the Demo scene. Its belief is
replaced by what follows from as many scripted demonstrations, or fewer, in a scene each of Layout
or All. Motion and perception stay as they are. Each belief is held against scenes of All: whether
the first move is right (see `confidence.py`), and what rollouts score.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from magical.demos import Dataset
from magical.demos.generate import generate
from magical.envs import EnvId
from magical.evaluation import environments, evaluate
from magical.evaluation.protocol import NUDGE
from magical_baselines.policy import load_policy
from magical_goals.intent.posterior import Belief
from magical_goals.objects.data import parse_demonstrations
from magical_goals.program_bc import ProgramBCConfig, ProgramPolicy, infer_beliefs
from studies.intent.confidence import decisions
from studies.intent.oracles import OraclePolicy
from tools.readme_tables import table

VARIED = ("Layout", "All")
NUMBERS = (3, 10)  # of demonstrations
SEED = 1


class Case(NamedTuple):
    """What a belief is worth in scenes of All."""

    demonstrations: str
    task: str
    right: float  # share of the first moves
    score: float


def main() -> None:
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of program-bc, one task")
    parser.add_argument("--moves", type=int, default=100, help="scenes of which the first is asked")
    parser.add_argument("--rollouts", type=int, default=20)
    args = parser.parse_args()
    torch.set_num_threads(1)
    cases = [case for run in args.runs for case in cases_of(run, args.moves, args.rollouts)]
    names = list(dict.fromkeys(case.demonstrations for case in cases))
    tasks = dict.fromkeys(case.task for case in cases)
    lines = [line(task, [case for case in cases if case.task == task]) for task in tasks]
    means = [[case for case in cases if case.demonstrations == name] for name in names]
    print(table(("First moves right / score", *names), [*lines, ["mean", *map(cell, means)]]))


def line(task: str, cases: list[Case]) -> list[str]:
    """A task's line."""
    return [task, *(cell([case]) for case in cases)]


def cell(cases: list[Case]) -> str:
    """Mean share of the first moves, and mean score."""
    right, score = np.mean([(case.right, case.score) for case in cases], axis=0)
    return f"{right:.2f} / {score:.2f}"


def cases_of(run: Path, moves: int, rollouts: int) -> Iterator[Case]:
    """The beliefs of a run and of other demonstrations of its task, in scenes of All."""
    policy = load_policy(run, device="cpu")
    assert isinstance(policy, ProgramPolicy)
    (task,) = policy.tasks
    for name, belief in beliefs(policy, task):
        env_ids = environments([task], ["All"])
        oracle = OraclePolicy(policy, (), {task: belief})
        scores = evaluate(oracle, env_ids, rollouts=rollouts, nudge=NUDGE, workers=1)
        score = float(np.mean([each.score for each in scores]))
        yield Case(name, task, share_right(belief, env_ids[0], moves), score)


def beliefs(policy: ProgramPolicy, task: str) -> Iterator[tuple[str, Belief]]:
    """The run's own belief, then those after demonstrations of several scenes."""
    yield "ten of the Demo scene", policy.network.belief(0)
    config = policy.config.replace(seed=SEED)
    assert isinstance(config, ProgramBCConfig)
    for variant in VARIED:
        with tempfile.TemporaryDirectory() as folder:
            (env_id,) = environments([task], [variant])
            generate(env_id, max(NUMBERS), folder, seed=SEED, min_score=1.0, workers=1)
            named = [(task, trajectory) for trajectory in Dataset.open(folder)]
        parsed = parse_demonstrations(tuple(named), policy.network.perception)
        for number in NUMBERS:
            yield f"{number} of {variant}", infer_beliefs(config, parsed[:number])[task]


def share_right(belief: Belief, env_id: EnvId, moves: int) -> float:
    """The share of scenes in which the task's program asks for the first move."""
    return float(np.mean([right for _, right in decisions(belief, env_id, range(moves))]))


if __name__ == "__main__":
    main()
