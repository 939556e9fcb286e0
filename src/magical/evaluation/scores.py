"""Scores of rollouts: rows of a file, and their summaries."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache, partial
from gzip import GzipFile
from itertools import groupby, islice
from operator import attrgetter
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from magical.envs import EnvId, parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError, UnknownNameError
from magical.files import open_regular, reading, write_atomically
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


def write_scores(scores: Iterable[RolloutScore], path: Path | str) -> None:
    """Write `scores.csv`; floats are read back unchanged."""
    with write_atomically(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(scores)


def read_scores(path: Path | str) -> list[RolloutScore]:
    """Read what `write_scores` wrote; raises `ScoresError` naming the line that is wrong."""
    source = Path(path)
    with reading(source, ScoresError), open_regular(source, follow_links=True) as file:
        lines = read_lines(file, HEADER, path, MAX_ROWS)
        return [parse_row(line, path, number) for number, line in enumerate(lines, 2)]


def read_lines(
    file: IO[bytes] | GzipFile, header: Sequence[str], path: Path | str, most: int
) -> Iterator[list[str]]:
    """The lines of a CSV file of any origin, after its header, bounded in length and number.

    Raises:
        ScoresError: another header, more than `most` lines, or a line that is not CSV.
    """
    with io.TextIOWrapper(file, "utf-8", errors="replace", newline="") as text:
        # A longer line is read in parts, which are not valid rows.
        lines = csv.reader(iter(partial(text.readline, MAX_LINE), ""))
        try:
            found = next(lines, [])
            if tuple(found) != tuple(header):
                shown = quoted(found) if found else "nothing"
                raise ScoresError(f"{path}: expected the header {','.join(header)}, found {shown}")
            yield from islice(lines, most)
            if next(lines, None) is not None:
                raise ScoresError(f"{path}: expected at most {most} rows, found more")
        except csv.Error as error:
            raise ScoresError(f"{path}: line {lines.line_num} is damaged: {error}") from error


def parse_row(line: Sequence[str], path: Path | str, number: int) -> RolloutScore:
    """A row of `scores.csv`; raises `ScoresError` naming the line's number."""
    try:
        text, rollout, seed, score, published = line
        env_id = _parse_env_id(text)
        row = RolloutScore(env_id, int(rollout), int(seed), float(score), float(published))
    except UnknownNameError as error:  # perhaps of a task that is not installed here
        raise ScoresError(f"{path}, line {number}: {error}") from error
    except ValueError as error:
        raise ScoresError(
            f"{path}, line {number}: expected {','.join(HEADER)}, found {quoted(line)}"
        ) from error
    if not (0.0 <= row.score <= 1.0 and 0.0 <= row.published_code_score <= 1.0):
        raise ScoresError(
            f"{path}, line {number}: expected scores from 0 to 1, found {quoted(line[3:])}"
        )
    return row


@lru_cache(1000)  # parsed once, not in every row
def _parse_env_id(text: str) -> EnvId:
    env_id = parse_env_id(text)
    if env_id.preset is not None:
        raise ValueError(f"expected an environment id without preset, found {text}")
    return env_id


def check_protocol(scores: Iterable[RolloutScore], seed: int) -> None:
    """Check that every environment has the same rollouts, each once, with the protocol's seeds.

    Args:
        scores: the scores of one evaluation.
        seed: which set of fixed seeds it used.

    Raises:
        ScoresError: the message names the environment, and what is missing, duplicated or wrong.
    """
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
