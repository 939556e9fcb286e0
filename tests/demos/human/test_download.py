"""Downloading the published archive, from a local server."""

import functools
import hashlib
import http.server
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from magical.cli import main
from magical.demos import Dataset
from magical.demos.human.download import fetch_all
from magical.demos.human.published import published_sums
from magical.errors import DownloadError

Run = Callable[..., tuple[int, dict[str, Any]]]


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serves a folder; understands ranges, and can break off or lie."""

    break_off: int = 0  # bytes after which the next answers end
    ranges = True
    asked: list[tuple[str, str | None]]

    def do_GET(self) -> None:
        asked = self.headers.get("Range")
        self.asked.append((self.path, asked))
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            self.send_error(404)
            return
        data = path.read_bytes()
        start = int(asked.removeprefix("bytes=").rstrip("-")) if asked and self.ranges else 0
        if start >= len(data):
            self.send_error(416)
            return
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(data) - start))
        self.end_headers()
        end = len(data)
        if type(self).break_off:
            end, type(self).break_off = start + type(self).break_off, 0
        self.wfile.write(data[start:end])

    def log_message(self, *args: Any) -> None:
        pass


@pytest.fixture
def served(human_archive: Path) -> Iterator[tuple[str, type[Handler]]]:
    """The archive on a local server: its address and its handler's class."""

    class Mine(Handler):
        asked: list[tuple[str, str | None]] = []  # noqa: RUF012

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Mine, directory=str(human_archive))
    )
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", Mine
    server.shutdown()
    thread.join()
    server.server_close()


FIRST = "move-to-region/demo-MoveToRegion-Demo-v0-00[0-4].pkl.gz"
ONE = "move-to-region/demo-MoveToRegion-Demo-v0-001.pkl.gz"


def test_download_checks_imports_and_tidies_up(
    tmp_path: Path, served: tuple[str, type[Handler]], run: Run
) -> None:
    url, handler = served
    command = ("download", "--out", tmp_path / "d", "--base-url", url, "--files", FIRST)
    status, result = run(*command)
    assert (status, len(result["imported"]), result["not_fetched"]) == (0, 5, [])
    assert len(Dataset.open(tmp_path / "d")) == 5
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == [
        ".lock",
        "manifest.jsonl",
        "trajectories",
    ]
    asked = len(handler.asked)
    status, result = run(*command)
    assert (status, result["imported"], len(handler.asked)) == (0, [], asked)


def test_what_the_server_lacks_is_named(
    tmp_path: Path,
    served: tuple[str, type[Handler]],
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = ["demos", "download", "--out", str(tmp_path / "d"), "--base-url", served[0]]
    status = main([*command, "--files", "move-to-region/*00[4-6]*"])
    assert status == 1
    shown = capsys.readouterr()
    assert "Demo-v0-005.pkl.gz: could not be fetched: the server answered 404" in shown.err
    assert "imported 1 demonstrations" in shown.out
    assert main([*command, "--files", "nothing/*"]) == 1


@pytest.mark.parametrize("ranges", [True, False])
def test_broken_off_download_goes_on(
    tmp_path: Path, human_archive: Path, served: tuple[str, type[Handler]], ranges: bool
) -> None:
    url, handler = served
    handler.break_off, handler.ranges = 100_000, ranges
    assert fetch_all({ONE: published_sums()[ONE]}, tmp_path, url).errors == []
    assert (tmp_path / ONE).read_bytes() == (human_archive / ONE).read_bytes()
    assert [asked for _, asked in handler.asked] == [None, "bytes=100000-"]


def test_part_of_an_earlier_run_is_continued(
    tmp_path: Path, human_archive: Path, served: tuple[str, type[Handler]]
) -> None:
    url, handler = served
    part = tmp_path / f"{ONE}.part"
    part.parent.mkdir(parents=True)
    part.write_bytes((human_archive / ONE).read_bytes()[:5000])
    assert fetch_all({ONE: published_sums()[ONE]}, tmp_path, url).errors == []
    assert [asked for _, asked in handler.asked] == ["bytes=5000-"]
    part.write_bytes(b"x" * 10_000_000)  # longer than the file, and wrong
    (tmp_path / ONE).write_bytes(b"damaged")
    assert fetch_all({ONE: published_sums()[ONE]}, tmp_path, url).errors == []
    assert not part.exists()


def test_wrong_bytes_are_never_kept(tmp_path: Path, served: tuple[str, type[Handler]]) -> None:
    (error,) = fetch_all({ONE: hashlib.sha256(b"other").hexdigest()}, tmp_path, served[0]).errors
    assert "expected SHA-256" in str(error)
    assert "MoveToRegion-Demo-v0-001" in str(error)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_no_server_and_no_http(tmp_path: Path) -> None:
    sums = {ONE: published_sums()[ONE]}
    with pytest.raises(DownloadError, match="no answer"):
        fetch_all(sums, tmp_path, "http://127.0.0.1:9")
    with pytest.raises(DownloadError, match="expected http"):
        fetch_all(sums, tmp_path, f"file://{tmp_path}")
