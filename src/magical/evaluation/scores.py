"""Scores of rollouts: the rows of `scores.csv`, and their summaries."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import groupby, islice
from operator import attrgetter
from typing import IO, Any, NamedTuple

import numpy as np

from magical.envs import EnvId, parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError, UnknownNameError
from magical.messages import quoted
from magical.tasks.axes import short_variant


class RolloutScore(NamedTuple):
    """One rollout and its final state's scores by both rules."""

    env_id: EnvId
    rollout: int
    seed: int
    score: float
    published_code_score: float


HEADER = RolloutScore._fields
MAX_ROWS = 60_000  # of an entry: 1,000 rollouts in each of sixty environments
MAX_LINE = 2000  # characters


def parse_rows(
    text: IO[str], header: Sequence[str], what: object, most: int
) -> Iterator[tuple[list[str], RolloutScore]]:
    """The columns before `HEADER` and the score of each row of a CSV file of any origin.

    Rows are bounded in length, and `most` is their largest number. Raises `ScoresError`, with
    `what` at the beginning, for another header or a row that is not of a rollout.
    """
    # A longer line is read in parts, which are not valid rows.
    lines = csv.reader(iter(partial(text.readline, MAX_LINE), ""))
    extra = len(header) - len(HEADER)
    try:
        if tuple(found := next(lines, [])) != tuple(header):
            shown = quoted(found) if found else "nothing"
            raise ScoresError(f"{what}: expected the header {','.join(header)}, found {shown}")
        for number, line in enumerate(islice(lines, most), 2):
            yield line[:extra], _parse_row(line[extra:], f"{what}, line {number}")
        if next(lines, None) is not None:
            raise ScoresError(f"{what}: expected at most {most} rows, found more")
    except csv.Error as error:
        raise ScoresError(f"{what}: line {lines.line_num} is damaged: {error}") from error


def _parse_row(line: Sequence[str], what: str) -> RolloutScore:
    try:
        text, rollout, seed, score, published = line
        env_id = _parse_env_id(text)
        row = RolloutScore(env_id, int(rollout), int(seed), float(score), float(published))
    except UnknownNameError as error:  # perhaps of a task that is not installed here
        raise ScoresError(f"{what}: {error}") from error
    except ValueError as error:
        expected = ",".join(HEADER)
        raise ScoresError(f"{what}: expected {expected}, found {quoted(line)}") from error
    if not (0.0 <= row.score <= 1.0 and 0.0 <= row.published_code_score <= 1.0):
        raise ScoresError(f"{what}: expected scores from 0 to 1, found {quoted(line[3:])}")
    return row


@lru_cache(1000)  # parsed once, not in every row
def _parse_env_id(text: str) -> EnvId:
    env_id = parse_env_id(text)
    if env_id.preset is not None:
        raise ValueError(f"expected an environment id without preset, found {text}")
    return env_id


def check_protocol(scores: Iterable[RolloutScore], seed: int) -> None:
    """Check that every environment has the same rollouts, each once, with the protocol's seeds."""
    rollouts: dict[EnvId, set[int]] = {}
    for row in scores:
        seen = rollouts.setdefault(row.env_id, set())
        if row.rollout in seen:
            raise ScoresError(f"{row.env_id}: expected rollout {row.rollout} once, found it twice")
        if row.rollout < 0 or row.seed != evaluation_seed(row.rollout, seed):
            raise ScoresError(
                f"{row.env_id}: expected seed {evaluation_seed(max(row.rollout, 0), seed)} for "
                f"rollout {row.rollout}, found {row.seed}; evaluate with `magical evaluate`"
            )
        seen.add(row.rollout)
    if not rollouts:
        raise ScoresError("expected at least one rollout, found none")
    expected = set(range(max(map(len, rollouts.values()))))
    for env_id, found in rollouts.items():
        if found != expected:
            missing = sorted(expected - found)
            raise ScoresError(
                f"{env_id}: expected rollouts 0 to {len(expected) - 1}, found {len(found)}; "
                f"missing: {', '.join(map(str, missing[:5]))}{', ...' if missing[5:] else ''}"
            )


def by_variant(scores: Iterable[RolloutScore]) -> dict[str, dict[str, list[RolloutScore]]]:
    """Group scores by task, then by the variant's short name, in the order of the rows."""
    table: dict[str, dict[str, list[RolloutScore]]] = {}
    for env_id, rows in groupby(scores, attrgetter("env_id")):  # mostly in order: a few groups
        cells = table.setdefault(env_id.task, {})
        cells.setdefault(short_variant(env_id.variant), []).extend(rows)
    return table


def summarise(scores: Iterable[RolloutScore]) -> dict[str, Any]:
    """Summarise scores as plain data: variant -> `mean`, `std`, `scores`, `published_code_mean`.

    `std` is over rollouts (divisor: their number). Nested by task if there are several.
    """
    table = {
        task: {variant: _summary(rows) for variant, rows in cells.items()}
        for task, cells in by_variant(scores).items()
    }
    return next(iter(table.values())) if len(table) == 1 else table


def _summary(rows: Sequence[RolloutScore]) -> dict[str, Any]:
    scores = [row.score for row in rows]
    return {
        "mean": float(np.mean(scores)),
        "std": float(np.std(scores)),
        "scores": scores,
        "published_code_mean": float(np.mean([row.published_code_score for row in rows])),
    }
