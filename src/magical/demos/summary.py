"""What a dataset contains, and how well the simulation reproduces it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from magical.demos.dataset import Entry
from magical.demos.trajectory import Trajectory
from magical.envs.action_spec import spec_of
from magical.grouping import group_by
from magical.physics import Simulation

TOLERANCE = 1e-6  # on scores, which other programs may have rounded to single precision


def summarise(entries: Iterable[Entry]) -> list[dict[str, Any]]:
    """Counts and means of the trajectories of each environment, as plain data, sorted by id."""
    return [
        {
            "env_id": str(env_id),
            "count": len(group),
            "with_poses": sum(entry.has_poses for entry in group),
            "with_labels": sum(entry.has_labels for entry in group),
            "lengths": [f(entry.length for entry in group) for f in (min, max)],
            "score": _mean(entry.score for entry in group),  # where it is known
            "published_code_score": _mean(entry.published_code_score for entry in group),
            "bytes": sum(entry.size for entry in group),
            "action_spaces": sorted({entry.action_space for entry in group}),
            "demonstrators": sorted({entry.demonstrator for entry in group}),
        }
        for env_id, group in sorted(group_by(entries, attrgetter("env_id")).items())
    ]


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


@dataclass(frozen=True, slots=True)
class Replay:
    """The outcome of replaying one trajectory."""

    score: float  # of the final state, by the appendix's rule
    published_code_score: float
    agrees: bool  # with the recorded scores, by every rule with a recorded score
    departure: float | None  # largest deviation of a body's final x or y from the recorded one


def replay(trajectory: Trajectory) -> Replay:
    """Simulate a trajectory's actions from its initial scene, and score the final state."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    for point in spec_of(trajectory.actions).points(trajectory.actions, len(trajectory)):
        simulation.step(point)
    poses, task, departure = simulation.poses(), trajectory.task, None
    if trajectory.poses is not None:
        departure = float(np.abs(poses.bodies - trajectory.poses[-1])[:, :2].max())
    score = float(task.score(trajectory.scene, poses))
    published = float(task.published_code_score(trajectory.scene, poses))
    pairs = [(score, trajectory.score), (published, trajectory.published_code_score)]
    agrees = all(known is None or math.isclose(a, known, abs_tol=TOLERANCE) for a, known in pairs)
    return Replay(score, published, agrees, departure)
