"""Downloading the published archive, from a local server."""

import hashlib
import http.server
import io
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from email.message import Message
from pathlib import Path
from typing import Any
from urllib.request import Request

import pytest

from magical.cli import main
from magical.demos import Dataset
from magical.demos.human.download import _Redirects, fetch_all
from magical.demos.human.published import published_sums
from magical.errors import DownloadError
from tests.demos.conftest import Run

Reply = Callable[[http.server.BaseHTTPRequestHandler], None]


@pytest.fixture
def serve() -> Iterator[Callable[[Reply], str]]:
    """Starts a server with one reply to everything; returns its address."""
    with ExitStack() as servers:

        def start(reply: Reply) -> str:
            class Mine(http.server.BaseHTTPRequestHandler):
                def do_GET(self) -> None:
                    with suppress(ConnectionError):
                        reply(self)

                def log_message(self, *args: Any) -> None:
                    pass

            server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Mine)
            thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
            thread.start()
            for stop in (server.server_close, thread.join, server.shutdown):  # the last first
                servers.callback(stop)
            return f"http://127.0.0.1:{server.server_port}"

        yield start


@dataclass
class Archive:
    """The archive on a local server, which supports ranges and can cut a response off."""

    folder: Path
    url: str = ""
    ranges: bool = True
    cut_after: int | None = None  # bytes after which the next response ends
    requested: list[str | None] = field(default_factory=list)  # ranges

    def __call__(self, handler: http.server.BaseHTTPRequestHandler) -> None:
        wanted, file = handler.headers.get("Range"), self.folder / handler.path[1:]
        self.requested.append(wanted)
        if not file.is_file():
            handler.send_error(404)
            return
        rest = file.read_bytes()
        if wanted and self.ranges:
            rest = rest[int(wanted.removeprefix("bytes=").rstrip("-")) :]
        if not rest:
            handler.send_error(416)
            return
        handler.send_response(206 if len(rest) < file.stat().st_size else 200)
        handler.send_header("Content-Length", str(len(rest)))
        handler.end_headers()
        handler.wfile.write(rest[: self.cut_after])
        self.cut_after = None


@pytest.fixture
def served(human_archive: Path, serve: Callable[[Reply], str]) -> Archive:
    archive = Archive(human_archive)
    archive.url = serve(archive)
    return archive


FIRST = "move-to-region/demo-MoveToRegion-Demo-v0-00[0-4].pkl.gz"
ONE = "move-to-region/demo-MoveToRegion-Demo-v0-001.pkl.gz"
ONE_SUM = {ONE: published_sums()[ONE]}
SUMS = {"file": hashlib.sha256(b"content").hexdigest()}


def test_download_verifies_imports_and_cleans_up(tmp_path: Path, served: Archive, run: Run) -> None:
    where = ("--out", tmp_path / "d", "--base-url", served.url, "--files", FIRST)
    command = ("download", *where, "--frames-only")
    status, result = run(*command)
    assert (status, len(result["imported"]), result["not_fetched"]) == (0, 5, [])
    assert len(Dataset.open(tmp_path / "d")) == 5
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == [
        ".lock",
        "manifest.jsonl",
        "trajectories",
    ]
    requested = len(served.requested)
    status, result = run(*command)
    assert (status, result["imported"], len(served.requested)) == (0, [], requested)


