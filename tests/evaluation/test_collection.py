"""Many entries in two files."""

import gzip
import json
from pathlib import Path

import pytest

from magical.envs.seeds import evaluation_seed
from magical.errors import ScoresError
from magical.evaluation import RolloutScore, environments
from magical.evaluation import entry as entries
from magical.evaluation.entry import read_collection, write_collection
from tests.entries import entry_of

ROWS = [
    RolloutScore(env_id, i, evaluation_seed(i), 0.1 + 0.2, 1 / 3)
    for env_id in environments(["MoveToRegion"])
    for i in range(3)
]
ENTRIES = {
    "runs/b": entry_of("B", ROWS, nudge=1e-9, record={"test_evaluations": 3}),
    "runs/a/leaderboard": entry_of("A", ROWS[:3]),
}


def test_entries_come_back_and_the_same_ones_give_the_same_bytes(tmp_path: Path) -> None:
    write_collection(tmp_path / "x", ENTRIES)
    assert read_collection(tmp_path / "x") == ENTRIES
    write_collection(tmp_path / "y", dict(reversed(ENTRIES.items())))
    for name in ("entries.json", "scores.csv.gz"):
        assert (tmp_path / "x" / name).read_bytes() == (tmp_path / "y" / name).read_bytes()
    with gzip.open(tmp_path / "x" / "scores.csv.gz") as rows:
        rows.read()
        assert rows.mtime == 0  # at any time


def test_a_wrong_entry_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    write_collection(tmp_path, ENTRIES)
    stated = json.loads((tmp_path / "entries.json").read_text())
    stated["runs/b"]["seed"] = 1
    stated["runs/c"] = {"method": "C"}
    (tmp_path / "entries.json").write_text(json.dumps(stated))
    found = read_collection(tmp_path)
    assert found["runs/a/leaderboard"] == ENTRIES["runs/a/leaderboard"]
    assert "runs/b: magical/MoveToRegion-Demo-v0: expected seed" in str(found["runs/b"])
    assert "runs/c: expected at least one rollout" in str(found["runs/c"])


def test_damaged_scores_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_collection(tmp_path, ENTRIES)
    rows = tmp_path / "scores.csv.gz"
    whole = rows.read_bytes()
    text = gzip.decompress(whole)
    for data, message in (
        (whole[:-20], "expected compressed scores"),
        (b"not compressed", "expected compressed scores"),
        (gzip.compress(text.replace(b"entry,", b"name,", 1)), "expected the header entry,env_id"),
        (gzip.compress(text.replace(b",0.3", b",3.3", 1)), "line 2: expected scores from 0 to 1"),
    ):
        rows.write_bytes(data)
        with pytest.raises(ScoresError, match=message):
            read_collection(tmp_path)
    rows.write_bytes(whole)
    assert entries.COLLECTION_ROWS <= 1_000_000
    monkeypatch.setattr(entries, "COLLECTION_ROWS", 5)
    with pytest.raises(ScoresError, match="expected at most 5 rows"):
        read_collection(tmp_path)
