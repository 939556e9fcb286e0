"""Fetching the published archive over HTTPS, file by file, verified and resumable.

The server is not trusted: addresses, redirects, headers and the rate of transfer are checked, and
only files with the published SHA-256 sums are returned.
"""

import http.client
import re
import socket
import ssl
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from email.message import Message
from pathlib import Path
from typing import IO, Any

from magical.errors import DownloadError
from magical.files import open_regular, sha256_sum
from magical.messages import printable, quoted

# The repository at the commit whose sums are in data/human-demos.sha256.
COMMIT = "42eb21c4bd6c0e2262ccc2fc00ef2a36b10b6a5a"
BASE_URL = f"https://raw.githubusercontent.com/qxcv/magical-data/{COMMIT}"
MAX_BYTES = 64 << 20  # of one file; the largest has 2.5 MB
TIMEOUT = 30.0  # s, to connect, for the next bytes, and for a response beyond its transfer time
MIN_RATE = 5000.0  # bytes per second, below which an attempt is given up
ATTEMPTS = 3
MAX_REDIRECTS = 5
_CHUNK = 1 << 16
_REDIRECTS = frozenset({301, 302, 303, 307, 308})
_HOST = re.compile(r"[A-Za-z0-9._-]{1,253}|[0-9A-Fa-f:.]{2,45}")
_INTERRUPTIONS = (
    ConnectionError,
    TimeoutError,
    ValueError,  # of http.client, for lines that are not HTTP
    http.client.HTTPException,
    ssl.SSLError,
)
_CONTENT_RANGE = re.compile(r"bytes (\d{1,12})-\d{1,12}/(?:\d{1,12}|\*)")


@dataclass(frozen=True, slots=True)
class Download:
    """Verified files by their published paths, and an error for every file not fetched."""

    files: dict[str, Path]
    errors: list[DownloadError]


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
    base_url = _checked_base(base_url)
    files: dict[str, Path] = {}
    errors = []
    for name, digest in sums.items():
        target = folder / name
        try:
            if _sum(target) != digest:
                _fetch(f"{base_url}/{urllib.parse.quote(name)}", target, digest)
            files[name] = target
        except _UnreachableError:
            raise
        except DownloadError as error:
            errors.append(error)
        if progress:
            progress(1)
    return Download(files, errors)