def test_file_missing_on_the_server_is_named(
    tmp_path: Path, served: Archive, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["demos", "download", "--out", str(tmp_path / "d"), "--base-url", served.url]
    status = main([*command, "--files", "move-to-region/*00[4-6]*", "--frames-only"])
    assert status == 1
    shown = capsys.readouterr()
    assert "Demo-v0-005.pkl.gz: could not be fetched: the server answered 404" in shown.err
    assert "imported 1 demonstrations" in shown.out
    assert main([*command, "--files", "nothing/*"]) == 1


@pytest.mark.parametrize("ranges", [True, False])
def test_interrupted_download_is_resumed(
    tmp_path: Path, human_archive: Path, served: Archive, ranges: bool
) -> None:
    served.cut_after, served.ranges = 100_000, ranges
    assert fetch_all(ONE_SUM, tmp_path, served.url).errors == []
    assert (tmp_path / ONE).read_bytes() == (human_archive / ONE).read_bytes()
    assert served.requested == [None, "bytes=100000-"]


def test_partial_file_of_an_earlier_run_is_resumed(
    tmp_path: Path, human_archive: Path, served: Archive
) -> None:
    part = tmp_path / f"{ONE}.part"
    part.parent.mkdir(parents=True)
    part.write_bytes((human_archive / ONE).read_bytes()[:5000])
    assert fetch_all(ONE_SUM, tmp_path, served.url).errors == []
    assert served.requested == ["bytes=5000-"]
    part.write_bytes(b"x" * 10_000_000)  # longer than the file, and wrong
    (tmp_path / ONE).write_bytes(b"damaged")
    assert fetch_all(ONE_SUM, tmp_path, served.url).errors == []
    assert not part.exists()


def test_no_server(tmp_path: Path) -> None:
    with pytest.raises(DownloadError, match=r"no answer: .*`magical demos import`"):
        fetch_all(SUMS, tmp_path, "http://127.0.0.1:9")


def response(body: bytes, status: int = 200, reason: str | None = None, **headers: str) -> Reply:
    def reply(handler: http.server.BaseHTTPRequestHandler) -> None:
        handler.send_response(status, reason)
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(body)

    return reply


def only_error(folder: Path, url: str) -> str:
    download = fetch_all(SUMS, folder, url)
    assert download.files == {}
    assert not [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".part"]
    (error,) = download.errors
    assert str(error).isprintable()
    assert len(str(error)) < 500
    return str(error)


def test_foreign_file_under_a_published_name_is_not_imported(
    tmp_path: Path,
    published: Any,
    serve: Callable[[Reply], str],
    monkeypatch: pytest.MonkeyPatch,
    run: Run,
) -> None:
    url = serve(response(b"", 404))
    kept = tmp_path / "kept" / ONE
    kept.parent.mkdir(parents=True)
    published().write(kept)
    command = ("download", "--out", tmp_path / "d", "--base-url", url, "--files", ONE)
    status, result = run(*command, "--keep", tmp_path / "kept", "--workers", 1)
    assert (status, result["imported"], len(result["not_fetched"])) == (1, [], 1)
    assert len(Dataset.open(tmp_path / "d")) == 0
    sums = {ONE: hashlib.sha256(kept.read_bytes()).hexdigest()}
    monkeypatch.setattr("magical.demos.human.published.published_sums", lambda: sums)
    status, result = run(*command, "--keep", tmp_path / "kept", "--workers", 1)
    assert (status, len(result["imported"])) == (0, 1)


@pytest.mark.parametrize("length", ["-5", "abc", "9" * 30, "1e3", "7, 8", "\x1b[2J", "999999999"])
def test_false_content_length_changes_nothing_or_is_named(
    tmp_path: Path, serve: Callable[[Reply], str], length: str
) -> None:
    download = fetch_all(SUMS, tmp_path, serve(response(b"content", Content_Length=length)))
    if download.errors:
        assert "expected at most" in download.errors[0]
        assert not (tmp_path / "file").exists()
    else:
        assert (tmp_path / "file").read_bytes() == b"content"


def test_a_file_that_was_too_large_is_fetched_anew(
    tmp_path: Path, serve: Callable[[Reply], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "served").mkdir()
    (tmp_path / "served" / "file").write_bytes(b"content")
    url, part = serve(Archive(tmp_path / "served")), tmp_path / "file.part"
    part.write_bytes(b"x" * 6)
    monkeypatch.setattr("magical.demos.human.download.MAX_BYTES", 6)
    assert "expected at most 6 bytes" in fetch_all(SUMS, tmp_path, url).errors[0]
    assert not part.exists()
    monkeypatch.undo()
    assert fetch_all(SUMS, tmp_path, url).errors == []


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        (response(b"", Content_Length="7"), "IncompleteRead"),
        (response(b"", 404, "\x1b[2J" + "x" * 1000), "the server answered 404 \\x1b[2Jxxx"),
        (response(b"another", Content_Length="7"), "expected SHA-256"),
    ],
)
def test_bad_answer_is_named(
    tmp_path: Path, serve: Callable[[Reply], str], reply: Reply, message: str
) -> None:
    assert message in only_error(tmp_path, serve(reply))


@pytest.mark.parametrize("part", ["headers", "body", "chunk"])
def test_slow_server_is_given_up(
    tmp_path: Path, serve: Callable[[Reply], str], monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    monkeypatch.setattr("magical.demos.human.download.TIMEOUT", 0.3)
    finished = threading.Event()

    def trickle(handler: http.server.BaseHTTPRequestHandler) -> None:
        lengths = {"body": b"Content-Length: 7000\r\n\r\n", "headers": b"X"}
        start = lengths.get(part, b"Transfer-Encoding: chunked\r\n\r\n")
        handler.wfile.write(b"HTTP/1.1 200 OK\r\n" + start)
        for _ in range(500):
            handler.wfile.write(b"0")
            if finished.wait(0.05):
                return

    assert "less than 5000 bytes per second" in only_error(tmp_path, serve(trickle))
    finished.set()


@pytest.mark.parametrize(
    "url",
    [
        "", "http://", "https:///path", "http://host:port/", "http://host:99999/", "http://host:0/",
        "http://host:/", "http://a b/", "http://host/a b", "http://ho\nst/", "http://\x1b[2J/",
        "http://h\u00f6st/", "http://host/\u00e4", "http://user:word@host/", "http://[::1",
        "http://host/?a", "http://host/#a", "ftp://host/", "file:///etc/", "host",
        "http://" + "a" * 999,
    ],
)  # fmt: skip
def test_invalid_address_is_named(tmp_path: Path, url: str) -> None:
    with pytest.raises(DownloadError, match="expected") as caught:
        fetch_all(SUMS, tmp_path, url)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "location",
    ["file:///etc/passwd", "ftp://host/", "gopher://x", "", "/file", "http://[", "http://"],
)
def test_unsafe_or_endless_redirect_is_refused(
    tmp_path: Path, serve: Callable[[Reply], str], location: str
) -> None:
    error = only_error(tmp_path, serve(response(b"", 302, Location=location)))
    assert re.search("redirect|Redirect|expected|Invalid", error)


def test_redirect_is_followed_but_does_not_leave_https(
    tmp_path: Path, serve: Callable[[Reply], str]
) -> None:
    target = serve(response(b"content", Content_Length="7"))
    download = fetch_all(SUMS, tmp_path, serve(response(b"", 302, Location=f"{target}/other")))
    assert download.errors == []
    assert (tmp_path / "file").read_bytes() == b"content"
    arguments = (io.BytesIO(), 302, "", Message())
    for url in ("https://a/b", "http://a/b"):
        made = _Redirects().redirect_request(Request(url), *arguments, "https://c/d")
        assert made is not None
        assert made.full_url == "https://c/d"
    with pytest.raises(DownloadError, match="expected a redirect to https://"):
        _Redirects().redirect_request(Request("https://a/b"), *arguments, "http://a/b")
