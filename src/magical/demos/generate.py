"""Generating demonstrations with the scripted experts."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

from magical.demos.record import provenance
from magical.demos.store.manifest import ManifestEntry, encoded
from magical.demos.store.trajectory import Trajectory
from magical.demos.store.writer import DatasetWriter
from magical.envs.action_spec import ActionSpaceName, action_spec
from magical.envs.ids import EnvId, parse_env_id
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError
from magical.experts import modules_of, rollout
from magical.experts.noise import check_share
from magical.processes import checked_workers, map_in_processes
from magical.tasks import with_tasks

MAX_DROPPED = 20  # attempts below the score, per requested demonstration, before giving up


@dataclass(frozen=True, slots=True)
class GenerateReport:
    """The outcome of the attempts in one environment."""

    env_id: str
    kept: int
    dropped: int  # below `min_score`
    scores: tuple[float, ...]  # of the demonstrations kept


def generate(
    env_id: str,
    number: int,
    out: Path | str,
    *,
    seed: int = 0,
    first: int = 0,
    perturb: float = 0.0,
    min_score: float = 0.0,
    workers: int | None = None,
    action_space: ActionSpaceName = "discrete",
    progress: Callable[[int], None] | None = None,
) -> GenerateReport:
    """Append `number` demonstrations by the task's scripted expert to a dataset.

    Attempt i starts in the scene of `reset(seed=episode_seed(seed, i))`, with its own strategy.

    Args:
        env_id: the environment's id; a preset in it is ignored.
        number: how many demonstrations to append.
        out: the dataset's folder, created if it does not exist.
        seed: seed of the series of attempts.
        first: index of the first attempt, to continue a series.
        perturb: share of steps with a random action; the `labels` to imitate stay the expert's.
        min_score: attempts with a lower score (by the appendix's rule) are dropped.
        workers: number of processes (default: one per core). The result does not depend on it.
        action_space: kind of the stored actions, "discrete" or "continuous".
        progress: called with 1 after each demonstration that is kept.

    Raises:
        DatasetError: too few attempts reach the score, or the dataset cannot be written.
        InvalidConfigError: `perturb` is not between 0 and 1.
        ValueError: `number` is less than 1, or `workers` is negative.
        InvalidTaskError, NoExpertError: the workers cannot import the task, or it has no expert.
        UnknownNameError: there is no such environment or action space.
        InvalidSceneError: a sampled scene does not fit its task.
        WorkerDiedError: a worker process was killed; what was already appended stays.
    """
    parsed, name = parse_env_id(env_id), action_spec(action_space).name
    check_share("perturb", perturb)
    if number < 1:
        raise ValueError(f"number: expected at least 1, found {number}")
    workers = checked_workers(workers)
    modules = modules_of(parsed.task) if workers > 1 else []
    attempt = with_tasks(partial(_attempt, parsed, seed, perturb, name), modules)
    with closing(map_in_processes(attempt, count(first), workers)) as results:
        return _keep(results, number, DatasetWriter(out), env_id, min_score, progress)


def _keep(
    attempts: Iterator[tuple[ManifestEntry, bytes]],
    number: int,
    writer: DatasetWriter,
    env_id: str,
    min_score: float,
    progress: Callable[[int], None] | None,
) -> GenerateReport:
    """Append the first `number` attempts that reach `min_score`."""
    scores, dropped = list[float](), 0
    while len(scores) < number:
        if dropped > MAX_DROPPED * number:
            raise DatasetError(
                f"{env_id}: {dropped} attempts scored less than {min_score} and {len(scores)} did "
                "not; give a lower score or a lower share of perturbed steps"
            )
        entry, raw = next(attempts)
        if entry.final_score < min_score:
            dropped += 1
            continue
        writer.append_encoded(entry, raw)
        scores.append(entry.final_score)
        if progress:
            progress(1)
    return GenerateReport(env_id, len(scores), dropped, tuple(scores))


def demonstrate(env_id: str, seed: int, *, perturb: float = 0.0) -> Trajectory:
    """One episode of the scripted expert, in the scene of `reset(seed=seed)`.

    `perturb` is as in `generate`.

    Raises:
        InvalidConfigError: `perturb` is not between 0 and 1.
        NoExpertError: the task has no expert.
        InvalidSceneError: the sampled scene does not fit the task.
    """
    parsed = parse_env_id(env_id)
    episode = rollout(parsed.task, parsed.variant, seed, perturb=perturb)
    return Trajectory.from_poses(
        parsed,
        episode.scene,
        episode.actions,
        episode.bodies,
        dynamics=episode.dynamics,
        seed=seed,
        demonstrator="expert",
        expert_actions=episode.expert_actions if perturb else None,
        metadata={"perturb": perturb, **provenance()},
    )


def _attempt(
    env_id: EnvId,
    seed: int,
    perturb: float,
    action_space: ActionSpaceName,
    attempt: int,
) -> tuple[ManifestEntry, bytes]:
    trajectory = demonstrate(env_id, episode_seed(seed, attempt), perturb=perturb)
    return encoded(trajectory.with_action_space(action_space))