def _fetch(url: str, target: Path, digest: str) -> None:
    """Fetch one file in several attempts, each of which resumes the one before."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    for attempt in range(1, ATTEMPTS + 1):
        try:
            _resume(url, part)
            found = _sum(part)
            if found == digest:
                part.replace(target)
                return
            part.unlink()
            problem = f"expected SHA-256 {digest[:12]}..., found {found[:12]}..."
        except urllib.error.HTTPError as error:
            problem = f"the server answered {error.code} {printable(str(error.reason))}"
            error.close()
            if error.code == 416:  # the partial file is longer than the file: start over
                part.unlink(missing_ok=True)
            elif error.code < 500:
                break
        except urllib.error.URLError as error:
            problem = printable(str(error.reason))
            if attempt == ATTEMPTS:
                raise _UnreachableError(f"{url}: no answer: {problem}") from error
        except _INTERRUPTIONS as error:
            problem = f"interrupted: {printable(f'{type(error).__name__}: {error}')}"
    raise DownloadError(f"{url}: could not be fetched: {problem}; run again to resume")


def _resume(url: str, part: Path) -> None:
    """Append the rest of a file to its partial file, or fetch all of it."""
    have = part.stat().st_size if part.exists() else 0
    with _open(url, have) as response:
        resumed = response.status == http.client.PARTIAL_CONTENT
        expected = _content_length(url, response.headers)
        if resumed and not _starts_at(response.headers, have):
            part.unlink()
            raise http.client.HTTPException("another range than requested")
        if (have if resumed else 0) + (expected or 0) > MAX_BYTES:
            raise DownloadError(f"{url}: expected at most {MAX_BYTES} bytes, found more")
        with open_regular(part, "ab" if resumed else "wb") as file:
            _copy(response, file, expected)


def _open(url: str, have: int) -> "_Response":
    """Request the bytes of a file from `have` on, following redirects that do not leave HTTPS."""
    headers = {"Range": f"bytes={have}-"} if have else {}
    for _ in range(MAX_REDIRECTS + 1):
        try:
            response = _OPENER.open(urllib.request.Request(url, headers=headers), timeout=TIMEOUT)
        except urllib.error.HTTPError as error:
            if error.code not in _REDIRECTS:
                raise
            location = error.headers.get("Location", "")
            error.close()
            url = _checked_redirect(url, location)
        else:
            assert isinstance(response, _Response)
            return response
    raise DownloadError(f"{url}: expected at most {MAX_REDIRECTS} redirects, found more")


def _copy(response: "_Response", file: IO[bytes], expected: int | None) -> None:
    """Copy the response's body.

    Raises:
        IncompleteRead: it ends early.
        TimeoutError: it is slower than `MIN_RATE`.
    """
    received = 0
    try:
        while received < MAX_BYTES and (chunk := response.read1(_CHUNK)):
            file.write(chunk)
            received += len(chunk)
            response.received = received
    finally:  # a connection that was shut down ends or is reset
        response.check_rate()
    if received < (expected or 0):
        raise http.client.IncompleteRead(b"", (expected or 0) - received)


def _content_length(url: str, headers: Message) -> int | None:
    lengths = set(headers.get_all("Content-Length", []))
    if not lengths:
        return None
    (length, *others) = lengths
    if others or not re.fullmatch(r"[0-9]{1,12}", length):
        found = printable(" and ".join(sorted(lengths)))
        raise DownloadError(f"{url}: Content-Length: expected a number of bytes, found {found}")
    return int(length)


def _starts_at(headers: Message, start: int) -> bool:
    found = headers.get("Content-Range")
    if found is None:
        return True  # the sum will show it
    match = _CONTENT_RANGE.fullmatch(found)
    return match is not None and int(match[1]) == start


def _checked_base(url: str) -> str:
    if urllib.parse.urlsplit(_checked_url("base URL", url)).query or "#" in url:
        raise DownloadError(f"base URL: expected no query or fragment, found {quoted(url)}")
    return url.rstrip("/")


def _checked_redirect(url: str, location: str) -> str:
    # As urllib does: servers send addresses with characters that would have to be escaped.
    quoted_location = urllib.parse.quote(
        location, encoding="iso-8859-1", safe="/%:=&?~#+!$,;'@()*[]"
    )
    try:
        target = urllib.parse.urljoin(url, quoted_location)
    except ValueError:
        target = ""
    if not target.startswith(("https://", url[: url.index(":") + 3])):
        raise DownloadError(f"{url}: expected a redirect to https://, found {quoted(location)}")
    return _checked_url("redirect", target)


def _checked_url(what: str, url: str) -> str:
    """An http or https address with a host and nothing that would have to be escaped."""
    try:
        parts = urllib.parse.urlsplit(url)
        port_fits = parts.port is None or parts.port > 0
    except ValueError as error:
        raise DownloadError(f"{what}: expected an address, found {quoted(url)}") from error
    if parts.scheme not in ("http", "https"):
        raise DownloadError(f"{what}: expected http:// or https://, found {quoted(url)}")
    valid_host = _HOST.fullmatch(parts.hostname or "") and "@" not in parts.netloc
    if not valid_host or not port_fits or parts.netloc.endswith(":"):
        raise DownloadError(f"{what}: expected a host and perhaps a port, found {quoted(url)}")
    if not all("!" <= character <= "~" for character in url):
        raise DownloadError(
            f"{what}: expected no spaces or special characters, found {quoted(url)}"
        )
    return url


def _sum(path: Path) -> str:
    """The SHA-256 of a file; empty if there is none, or it is not a regular file."""
    try:
        with open_regular(path) as file:
            return sha256_sum(file)
    except OSError:
        return ""


class _Response(http.client.HTTPResponse):
    """A response with a deadline: `TIMEOUT` and the time for the bytes received at `MIN_RATE`.

    The timeout of a socket starts again with every byte, so a server could keep a response open
    for ever; a timer shuts the connection down instead.
    """

    def __init__(self, sock: socket.socket, *args: Any, **options: Any) -> None:
        super().__init__(sock, *args, **options)
        self.received = 0
        self._socket = sock
        self._start = 0.0
        self._finished = threading.Event()
        self._too_slow = False

    def begin(self) -> None:
        """Start the timer; read the status line and the headers."""
        self._start = time.monotonic()
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            super().begin()
        finally:
            self.check_rate()

    def close(self) -> None:
        """Close the response, and end its timer."""
        self._finished.set()
        super().close()

    def check_rate(self) -> None:
        """Raise `TimeoutError` if the connection was shut down."""
        if self._too_slow:
            raise TimeoutError(f"less than {MIN_RATE:.0f} bytes per second")

    def _remaining(self) -> float:
        return self._start + TIMEOUT + self.received / MIN_RATE - time.monotonic()

    def _watch(self) -> None:
        while (remaining := self._remaining()) > 0:
            if self._finished.wait(remaining):
                return
        self._too_slow = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)


class _Connection(http.client.HTTPConnection):
    response_class = _Response


class _SecureConnection(http.client.HTTPSConnection):
    response_class = _Response


class _Handler(urllib.request.HTTPHandler):
    def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_Connection, request)


class _SecureHandler(urllib.request.HTTPSHandler):
    def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_SecureConnection, request)


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Leaves redirects to `_open`: the standard handler reads their bodies without a bound."""

    def http_error_302(
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: http.client.HTTPMessage,
    ) -> None:
        """Decline, so that the response is raised as an `HTTPError`."""

    http_error_301 = http_error_302
    http_error_303 = http_error_302
    http_error_307 = http_error_302
    http_error_308 = http_error_302


_OPENER = urllib.request.build_opener(_Handler, _SecureHandler, _NoRedirects)


class _UnreachableError(DownloadError):
    """No server answers at all."""
