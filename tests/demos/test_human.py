"""The published human demonstrations: reading them safely, importing, downloading."""

import hashlib
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, Frames, Trajectory
from magical.demos.human import (
    download,
    import_published,
    published_sums,
    read_demonstration,
)
from magical.errors import DatasetError
from magical.scene import Poses
from tests.demos.conftest import MODULE, Run, published, write

ONE = "move-to-region/demo-MoveToRegion-Demo-v0-001.pkl.gz"


def test_imported_files_are_the_stored_ones(
    human_archive: Path, human_trajectories: Path, tmp_path: Path, run: Run
) -> None:
    """Two files, whose frames are those of the Demo scene but for another graphics driver."""
    files = [human_archive / ONE, *human_archive.glob("fix-colour/*-000*")]
    report = import_published(files, tmp_path / "d")
    assert report.imported == [file.name for file in files]
    assert (report.failed, report.duplicates, report.already) == ([], [], [])
    stored = Dataset.open(human_trajectories)
    numbers = {entry.name: number for number, entry in enumerate(stored.entries)}
    for file, ours in zip(files, Dataset.open(tmp_path / "d"), strict=True):
        theirs = stored[numbers[file.name]]
        np.testing.assert_equal(ours.frames, theirs.frames)
        np.testing.assert_array_equal(ours.actions, theirs.actions)
        assert (ours.scene, ours.metadata) == (theirs.scene, theirs.metadata)
        assert (ours.demonstrator, ours.score) == ("human", None)
        bodies = np.stack([Poses.at_rest(ours.scene).bodies] * 2)
        rendered = Trajectory.from_bodies(ours.env_id, ours.scene, [0], bodies)
        for view in ("ego", "allo"):
            first = Frames(rendered, view).take([0])[0].astype(int)
            assert np.abs(first - ours.frames[view][0]).mean() < 1.0
    before = sorted((tmp_path / "d").iterdir())
    status, result = run("import", files[0], "--out", tmp_path / "d")
    assert (status, result["imported"], result["already"]) == (0, [], [files[0].name])
    assert sorted((tmp_path / "d").iterdir()) == before


def test_duplicates_are_reported_and_damaged_files_cost_themselves_alone(
    tmp_path: Path, run: Run
) -> None:
    same, folder = published(steps=1), tmp_path / "in"
    for level, file in enumerate(("a/demo-019", "b/demo-019", "demo-020"), 1):
        write(folder / f"{file}.pkl.gz", same, level)
    raw = write(folder / "demo-018.pkl.gz", published(steps=1, seed=1)).read_bytes()
    for i, content in enumerate((raw[:9], raw[: len(raw) // 2], b"x" + raw)):
        (folder / f"{i}.pkl.gz").write_bytes(content)
    pairs = [["demo-020.pkl.gz", "demo-019.pkl.gz"]]
    pairs = [[str(folder / "b" / "demo-019.pkl.gz"), "demo-019.pkl.gz"], *pairs]
    for out, imported, more in (("all", 4, ()), ("once", 2, ["--skip-duplicates"])):
        status, result = run("import", folder, "--out", tmp_path / out, "--workers", 1, *more)
        assert (status, result["duplicates"], len(result["imported"])) == (1, pairs, imported)
        assert len(Dataset.open(tmp_path / out)) == imported
        assert [Path(file).name[0] for file, _ in result["failed"]] == ["0", "1", "2"]
        assert all(reason.startswith(file) for file, reason in result["failed"])


def test_sums_of_the_published_archive() -> None:
    sums = published_sums()
    joined = "".join(f"{digest}  {path}\n" for path, digest in sums.items())
    sha256 = "e58d49ee1ac3309353a901573f38ce8519dcfc4eef4247e2d141bcb93f206566"
    assert hashlib.sha256(joined.encode()).hexdigest() == sha256
    assert len({Path(path).name for path in sums}) == 203


def test_a_file_of_a_published_name_must_have_the_published_sum(tmp_path: Path) -> None:
    file = write(tmp_path / Path(ONE).name, published())
    with pytest.raises(DatasetError, match=f"expected SHA-256 {published_sums()[ONE]}, found"):
        read_demonstration(file)


def test_frames_are_averaged(tmp_path: Path) -> None:
    trajectory, full = read_demonstration(write(tmp_path / "demo.pkl.gz", published()))
    for view, frames in full.items():
        blocks = np.stack(frames).reshape(3, 96, 4, 96, 4, 3).astype(np.float64)
        np.testing.assert_array_equal(trajectory.frames[view], np.round(blocks.mean(axis=(2, 4))))
    assert trajectory.published_code_score == 0.75


FRAME = np.zeros((384, 384, 3), np.uint8)
SHAPE = b"M\x80\x01M\x80\x01K\x03"  # as a published file says it
LARGE, NEGATIVE = b"M\x80\x01M\x80\x01K\x04", b"J\x80\xfe\xff\xffJ\x80\xfe\xff\xffK\x03"


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"acts": np.array([1])}, r"acts: expected integers .* of shape \(2,\)"),
        ({"score": np.nan}, "score"),
        ({"env_name": "MoveToCornr-Demo-v0"}, "not registered"),
        ({"env_name": "json.tool:x-Demo-v0"}, "a Demo environment"),
        ({"env_name": 1}, "expected a demonstration"),
        ({"obs": [{"allo": FRAME, "ego": FRAME.astype(float)}] * 3}, "expected uint8 frames"),
        ({"obs": [{"allo": FRAME, "ego": FRAME[:96, :96]}] * 3}, "expected uint8 frames"),
        ({"obs": [{"allo": FRAME, "ego": FRAME}] * 2000}, "obs: expected fewer, found 2000"),
        (published().replace(SHAPE, LARGE, 1), "pkl.gz"),
        (published().replace(SHAPE, NEGATIVE, 1), "pkl.gz"),
    ],
)
def test_parts_that_do_not_fit_are_refused(tmp_path: Path, parts: Any, message: str) -> None:
    data = parts if isinstance(parts, bytes) else published(**parts)
    file = write(tmp_path / "demo.pkl.gz", data)
    with pytest.raises(DatasetError, match=message) as caught:
        read_demonstration(file)
    assert str(file) in str(caught.value)


