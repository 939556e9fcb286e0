"""Fetching the published archive over HTTPS, file by file, verified and resumable.

The server is not trusted: redirects, sizes and the rate of transfer are bounded, and only files
with the published SHA-256 sums are returned.
"""

import re
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http.client import (
    HTTPConnection,
    HTTPException,
    HTTPResponse,
    HTTPSConnection,
    IncompleteRead,
)
from pathlib import Path
from socket import SHUT_RDWR, socket
from ssl import SSLError
from typing import IO, Any, NamedTuple

from magical.demos.human.published import file_sum
from magical.errors import DownloadError
from magical.files import open_regular
from magical.messages import printable, quoted

# The repository at the commit whose sums are in data/human-demos.sha256.
COMMIT = "42eb21c4bd6c0e2262ccc2fc00ef2a36b10b6a5a"
BASE_URL = f"https://raw.githubusercontent.com/qxcv/magical-data/{COMMIT}"
MAX_BYTES = 64 << 20  # of one file; the largest has 2.5 MB
TIMEOUT = 30.0  # s, to connect, for the headers, and for a body beyond its transfer time
MIN_RATE = 5000.0  # bytes per second, below which an attempt is given up
ATTEMPTS = 3
_TOO_SLOW = f"less than {MIN_RATE:.0f} bytes per second"
_CHUNK = 1 << 16
_ADDRESS = re.compile(
    r"https?://([A-Za-z0-9._-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(:\d{1,5})?(/[!-~]*)?"
)
# `http.client` raises ValueError for lines that are not HTTP.
_INTERRUPTIONS = (ConnectionError, TimeoutError, ValueError, HTTPException, SSLError)


class Download(NamedTuple):
    """Verified files by their published paths, and an error for every file not fetched."""

    files: dict[str, Path]
    errors: list[str]


def fetch_all(
    sums: Mapping[str, str],
    folder: Path,
    base_url: str = BASE_URL,
    progress: Callable[[int], None] | None = None,
) -> Download:
    """Fetch every file of `sums` (path: SHA-256) into `folder`; verified ones there are kept.

    A partial file is resumed where the server supports it. Files get their final names only when
    their sums are right.

    Args:
        sums: SHA-256 sums of the files by their paths below `base_url` and `folder`.
        folder: where they are kept.
        base_url: an http or https address.
        progress: called with 1 after every file.

    Raises:
        DownloadError: no server answers, or `base_url` is not a valid address.
        OSError: the folder cannot be written.
    """
    if not _is_address(base_url) or set(base_url) & set("?#"):
        raise DownloadError(
            "base URL: expected http:// or https://, a host and perhaps a port and a path, "
            f"found {quoted(base_url)}"
        )
    download = Download({}, [])
    for name, digest in sums.items():
        target = folder / name
        url = f"{base_url.rstrip('/')}/{urllib.parse.quote(name)}"
        problem = None if file_sum(target) == digest else _fetch(url, target, digest)
        if problem is None:
            download.files[name] = target
        else:
            download.errors.append(f"{url}: could not be fetched: {problem}; run again to resume")
        if progress:
            progress(1)
    return download


def _fetch(url: str, target: Path, digest: str) -> str | None:
    """Fetch one file in several attempts, each of which resumes the one before.

    Returns:
        Why it could not be fetched, or `None`.

    Raises:
        DownloadError: no server answers.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    problem = ""
    for attempt in range(1, ATTEMPTS + 1):
        try:
            _resume(url, part)
            found = file_sum(part)
            if found == digest:
                part.replace(target)
                return None
            part.unlink()
            problem = f"expected SHA-256 {digest[:12]}..., found {found[:12]}..."
        except urllib.error.HTTPError as error:
            error.close()
            problem = f"the server answered {error.code} {printable(str(error.reason))}"
            if error.code == 416:  # the partial file is longer than the file: start over
                part.unlink(missing_ok=True)
            elif error.code < 500:
                return problem
        except urllib.error.URLError as error:
            problem = printable(str(error.reason))
            if attempt == ATTEMPTS:
                raise DownloadError(f"{url}: no answer: {problem}") from error
        except DownloadError as error:
            return str(error)
        except _INTERRUPTIONS as error:
            problem = f"interrupted: {printable(f'{type(error).__name__}: {error}')}"
    return problem


def _resume(url: str, part: Path) -> None:
    """Append the rest of a file to its partial file, or fetch all of it.

    Raises:
        DownloadError: it is larger than `MAX_BYTES`, or is redirected to another scheme.
        TimeoutError: it comes slower than `MIN_RATE`.
        ValueError, OSError: the server does not answer, or not as a server should.
    """
    have = part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
    start, received = time.monotonic(), 0
    with _OPENER.open(request, timeout=TIMEOUT) as response:
        resumed = response.status == 206
        room = MAX_BYTES - (have if resumed else 0)
        with open_regular(part, "ab" if resumed else "wb") as file:
            while received + (response.length or 0) <= room and (chunk := response.read1(_CHUNK)):
                file.write(chunk)
                received += len(chunk)
                if time.monotonic() > start + TIMEOUT + received / MIN_RATE:
                    raise TimeoutError(_TOO_SLOW)
        if received + (response.length or 0) > room:
            raise DownloadError(f"expected at most {MAX_BYTES} bytes, found more")
        if response.length:
            raise IncompleteRead(b"", response.length)


def _is_address(url: str) -> bool:
    """Whether this is an http or https address with a host and nothing to be escaped."""
    try:
        return bool(_ADDRESS.fullmatch(url)) and urllib.parse.urlsplit(url).port != 0
    except ValueError:
        return False


class _Response(HTTPResponse):
    """A response whose headers and parts must each come within `TIMEOUT`, or it is shut down.

    The timeout of a socket starts again with every byte.
    """

    def __init__(self, sock: socket, *args: Any, **options: Any) -> None:
        super().__init__(sock, *args, **options)
        self._socket = sock

    def begin(self) -> None:
        """Read the status line and the headers."""
        with self._deadline():
            super().begin()

    def read1(self, n: int = -1) -> bytes:
        """Read what has arrived, at most `n` bytes."""
        with self._deadline():
            return super().read1(n)

    @contextmanager
    def _deadline(self) -> Iterator[None]:
        expired = threading.Event()

        def shut_down() -> None:
            expired.set()
            with suppress(OSError):
                self._socket.shutdown(SHUT_RDWR)

        timer = threading.Timer(TIMEOUT, shut_down)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            if expired.is_set():
                raise TimeoutError(_TOO_SLOW)


class _Connection(HTTPConnection):
    response_class = _Response


class _SecureConnection(HTTPSConnection):
    response_class = _Response


class _Handler(urllib.request.HTTPSHandler, urllib.request.HTTPHandler):
    def http_open(self, req: urllib.request.Request) -> HTTPResponse:
        return self.do_open(_Connection, req)

    def https_open(self, req: urllib.request.Request) -> HTTPResponse:
        return self.do_open(_SecureConnection, req)


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects, a few, that do not leave HTTPS."""

    def redirect_request(
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: Any,
        newurl: str,
    ) -> urllib.request.Request | None:
        """The request to follow; raises `DownloadError`."""
        fp.close()  # the standard handler reads the body without a bound
        if not newurl.startswith(("https://", f"{req.type}://")) or not _is_address(newurl):
            raise DownloadError(f"expected a redirect to https://, found {quoted(newurl)}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


_OPENER = urllib.request.build_opener(_Handler, _Redirects)
