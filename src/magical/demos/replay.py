"""Running recorded actions again in today's physics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import EnvId
from magical.physics import Simulation

# Mean scores (published_code rule) of 25 human demonstrations a task, replayed in the published
# implementation itself, as they are and with the robot's start moved by 1e-9.
PUBLISHED_REPLAY: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "MoveToCorner": (1.00, 0.96),
        "MoveToRegion": (1.00, 1.00),
        "MatchRegions": (0.86, 0.54),
        "MakeLine": (0.46, 0.30),
        "FindDupe": (1.00, 1.00),
        "FixColour": (1.00, 1.00),
        "ClusterColour": (0.12, 0.10),
        "ClusterShape": (0.30, 0.28),
    }
)


@dataclass(frozen=True, slots=True)
class Replay:
    """How one trajectory ended when its actions were run again."""

    file: str
    env_id: EnvId
    demonstrator: str
    recorded: float  # the recorded score by the published code's rule
    score: float  # of the last state, by the appendix's rule
    published_code_score: float
    departure: float | None  # units: how far any body's last place is from the recorded one


@dataclass(frozen=True, slots=True)
class MeanReplay:
    """Means over one environment's trajectories."""

    env_id: EnvId
    count: int
    recorded: float
    score: float
    published_code_score: float
    published_replay: tuple[float, float] | None  # see `PUBLISHED_REPLAY`; human ones only
    exact: int | None  # how many ended in exactly the recorded poses, where those are known


def replay(trajectory: Trajectory, file: str = "") -> Replay:
    """Run a trajectory's actions from its start, and score where they lead."""
    world = Simulation(trajectory.scene, trajectory.dynamics)
    for action in trajectory.actions.tolist():
        world.step(action)
    poses = world.poses()
    departure = None
    if trajectory.poses is not None:
        moved = poses.bodies[:, :2] - trajectory.poses[-1, :, :2]
        departure = float(np.abs(moved).max())
    task = trajectory.task
    return Replay(
        file=file,
        env_id=trajectory.env_id,
        demonstrator=trajectory.demonstrator,
        recorded=trajectory.published_code_score,
        score=float(task.score(trajectory.scene, poses)),
        published_code_score=float(task.published_code_score(trajectory.scene, poses)),
        departure=departure,
    )


def mean_replays(replays: Sequence[Replay]) -> list[MeanReplay]:
    """Means for each environment, in the order of the names."""
    groups: dict[EnvId, list[Replay]] = {}
    for one in replays:
        groups.setdefault(one.env_id, []).append(one)
    return [_mean(env_id, groups[env_id]) for env_id in sorted(groups)]


def _mean(env_id: EnvId, group: list[Replay]) -> MeanReplay:
    human = env_id.variant == "Demo" and all(one.demonstrator == "human" for one in group)
    known = [one.departure for one in group if one.departure is not None]
    return MeanReplay(
        env_id=env_id,
        count=len(group),
        recorded=float(np.mean([one.recorded for one in group])),
        score=float(np.mean([one.score for one in group])),
        published_code_score=float(np.mean([one.published_code_score for one in group])),
        published_replay=PUBLISHED_REPLAY.get(env_id.task) if human else None,
        exact=sum(departure == 0.0 for departure in known) if known else None,
    )