P4 = b"\x80\x04"  # PROTO
MARKER = Path("executed")  # in the working folder, which is the test's own
SYSTEM = (b"nt" if os.name == "nt" else b"posix") + b"\nsystem\n"
TOUCH = f"Vtouch {MARKER}\n".encode()
RECORD = f"c{MODULE}\nMILBenchTrajectory\n".encode()
DOUBLED = b"".join(b"\x94h" + bytes([i]) + b"\x86" for i in range(100))
HOSTILE: dict[str, bytes] = {
    "GLOBAL": b"c" + SYSTEM + b"(" + TOUCH + b"tR.",
    "STACK_GLOBAL": P4 + b"Vposix\nVsystem\n\x93(" + TOUCH + b"tR.",
    "INST": b"(" + TOUCH + b"i" + SYSTEM + b".",
    "OBJ": b"(c" + SYSTEM + TOUCH + b"o.",
    "exec": b"cbuiltins\nexec\n(Vopen('" + str(MARKER).encode() + b"', 'w')\ntR.",
    "dotted name": P4 + b"Vos\nVpath.os.system\n\x93(" + TOUCH + b"tR.",
    "dotted from an allowed name": P4 + b"Vcollections\nVOrderedDict.__init__.__globals__\n\x93.",
    "nested": P4 + b"}Vtrajectory\n" + RECORD + b"(Nc" + SYSTEM + b"(" + TOUCH + b"tR]]t\x81s.",
    "extension": b"\x80\x02\x82\x07(" + TOUCH + b"tR.",
    "persistent id": P4 + b"Vx\nQ.",
    "calling ndarray": P4 + b"cnumpy\nndarray\nJ\xff\xff\xff\x7f\x85R.",
    "terminal escapes": P4 + b"cos\x1b[2J\x07\nsystem\n.",
    "underflow": P4 + b"R.",
    "a large item": P4 + b"\x8e" + (1 << 62).to_bytes(8, "little") + b"x.",
    "a large byte array": b"\x80\x05\x96" + (1 << 40).to_bytes(8, "little") + b"x.",
    "a large memo": P4 + b"]r\xff\xff\xff\x7f.",
    "many objects": P4 + b"]" * 300_000 + b".",
    "deep": P4 + b")" + b"\x85" * 100_000 + b".",
    "two to the hundredth": P4 + b")" + DOUBLED + b".",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_pickle_is_refused_and_not_executed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    monkeypatch.chdir(tmp_path)
    file = write(tmp_path / "demo.pkl.gz", HOSTILE[what])
    with pytest.raises(DatasetError) as caught:
        read_demonstration(file)
    assert str(caught.value).startswith(str(file))
    assert str(caught.value).isprintable()
    assert not MARKER.exists()


def test_what_unpacks_to_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path / "demo.pkl.gz", published())
    monkeypatch.setattr("magical.demos.human.MAX_UNPACKED", 2_000_000)
    with pytest.raises(DatasetError, match="unpacks to more than 2000000 bytes"):
        read_demonstration(file)


HOST = "https://host.invalid"


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> None:
    """Serves files of this machine under `HOST` and their path."""
    pooch = pytest.importorskip("pooch")

    def fetch(url: str, out: Any, _: Any) -> None:
        shutil.copy(url.removeprefix(HOST), out)

    monkeypatch.setattr(pooch.core, "choose_downloader", lambda *_, **__: fetch)
    monkeypatch.setattr("time.sleep", lambda _: None)


@pytest.mark.usefixtures("host")
def test_a_download_is_verified_imported_and_cleaned_up(
    tmp_path: Path, human_archive: Path, run: Run
) -> None:
    out = tmp_path / "d"
    command = ("download", "--out", out, "--base-url", f"{HOST}{human_archive}", "--workers", 1)
    for pattern, files in (("move-to-region/*000*", 1), ("move-to-region/*00[0-1]*", 2)):
        status, result = run(*command, "--files", pattern)
        assert (status, len(result["imported"]), result["not_fetched"]) == (0, 1, [])
        assert len(list(out.iterdir())) == files
    assert main(["demos", *map(str, command), "--files", "nothing/*"]) == 1
    assert main(["demos", "import", str(tmp_path / "none"), "--out", str(out)]) == 1


@pytest.mark.usefixtures("host")
def test_files_that_cannot_be_fetched_are_named(tmp_path: Path) -> None:
    for file, content in (("good", b"content"), ("other", b"another")):
        (tmp_path / file).write_bytes(content)
    wanted = dict.fromkeys(("good", "other", "missing"), hashlib.sha256(b"content").hexdigest())
    url = f"{HOST}{tmp_path}"
    found, errors = download(wanted, tmp_path / "d", url, lambda _: None)
    assert found == [tmp_path / "d" / "good"]
    assert [error.partition(": ")[0] for error in errors] == [f"{url}/other", f"{url}/missing"]
    with pytest.raises(DatasetError, match="run again"):
        download(wanted, tmp_path / "none", f"{url}/none", lambda _: None)
