"""Generating demonstrations with the scripted experts."""

import signal
from collections import deque
from collections.abc import Callable, Container, Generator, Iterable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import count
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from magical.demos.dataset import Dataset, DatasetWriter
from magical.demos.record import provenance
from magical.demos.trajectory import Trajectory
from magical.envs.ids import parse_env_id
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, WorkerDiedError
from magical.experts import modules_of, rollout
from magical.experts.noise import check_share
from magical.tasks import with_tasks

Item = TypeVar("Item")
Result = TypeVar("Result")

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
        seed: seed of the series of attempts.
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
    if number < 1 or workers < 1:
        raise ValueError(f"number, workers: expected at least 1, found {number}, {workers}")
    modules = modules_of(parsed.task) if workers > 1 else []
    writer = DatasetWriter(out)
    known = {
        entry.seed: entry.final_score
        for entry in Dataset.open(out).entries
        if (entry.env_id, entry.demonstrator) == (parsed, "expert")
        and entry.metadata.get("perturb") == perturb
    }
    make = with_tasks(partial(demonstrate, parsed, perturb=perturb), modules)
    series = (episode_seed(seed, attempt) for attempt in count(first))
    scores, dropped, already = list[float](), 0, 0
    with closing(map_in_order(make, series, workers, skip=known)) as attempts:
        while len(scores) < number:
            scene_seed, trajectory = next(attempts)
            score = known[scene_seed] if trajectory is None else trajectory.score or 0.0
            if score < min_score:
                dropped += 1
                if dropped > MAX_DROPPED * number:
                    what = f"{dropped} attempts scored less than {min_score}"
                    raise DatasetError(f"{env_id}: {what}; give a lower score, or perturb less")
                continue
            if trajectory is not None:
                writer.append(trajectory)
            already += trajectory is None
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


def map_in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int, skip: Container[Item] = ()
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item with `work(item)`, in order; None for the items in `skip`.

    Items may be infinite: close the generator when enough have come. With one worker everything is
    done in this process. Raises `WorkerDiedError` if a process is killed.
    """
    if workers == 1:
        for item in items:
            yield item, None if item in skip else work(item)
        return
    pool = ProcessPoolExecutor(
        workers,
        get_context("spawn"),
        initializer=signal.signal,  # the main process ends them
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        waiting: deque[tuple[Item, Future[Result] | None]] = deque()
        for item in items:
            waiting.append((item, None if item in skip else pool.submit(work, item)))
            if len(waiting) > workers:
                first, future = waiting.popleft()
                yield first, None if future is None else future.result()
        for first, future in waiting:
            yield first, None if future is None else future.result()
    except BrokenExecutor as error:
        raise WorkerDiedError("a worker process was killed, perhaps for lack of memory") from error
    finally:
        pool.shutdown(cancel_futures=True)
