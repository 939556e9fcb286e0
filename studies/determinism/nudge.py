"""How far Demo's score depends on rounding: one policy, its start shifted by 1e-9 units.

    python studies/determinism/nudge.py RUN [RUN ...] --out FOLDER --figure nudge.png

Each run's policy is rolled out on its task's Demo scene as it is; then `--shifts` times with one
shift of the initial poses that all rollouts share; then with a shift of its own for each rollout
(`magical evaluate --nudge`). The same on Jitter, where every rollout has a scene of its own, with
and without shifts. Results are kept in FOLDER/nudge.csv and not computed again; only one process
may use the folder at a time. Needs magical-baselines.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from contextlib import closing
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import RolloutScore, evaluate
from magical.evaluation.policy import Policy, observation_for
from magical.evaluation.protocol import NUDGE
from magical.evaluation.seeds import RolloutRng
from magical.grouping import group_by
from magical.scene import Scene
from magical.tasks import get_task
from magical_baselines import load_policy

EXACT, SHARED, OWN = "exact", "shared shift", "own shifts"


class Row(NamedTuple):
    """The scores of one policy in one environment from one kind of start."""

    run: str
    task: str
    variant: str
    start: str  # EXACT, SHARED or OWN
    number: int  # of the shift
    rollouts: int
    mean: float
    variance: float  # over rollouts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--shifts", type=int, default=16, help="shared shifts (default: 16)")
    parser.add_argument("--rollouts", type=int, default=100, help="for each start (default: 100)")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--figure", type=Path, default=None)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "nudge.csv"
    rows = read_rows(path)
    for run in args.runs:
        if not any(row.run == str(run) for row in rows):
            rows += measure(run, args.shifts, args.rollouts, args.workers)
            write_rows(path, rows)
    chosen = [row for row in rows if row.run in map(str, args.runs)]
    print_table(chosen)
    if args.figure:
        draw(chosen, args.figure)


def measure(run: Path, shifts: int, rollouts: int, workers: int | None) -> Iterator[Row]:
    """All rows of one run."""
    policy = load_policy(run)
    (task,) = policy.tasks
    for variant in ("Demo", "TestJitter"):
        for start, nudge in ((EXACT, 0.0), (OWN, NUDGE)):
            scores = evaluate(
                policy, [EnvId(task, variant)], rollouts=rollouts, nudge=nudge, workers=workers
            )
            yield summary(run, task, variant, start, 0, scores)
    scene, _ = get_task(task).sample("Demo", np.random.default_rng(0))
    for number in range(shifts):
        nudged = scene.nudged(NUDGE, np.random.default_rng(number))
        scores = rollouts_from(nudged, policy, task, rollouts, workers)
        yield summary(run, task, "Demo", SHARED, number, scores)


def rollouts_from(
    scene: Scene, policy: Policy, task: str, rollouts: int, workers: int | None
) -> list[RolloutScore]:
    """As `evaluate` on Demo, with all rollouts from one given scene."""
    env_id = EnvId(task, "Demo")
    seeds = [evaluation_seed(number) for number in range(rollouts)]
    env_ids = [env_id] * rollouts
    with closing(
        MagicalVectorEnv(env_ids, workers=workers, observation=observation_for(policy))
    ) as envs:
        rng = RolloutRng(env_ids, seeds)
        observations, infos = envs.reset(seed=seeds, options={"scene": scene})
        policy.reset(np.ones(rollouts, np.bool_))
        for _ in range(env_id.task_spec.horizon):
            actions = policy.act(observations, env_ids, rng)
            observations, _, _, _, infos = envs.step(actions)
    pairs = zip(infos["eval_score"], infos["published_code_score"], strict=True)
    return [
        RolloutScore(env_id, number, seeds[number], float(score), float(published))
        for number, (score, published) in enumerate(pairs)
    ]


def summary(
    run: Path, task: str, variant: str, start: str, number: int, scores: Sequence[RolloutScore]
) -> Row:
    """One row from the rollouts of one start."""
    values = np.array([row.score for row in scores])
    mean, variance = float(values.mean()), float(values.var(ddof=1))
    return Row(str(run), task, variant, start, number, len(values), mean, variance)


class Spread(NamedTuple):
    """What the shifts change in one policy's Demo score."""

    exact: float
    own: float  # each rollout shifted on its own: the mean over shifts
    lowest: float  # of the shared shifts
    highest: float
    observed: float  # standard deviation over shared shifts
    expected: float  # the same if the rollouts alone made them differ

    @property
    def excess(self) -> float:
        """The standard deviation over shifts that the rollouts do not explain."""
        return float(np.sqrt(max(0.0, self.observed**2 - self.expected**2)))


