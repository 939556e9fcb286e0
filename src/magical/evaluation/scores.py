"""Scores of rollouts: rows of a file, and their summaries."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magical.envs import EnvId, parse_env_id
from magical.errors import ScoresError
from magical.evaluation.variants import short_variant
from magical.files import write_atomically


class RolloutScore(NamedTuple):
    """One rollout and its final state's scores by both rules."""

    env_id: EnvId
    rollout: int
    seed: int
    score: float
    published_code_score: float


HEADER = RolloutScore._fields


def write_scores(scores: Iterable[RolloutScore], path: Path | str) -> None:
    """Write `scores.csv`; floats are read back unchanged."""
    with write_atomically(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(scores)


def read_scores(path: Path | str) -> list[RolloutScore]:
    """Read what `write_scores` wrote; raises `ScoresError` naming the line that is wrong."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    if not lines or tuple(lines[0]) != HEADER:
        found = lines[0] if lines else "nothing"
        raise ScoresError(f"{path}: expected the header {','.join(HEADER)}, found {found}")
    return [_parse(line, f"{path}, line {number}") for number, line in enumerate(lines[1:], 2)]


def _parse(line: Sequence[str], where: str) -> RolloutScore:
    try:
        env_id, rollout, seed, score, published = line
        row = RolloutScore(
            parse_env_id(env_id), int(rollout), int(seed), float(score), float(published)
        )
    except ValueError as error:
        raise ScoresError(f"{where}: expected {','.join(HEADER)}, found {line}") from error
    if not (0.0 <= row.score <= 1.0 and 0.0 <= row.published_code_score <= 1.0):
        raise ScoresError(f"{where}: expected scores from 0 to 1, found {line[3:]}")
    return row


def by_variant(scores: Iterable[RolloutScore]) -> dict[str, dict[str, list[RolloutScore]]]:
    """Group scores by task, then by the variant's short name, in the order of the rows."""
    table: dict[str, dict[str, list[RolloutScore]]] = {}
    for row in scores:
        cells = table.setdefault(row.env_id.task, {})
        cells.setdefault(short_variant(row.env_id.variant), []).append(row)
    return table


def summarise(scores: Iterable[RolloutScore]) -> dict[str, Any]:
    """Summarise scores as plain data: variant -> `mean`, `std`, `scores`, `published_code_mean`.

    `std` is over rollouts (divisor: their number). Nested by task where there are several.
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
