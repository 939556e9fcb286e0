"""Entries as `magical evaluate` writes them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.evaluation import Entry, RolloutScore
from magical.runs import write_json
from tests.entries import entry_of

WriteEntry = Callable[..., Path]


def make_entry(method: str, scores: Mapping[str, Sequence[float]], **fields: Any) -> Entry:
    """Scores by task and variant (`MakeLine-Demo`); the published code's rule gives half."""
    rows = [
        RolloutScore(EnvId(*env.split("-")), i, evaluation_seed(i), score, score / 2)
        for env, values in scores.items()
        for i, score in enumerate(values)
    ]
    return entry_of(method, rows, **fields)


@pytest.fixture
def write_entry(tmp_path: Path) -> WriteEntry:
    """Write an entry and, with a training seed, the files of its run, below the test's folder."""

    def write(
        name: str,
        method: str,
        scores: Mapping[str, list[float]],
        seed: int | None = None,
        **fields: Any,
    ) -> Path:
        folder = tmp_path / name
        make_entry(method, scores, **fields).write(folder)
        if seed is not None:
            tasks = list(dict.fromkeys(env.split("-")[0] for env in scores))
            write_json(folder / "config.json", {"seed": seed, "tasks": tasks})
        return folder

    return write
