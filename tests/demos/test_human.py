"""The published human demonstrations: reading them safely, importing, downloading."""

import gzip
import hashlib
import http.server
import os
import pickle
import subprocess
import threading
from collections import OrderedDict, namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, Frames, Trajectory
from magical.demos.human import (
    download,
    find_published,
    import_published,
    published_sums,
    read_demonstration,
)
from magical.errors import DatasetError, DownloadError, UnsafeFileError
from magical.scene import Poses
from tests.demos.conftest import Run, name, text

P4 = b"\x80\x04"  # PROTO
RECORD = name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
RECONSTRUCT = name("numpy.core.multiarray", "_reconstruct")
MARKER = Path("executed")  # in the working folder, which is the test's own
TOUCH = f"touch {MARKER}"
ONE = "move-to-region/demo-MoveToRegion-Demo-v0-001.pkl.gz"


@pytest.fixture(scope="session")
def human(human_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of each task, imported."""
    out = tmp_path_factory.mktemp("human") / "dataset"
    files = [file for file in find_published(human_archive) if "v0-000" in file.name]
    report = import_published(files, out, workers=2)
    assert report.imported == [file.name for file in files]
    assert (report.failed, report.duplicates, report.already) == ([], [], [])
    return out


class Unpickler(pickle.Unpickler):
    """Reads the published files independently, with real arrays."""

    def find_class(self, module: str, name: str) -> Any:
        known = {
            "_reconstruct": np._core.multiarray._reconstruct,
            "ndarray": np.ndarray,
            "dtype": np.dtype,
            "OrderedDict": OrderedDict,
            "MILBenchTrajectory": namedtuple("MILBenchTrajectory", "acts obs rews infos"),
        }
        return known[name]


@pytest.mark.parametrize("task", ["MoveToRegion", "FixColour"])
def test_imported_frames_are_the_4_x_4_average(human: Path, human_archive: Path, task: str) -> None:
    (stored,) = Dataset.open(human).filter(task=task)
    (file,) = human_archive.glob(f"*/{stored.metadata['source']}")
    with gzip.open(file) as opened:
        data = Unpickler(opened).load()
    assert (stored.demonstrator, stored.score) == ("human", None)
    assert stored.published_code_score == data["score"]
    np.testing.assert_array_equal(stored.actions, data["trajectory"].acts)
    assert len(stored.frames["ego"]) == len(data["trajectory"].obs)
    for time, observation in enumerate(data["trajectory"].obs):
        for view in ("allo", "ego"):
            blocks = observation[view].reshape(96, 4, 96, 4, 3).astype(np.float64)
            average = np.round(blocks.mean(axis=(1, 3))).astype(np.uint8)
            np.testing.assert_array_equal(stored.frames[view][time], average)


def test_imported_files_are_the_stored_ones(human: Path, human_trajectories: Path) -> None:
    stored = Dataset.open(human_trajectories)
    entries = {entry.name: entry for entry in stored.entries}
    dataset = Dataset.open(human)
    for entry, ours in zip(dataset.entries, dataset, strict=True):
        theirs = stored[stored.entries.index(entries[entry.name])]
        np.testing.assert_equal(ours.frames, theirs.frames)
        np.testing.assert_array_equal(ours.actions, theirs.actions)
        assert (ours.scene, ours.metadata) == (theirs.scene, theirs.metadata)


def test_the_first_frame_is_the_demo_scene(human: Path) -> None:
    for recorded in Dataset.open(human):
        bodies = np.stack([Poses.at_rest(recorded.scene).bodies] * 2)
        rendered = Trajectory.from_bodies(recorded.env_id, recorded.scene, [0], bodies)
        for view in ("ego", "allo"):
            ours = Frames(rendered, view).take([0])[0]
            assert np.abs(ours.astype(int) - recorded.frames[view][0]).mean() < 1.0


def test_an_import_again_changes_nothing(human: Path, human_archive: Path, run: Run) -> None:
    before = sorted(human.iterdir())
    source = next(human_archive.glob("fix-colour/*-000*"))
    status, result = run("import", source, "--out", human)
    assert (status, result["imported"], result["already"]) == (0, [], [source.name])
    assert sorted(human.iterdir()) == before


def test_duplicates_are_reported_and_may_be_left_out(
    tmp_path: Path, published: Any, run: Run
) -> None:
    pickled, folder = published(steps=1).pickle, tmp_path / "in"
    for level, where in enumerate(("a", "b"), 1):  # files of one name
        (folder / where).mkdir(parents=True)
        (folder / where / "demo-019.pkl.gz").write_bytes(gzip.compress(pickled, level))
    published(steps=1, seed=1).write(folder / "demo-018.pkl.gz")
    (folder / "demo-020.pkl.gz").write_bytes(gzip.compress(pickled, 3))
    pairs = [["demo-020.pkl.gz", "demo-019.pkl.gz"]]
    pairs = [[str(folder / "b" / "demo-019.pkl.gz"), "demo-019.pkl.gz"], *pairs]
    options = ("--out", tmp_path / "all", "--workers", 1)
    status, result = run("import", folder, *options)
    assert (status, result["duplicates"], len(result["imported"])) == (0, pairs, 4)
    assert len(run("info", tmp_path / "all")[1]["duplicates"]) == 2
    options = ("--out", tmp_path / "once", "--workers", 1, "--skip-duplicates")
    status, result = run("import", folder, *options)
    assert (status, result["duplicates"], len(result["imported"])) == (0, pairs, 2)
    assert len(Dataset.open(tmp_path / "once")) == 2


def test_sums_of_the_published_archive() -> None:
    sums = published_sums()
    joined = "".join(f"{digest}  {path}\n" for path, digest in sums.items())
    sha256 = "e58d49ee1ac3309353a901573f38ce8519dcfc4eef4247e2d141bcb93f206566"
    assert hashlib.sha256(joined.encode()).hexdigest() == sha256
    assert len({Path(path).name for path in sums}) == 203


def test_a_source_without_published_files_is_refused(tmp_path: Path) -> None:
    for source in (tmp_path, tmp_path / "missing"):
        with pytest.raises(DatasetError, match="expected files"):
            find_published(source)


def test_a_file_of_a_published_name_must_have_the_published_sum(
    tmp_path: Path, published: Any
) -> None:
    file = published().write(tmp_path / Path(ONE).name)
    with pytest.raises(UnsafeFileError, match=f"expected SHA-256 {published_sums()[ONE]}, found"):
        read_demonstration(file)


def test_a_hand_made_file_is_read_as_the_published_ones(tmp_path: Path, published: Any) -> None:
    made = published()
    trajectory, _ = read_demonstration(made.write(tmp_path / "demo.pkl.gz"))
    for k, view in enumerate(("allo", "ego")):
        blocks = made.frames[:, k].reshape(3, 96, 4, 96, 4, 3).astype(np.float64)
        np.testing.assert_array_equal(trajectory.frames[view], np.round(blocks.mean(axis=(2, 4))))
    assert trajectory.actions.tolist() == made.actions.tolist()
    assert trajectory.published_code_score == 0.75


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.obs.pop(), r"acts: expected integers .* of shape \(1,\)"),
        (lambda p: setattr(p, "acts", b"]"), "acts"),
        (lambda p: setattr(p, "score", b"N"), "score"),
        (lambda p: setattr(p, "score", b"G" + np.array(np.nan, ">f8").tobytes()), "score"),
        (lambda p: setattr(p, "env_name", text("MoveToCornr-Demo-v0")), "not registered"),
        (lambda p: setattr(p, "env_name", text("MoveToCorner-TestAll-v0")), "a Demo environment"),
        (lambda p: setattr(p, "env_name", text("json.tool:x-Demo-v0")), "a Demo environment"),
        (lambda p: setattr(p, "env_name", b"K\x01"), "expected a demonstration"),
        *(
            (lambda p, v=v, s=s: p.obs.__setitem__(0, p.observation(v, s)), "demo.pkl.gz")
            for v, s in (
                (np.zeros((384, 384, 3)), None),
                (np.zeros((96, 96, 3), np.uint8), None),
                (np.zeros((384, 384, 3), np.uint8), (384, 384, 4)),
                (np.zeros((384, 384, 3), np.uint8), (-384, -384, 3)),
            )
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(
    tmp_path: Path, published: Any, change: Any, message: str
) -> None:
    made = published()
    change(made)
    file = made.write(tmp_path / "demo.pkl.gz")
    with pytest.raises(UnsafeFileError, match=message) as caught:
        read_demonstration(file)
    assert str(file) in str(caught.value)


class Calls:
    """Pickles to a call of a function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.reduced = function, arguments

    def __reduce__(self) -> Any:
        return self.reduced


def called(module: str, attribute: str, *arguments: str) -> bytes:
    """STACK_GLOBAL and REDUCE."""
    return name(module, attribute) + b"(" + b"".join(map(text, arguments)) + b"tR"


OS = "nt" if os.name == "nt" else "posix"
SYSTEM = called(OS, "system", TOUCH)
DOUBLED = b"".join(b"\x94h" + bytes([i]) + b"\x86" for i in range(100))
HOSTILE: dict[str, bytes] = {
    **{f"os.system, protocol {n}": pickle.dumps(Calls(os.system, TOUCH), n) for n in range(6)},
    "exec": pickle.dumps(Calls(exec, f"open({str(MARKER)!r}, 'w')")),
    "subprocess": pickle.dumps(Calls(subprocess.check_call, ["touch", str(MARKER)])),
    "dotted name": P4 + called("os", "path.os.system", TOUCH) + b".",
    "nested": P4
    + b"}"
    + text("trajectory")
    + RECORD
    + b"(N"
    + called(OS, "system", TOUCH)
    + b"]]t\x81s.",
    "INST": b"(S" + repr(TOUCH).encode() + b"\ni" + OS.encode() + b"\nsystem\n.",
    "OBJ": b"(c" + OS.encode() + b"\nsystem\nS" + repr(TOUCH).encode() + b"\no.",
    "extension": b"\x80\x02\x82\x07(" + text(TOUCH) + b"tR.",
    "persistent id": P4 + text("x") + b"Q.",
    "numpy loading a file": P4 + called("numpy", "load", "evil.npy") + b".",
    "dotted from an allowed name": P4
    + name("collections", "OrderedDict.__init__.__globals__")
    + b".",
    "calling ndarray": P4 + name("numpy", "ndarray") + b"J\xff\xff\xff\x7f\x85R.",
    "terminal escapes": P4 + name("os\x1b[2J\x07", "system") + b".",
    "underflow": P4 + b"R.",
    "no end": P4 + b"]",
    "not a pickle": b"PK\x03\x04 hello",
    "empty": b"",
    "a large item": P4 + b"\x8e" + (1 << 62).to_bytes(8, "little") + b"x.",
    "a large byte array": b"\x80\x05\x96" + (1 << 40).to_bytes(8, "little") + b"x.",
    "a large memo": P4 + b"]r\xff\xff\xff\x7f.",
    "many objects": P4 + b"]" * 300_000 + b".",
    "deep": P4 + b")" + b"\x85" * 100_000 + b".",
    "two to the hundredth": P4
    + b")"
    + b"".join(b"\x94h" + bytes([i]) + b"\x86" for i in range(100))
    + b".",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_pickle_is_refused_and_not_executed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "demo.pkl.gz"
    file.write_bytes(gzip.compress(HOSTILE[what]))
    with pytest.raises(UnsafeFileError) as caught:
        read_demonstration(file)
    assert str(caught.value).startswith(str(file))
    assert str(caught.value).isprintable()
    assert not MARKER.exists()


def test_what_unpacks_to_too_much_is_refused(
    tmp_path: Path, published: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = published().write(tmp_path / "demo.pkl.gz")
    monkeypatch.setattr("magical.demos.human.MAX_UNPACKED", 2_000_000)
    with pytest.raises(UnsafeFileError, match="unpacks to more than 2000000 bytes"):
        read_demonstration(file)


def test_a_damaged_file_costs_itself_alone(tmp_path: Path, published: Any, run: Run) -> None:
    raw = gzip.compress(published(steps=1).pickle, 1)
    (tmp_path / "in").mkdir()
    for i, content in enumerate((raw[:9], raw[: len(raw) // 2], b"x" + raw, raw)):
        (tmp_path / "in" / f"{i}.pkl.gz").write_bytes(content)
    status, result = run("import", tmp_path / "in", "--out", tmp_path / "out", "--workers", 1)
    assert (status, result["imported"], len(result["failed"])) == (1, ["3.pkl.gz"], 3)
    for file, reason in result["failed"]:
        assert reason.startswith(file)


@pytest.fixture
def serve() -> Iterator[Callable[[Path], str]]:
    """Serves a folder; gives its address."""
    servers = []

    def start(folder: Path) -> str:
        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *args: Any) -> None:
                super().__init__(*args, directory=str(folder))

            def log_message(self, *args: Any) -> None:
                pass

        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        servers.append((server, thread))
        return f"http://127.0.0.1:{server.server_port}"

    yield start
    for server, thread in servers:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_download_is_verified_imported_and_cleaned_up(
    tmp_path: Path, human_archive: Path, serve: Callable[[Path], str], run: Run
) -> None:
    pytest.importorskip("pooch")
    out, url = tmp_path / "d", serve(human_archive)
    command = ("download", "--out", out, "--base-url", url, "--workers", 1, "--files")
    status, result = run(*command, "move-to-region/*00[0-1]*")
    assert (status, len(result["imported"]), result["not_fetched"]) == (0, 2, [])
    assert [file.name for file in sorted(out.iterdir())] == ["000000.npz", "000001.npz"]
    status, result = run(*command, "move-to-region/*00[1-2]*")
    assert (status, len(result["imported"])) == (0, 1)
    assert main(["demos", *map(str, command), "nothing/*"]) == 1


def test_files_that_cannot_be_fetched_are_named(
    tmp_path: Path, serve: Callable[[Path], str], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pooch")
    (tmp_path / "served").mkdir()
    for file, content in (("good", b"content"), ("other", b"another")):
        (tmp_path / "served" / file).write_bytes(content)
    url, digest = serve(tmp_path / "served"), hashlib.sha256(b"content").hexdigest()
    wanted = dict.fromkeys(("good", "other", "missing"), digest)
    found, errors = download(wanted, tmp_path / "d", url, lambda _: None)
    assert found == [tmp_path / "d" / "good"]
    assert [error.partition(":")[0] for error in errors] == ["http", "http"]
    assert "/other: " in errors[0]
    assert "404" in errors[1]
    with pytest.raises(DownloadError, match="run again"):
        download(wanted, tmp_path / "none", "http://127.0.0.1:9", lambda _: None)
