"""Does program-bc know when it does not know?

python -m studies.intent.confidence RUN... [--variant All]

RUN is a run folder with weights and an entry. The policy decides what it would move first in the
true scene of each rollout that was scored. It is right if the task's own program asks for that, in
any of the ways to reach its goal. Rollouts of all runs are pooled by the policy's confidence.
"""

import argparse
from collections.abc import Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np

from magical.envs import EnvId, env_spec
from magical.envs.seeds import evaluation_seed
from magical.evaluation import read_entry
from magical.grouping import group_by
from magical.scene import Poses, Scene, State
from magical.tasks.axes import full_variant
from magical_goals.intent.acting import Intention
from magical_goals.intent.posterior import Belief
from magical_goals.language.goals import Goal, ways_at_start
from magical_goals.language.programs import program_of
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.program_bc import beliefs_of
from tools.readme_tables import table

EDGES = (0.0, 0.5, 0.7, 0.9, 0.99, 1.0)


class Case(NamedTuple):
    """A rollout's first decision."""

    task: str
    confidence: float
    right: bool
    score: float


def main() -> None:
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of program-bc")
    parser.add_argument("--variant", default="All")
    args = parser.parse_args()
    cases = [case for run in args.runs for case in cases_of(run, full_variant(args.variant))]
    header = ("Confidence", "Rollouts", "Mean confidence", "Right", "Mean score")
    print(table(header, by_confidence(cases)))
    tasks = {case.task: [c for c in cases if c.task == case.task] for case in cases}
    print(table(("Task", *header[1:]), (row(task, of) for task, of in tasks.items())))


def cases_of(run: Path, variant: str) -> Iterator[Case]:
    """The rollouts of a run on a variant."""
    beliefs = beliefs_of(run)
    scores = [score for score in read_entry(run).scores if score.env_id.variant == variant]
    for env_id, group in group_by(scores, attrgetter("env_id")).items():
        found = decisions(beliefs[env_id.task], env_id, [score.rollout for score in group])
        for score, (confidence, right) in zip(group, found, strict=True):
            yield Case(env_id.task, confidence, right, score.score)


def decisions(
    belief: Belief, env_id: EnvId, rollouts: Iterable[int]
) -> Iterator[tuple[float, bool]]:
    """The belief's first decision in the scenes of evaluation's rollouts."""
    env, program = gymnasium.make(env_spec(env_id)), program_of(env_id.task)
    for rollout in rollouts:
        env.reset(seed=evaluation_seed(rollout))
        state: State = env.unwrapped.state()  # type: ignore[attr-defined]
        yield first_decision(belief, program, state.scene, state.poses)


def first_decision(belief: Belief, program: Goal, scene: Scene, poses: Poses) -> tuple[float, bool]:
    """How sure the belief is of its first move, and whether the program asks for it."""
    intention, ways = Intention(belief, scene), ways_at_start(program, scene)
    confidence = intention.confidence(poses)
    decision = intention.decide(poses) if intention.is_known else None
    if decision is None:
        return confidence, not ways.any(axis=1).all()
    thing = -1 if decision[0] == ROBOT_TARGET else decision[0]
    return confidence, bool(ways[:, thing].any())


def by_confidence(cases: Iterable[Case]) -> Iterator[list[str]]:
    """A row for each range of confidence."""
    found = list(cases)
    ranges = np.digitize([case.confidence for case in found], EDGES[1:-1])
    for number, low in enumerate(EDGES[:-1]):
        chosen = [case for case, where in zip(found, ranges, strict=True) if where == number]
        if chosen:
            yield row(f"{low} to {EDGES[number + 1]}", chosen)
    yield row("all", found)


def row(name: str, cases: list[Case]) -> list[str]:
    """Name, number and means."""
    means = np.mean([case[1:] for case in cases], axis=0)
    return [name, str(len(cases)), *(f"{mean:.2f}" for mean in means)]


if __name__ == "__main__":
    main()
