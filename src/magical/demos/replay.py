"""Replaying recorded actions in the simulation."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from magical.demos.store.trajectory import Trajectory
from magical.envs.action_spec import CONTINUOUS
from magical.envs.ids import EnvId
from magical.grouping import group_by
from magical.physics import Simulation
from magical.scene import Poses

# Mean scores (by the published code's rule) of 25 human demonstrations per task, replayed in the
# published implementation itself: unchanged, and with the robot's initial position moved by 1e-9.
PUBLISHED_REPLAY: Mapping[str, tuple[float, float]] = {
    "MoveToCorner": (1.00, 0.96),
    "MoveToRegion": (1.00, 1.00),
    "MatchRegions": (0.86, 0.54),
    "MakeLine": (0.46, 0.30),
    "FindDupe": (1.00, 1.00),
    "FixColour": (1.00, 1.00),
    "ClusterColour": (0.12, 0.10),
    "ClusterShape": (0.30, 0.28),
}
TOLERANCE = 1e-6  # on scores, which other programs may have rounded to single precision


@dataclass(frozen=True, slots=True)
class Replay:
    """The outcome of replaying one trajectory."""

    file: str
    env_id: EnvId
    demonstrator: str
    recorded: float  # the recorded score by the published code's rule
    recorded_score: float | None  # by the appendix's rule, if known
    score: float  # of the final state, by the appendix's rule
    published_code_score: float
    departure: float | None  # largest deviation of a body's final x or y from the recorded one

    @property
    def agrees(self) -> bool:
        """Whether the scores equal the recorded ones, by every rule with a recorded score."""
        same = math.isclose(self.published_code_score, self.recorded, abs_tol=TOLERANCE)
        if self.recorded_score is None:
            return same
        return same and math.isclose(self.score, self.recorded_score, abs_tol=TOLERANCE)


@dataclass(frozen=True, slots=True)
class MeanReplay:
    """Means over the trajectories of one environment."""

    env_id: EnvId
    count: int
    recorded: float
    score: float
    published_code_score: float
    agree: int  # number of replays with the recorded scores
    published_replay: tuple[float, float] | None  # `PUBLISHED_REPLAY`, for human demonstrations
    exact: int | None  # number that ended at exactly the recorded positions, if those are known


def replay(trajectory: Trajectory, file: str = "") -> Replay:
    """Simulate a trajectory's actions from its initial scene, and score the final state."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    for point in CONTINUOUS.convert(trajectory.actions):
        simulation.step(point)
    poses = Poses(simulation.read()[:, :3])
    departure = None
    if trajectory.poses is not None:
        difference = poses.bodies[:, :2] - trajectory.poses[-1, :, :2]
        departure = float(np.abs(difference).max())
    task = trajectory.task
    return Replay(
        file=file,
        env_id=trajectory.env_id,
        demonstrator=trajectory.demonstrator,
        recorded=trajectory.published_code_score,
        recorded_score=trajectory.score,
        score=float(task.score(trajectory.scene, poses)),
        published_code_score=float(task.published_code_score(trajectory.scene, poses)),
        departure=departure,
    )


def mean_replays(replays: Sequence[Replay]) -> list[MeanReplay]:
    """Mean results for each environment, sorted by id."""
    groups = group_by(replays, attrgetter("env_id"))
    return [_mean(env_id, groups[env_id]) for env_id in sorted(groups)]


def _mean(env_id: EnvId, group: list[Replay]) -> MeanReplay:
    human = env_id.variant == "Demo" and all(r.demonstrator == "human" for r in group)
    known = [r.departure for r in group if r.departure is not None]
    return MeanReplay(
        env_id=env_id,
        count=len(group),
        recorded=float(np.mean([r.recorded for r in group])),
        score=float(np.mean([r.score for r in group])),
        published_code_score=float(np.mean([r.published_code_score for r in group])),
        agree=sum(replayed.agrees for replayed in group),
        published_replay=PUBLISHED_REPLAY.get(env_id.task) if human else None,
        exact=sum(departure == 0.0 for departure in known) if known else None,
    )