def spread(rows: Sequence[Row]) -> Spread:
    """From the Demo rows of one run."""
    (exact,) = (row.mean for row in rows if row.start == EXACT)
    (own,) = (row.mean for row in rows if row.start == OWN)
    shared = [row for row in rows if row.start == SHARED]
    means = np.array([row.mean for row in shared])
    expected = np.sqrt(np.mean([row.variance / row.rollouts for row in shared]))
    return Spread(exact, own, means.min(), means.max(), means.std(ddof=1), float(expected))


def print_table(rows: Sequence[Row]) -> None:
    """A Markdown table with a line for each run."""
    print(
        "| Task | Exact | Shared shifts | SD over shifts | SD by rollouts | Excess | Own shifts "
        "| Jitter, exact | Jitter, own shifts |"
    )
    print("| --- " * 9 + "|")
    for group in group_by(rows, attrgetter("run")).values():
        found = spread([row for row in group if row.variant == "Demo"])
        jitter = {row.start: row.mean for row in group if row.variant == "TestJitter"}
        print(
            f"| {group[0].task} | {found.exact:.2f} | {found.lowest:.2f} to {found.highest:.2f} "
            f"| {found.observed:.3f} | {found.expected:.3f} | {found.excess:.3f} "
            f"| {found.own:.2f} | {jitter[EXACT]:.2f} | {jitter[OWN]:.2f} |"
        )


def draw(rows: Sequence[Row], path: Path) -> None:
    """Demo's score of each policy from every start."""
    groups = group_by(rows, attrgetter("run"))
    figure = Figure(figsize=(8, 0.45 * len(groups) + 1.2), layout="constrained")
    axes = figure.add_subplot()
    for height, group in enumerate(groups.values()):
        demo = [row for row in group if row.variant == "Demo"]
        shared = [row for row in demo if row.start == SHARED]
        means = [row.mean for row in shared]
        offsets = height + np.linspace(-0.25, 0.25, len(means))
        errors = [np.sqrt(row.variance / row.rollouts) for row in shared]
        found = spread(demo)
        axes.errorbar(means, offsets, xerr=errors, fmt="o", ms=3, lw=0.6, color="#4a86ad", zorder=2)
        axes.plot(found.exact, height, "D", ms=7, color="#c05a1c", zorder=3)
        axes.plot([found.own] * 2, [height - 0.35, height + 0.35], color="black", lw=2, zorder=1)
    axes.plot([], [], "o", ms=3, color="#4a86ad", label="one shift for all rollouts, ± 1 SE")
    axes.plot([], [], "D", ms=7, color="#c05a1c", label="the exact scene")
    axes.plot([], [], color="black", lw=2, label="a shift for each rollout")
    axes.set_yticks(range(len(groups)), [group[0].task for group in groups.values()])
    axes.invert_yaxis()
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("Demo score")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.0 + 0.7 / len(groups)), ncols=3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def read_rows(path: Path) -> list[Row]:
    """What `write_rows` wrote; nothing where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Row(*(kind(line[name]) for name, kind in Row.__annotations__.items()))
            for line in csv.DictReader(file)
        ]


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows to a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Row._fields, *rows])


if __name__ == "__main__":
    main()
