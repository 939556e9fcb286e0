"""Generating demonstrations with the scripted experts."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import count, filterfalse, tee
from pathlib import Path

from magical.demos.dataset import Dataset, DatasetWriter
from magical.demos.record import provenance
from magical.demos.trajectory import Trajectory
from magical.envs.ids import parse_env_id
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError
from magical.experts import modules_of, rollout
from magical.experts.noise import check_share
from magical.processes import map_in_processes
from magical.tasks import with_tasks

MAX_DROPPED = 20  # attempts below the score, per requested demonstration, before giving up


@dataclass(frozen=True, slots=True)
class GenerateReport:
    """The demonstrations of one environment."""

    env_id: str
    scores: tuple[float, ...]
    already: int  # of these, the number that the dataset held before
    dropped: int  # attempts below `min_score`


def generate(
    env_id: str,
    number: int,
    out: Path | str,
    *,
    seed: int = 0,
    first: int = 0,
    perturb: float = 0.0,
    min_score: float = 0.0,
    workers: int = 1,
    progress: Callable[[int], None] = lambda _: None,
) -> GenerateReport:
    """Write `number` demonstrations by the task's scripted expert to a dataset.

    Attempt i starts in the scene of `reset(seed=episode_seed(seed, i))`, with its own strategy.
    Demonstrations that the dataset holds are not made again: an interrupted call can be repeated.

    Args:
        env_id: the environment's id; a preset in it is ignored.
        number: how many demonstrations of this series the dataset is to hold.
        out: the dataset's folder, created if it does not exist.
        seed: of the series of attempts.
        first: index of the first attempt, to continue a series.
        perturb: share of steps with a random action; the `labels` to imitate stay the expert's.
        min_score: attempts with a lower score (by the appendix's rule) are dropped.
        workers: number of processes, on which the result does not depend; with more than 1 the main
            script needs `if __name__ == "__main__":`.
        progress: called with 1 for each demonstration.

    Raises:
        DatasetError: too few attempts reach the score, or the dataset cannot be written.
        InvalidTaskError, NoExpertError: the workers cannot import the task, or it has no expert.
        WorkerDiedError: a worker was killed; what was already stored stays.
    """
    parsed = parse_env_id(env_id).without_preset
    check_share("perturb", perturb)
    modules = modules_of(parsed.task) if workers > 1 else []
    writer = DatasetWriter(out)
    known = {
        entry.seed: entry.final_score
        for entry in Dataset.open(out).entries
        if (entry.env_id, entry.demonstrator) == (parsed, "expert")
        and entry.metadata.get("perturb") == perturb
    }
    make = with_tasks(partial(demonstrate, parsed, perturb=perturb), modules)
    series, others = tee(episode_seed(seed, attempt) for attempt in count(first))
    unknown = filterfalse(known.__contains__, others)
    scores, dropped, already = list[float](), 0, 0
    with closing(map_in_processes(make, unknown, min(workers, number))) as attempts:
        while len(scores) < number:
            scene_seed = next(series)
            trajectory = None if scene_seed in known else next(attempts)
            score = known[scene_seed] if trajectory is None else trajectory.score or 0.0
            if score < min_score:
                dropped += 1
                if dropped > MAX_DROPPED * number:
                    raise DatasetError(
                        f"{env_id}: {dropped} attempts scored less than {min_score}; perturb less"
                    )
                continue
            if trajectory is None:
                already += 1
            else:
                writer.append(trajectory)
            scores.append(score)
            progress(1)
    return GenerateReport(parsed, tuple(scores), already, dropped)


def demonstrate(env_id: str, seed: int, *, perturb: float = 0.0) -> Trajectory:
    """One episode of the scripted expert, in the scene of `reset(seed=seed)`.

    `perturb` is as in `generate`. Raises `NoExpertError` if the task has no expert.
    """
    parsed = parse_env_id(env_id)
    episode = rollout(parsed.task, parsed.variant, seed, perturb=perturb)
    return Trajectory.from_bodies(
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
