"""Fetching the published archive over HTTPS, file by file, verified and resumable.

The server is not trusted: redirects, sizes and transfer times are limited, and only files with the
published SHA-256 sums are returned.
"""

import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection, IncompleteRead
from io import BufferedReader, RawIOBase
from pathlib import Path
from socket import socket
from ssl import SSLError
from typing import IO, Any, NamedTuple

from magical.demos.human.published import file_sum
from magical.errors import DownloadError
from magical.files import open_regular
from magical.messages import printable, quoted

# The repository at the commit whose sums are in data/human-demos.sha256.
COMMIT = "42eb21c4bd6c0e2262ccc2fc00ef2a36b10b6a5a"
BASE_URL = f"https://raw.githubusercontent.com/qxcv/magical-data/{COMMIT}"
MAX_BYTES = 64 << 20  # per file; the largest is 2.5 MB
TIMEOUT = 30.0  # s: to connect, and for a response in addition to its transfer time
MIN_RATE = 5000.0  # bytes per second; slower attempts are abandoned
ATTEMPTS = 3
_CHUNK = 1 << 16
_ADDRESS = re.compile(
    r"https?://([A-Za-z0-9._-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(:\d{1,5})?(/[!-~]*)?"
)
# `http.client` raises ValueError for lines that are not HTTP.
_INTERRUPTIONS = (ConnectionError, TimeoutError, ValueError, HTTPException, SSLError)


class Download(NamedTuple):
    """Verified files by published path, and an error for each file that could not be fetched."""

    files: dict[str, Path]
    errors: list[str]


def fetch_all(
    sums: Mapping[str, str],
    folder: Path,
    base_url: str = BASE_URL,
    progress: Callable[[int], None] | None = None,
) -> Download:
    """Fetch every file in `sums` into `folder`, except those already there with the right sum.

    A partial file is resumed if the server supports it. Files get their final names only once
    their sums match.

    Args:
        sums: SHA-256 sums of the files, by path relative to `base_url` and `folder`.
        folder: where the files are stored.
        base_url: an http or https address.
        progress: called with 1 after every file.

    Raises:
        DownloadError: the server does not answer, or `base_url` is not a valid address.
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
    """Fetch one file in up to `ATTEMPTS` attempts, each of which resumes the previous one.

    Returns:
        The reason why it could not be fetched, or `None`.

    Raises:
        DownloadError: the server does not answer.
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
                raise DownloadError(
                    f"{url}: no answer: {problem}; files from elsewhere are read by `magical demos "
                    "import`"
                ) from error
        except DownloadError as error:
            return str(error)
        except _INTERRUPTIONS as error:
            problem = f"interrupted: {printable(f'{type(error).__name__}: {error}')}"
    return problem


def _resume(url: str, part: Path) -> None:
    """Append the rest of a file to its partial file, or fetch all of it.

    Raises:
        DownloadError: the file is larger than `MAX_BYTES`, or the address it is redirected to is
            not allowed.
        TimeoutError: the transfer is slower than `MIN_RATE`.
        ValueError, OSError, HTTPException: the server does not answer, or its response is invalid
            or incomplete.
    """
    have = part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
    received = 0
    with _OPENER.open(request, timeout=TIMEOUT) as response:
        resumed = response.status == 206
        room = MAX_BYTES - (have if resumed else 0)
        with open_regular(part, "ab" if resumed else "wb") as file:
            while received + (response.length or 0) <= room and (chunk := response.read1(_CHUNK)):
                file.write(chunk)
                received += len(chunk)
        if received + (response.length or 0) > room:
            part.unlink()  # so that another run can begin anew
            raise DownloadError(f"expected at most {MAX_BYTES} bytes, found more")
        if response.length:
            raise IncompleteRead(b"", response.length)


def _is_address(url: str) -> bool:
    """Whether this is an http or https address with a host and nothing that needs escaping."""
    try:
        return bool(_ADDRESS.fullmatch(url)) and urllib.parse.urlsplit(url).port != 0
    except ValueError:
        return False


class _Timed(RawIOBase):
    """A server's response, which must arrive within `TIMEOUT` plus its transfer time at `MIN_RATE`.

    A socket's own timeout restarts with every byte.
    """

    def __init__(self, connected: socket, data: RawIOBase) -> None:
        self._socket, self._data = connected, data
        self._deadline = time.monotonic() + TIMEOUT

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        left = self._deadline - time.monotonic()
        if left > 0:
            self._socket.settimeout(left)
            with suppress(TimeoutError):
                count: int | None = self._data.readinto(buffer)
                self._deadline += (count or 0) / MIN_RATE
                return count
        raise TimeoutError(f"less than {MIN_RATE:.0f} bytes per second")

    def close(self) -> None:
        self._data.close()
        super().close()


class _Response(HTTPResponse):
    def __init__(self, sock: socket, *args: Any, **options: Any) -> None:
        super().__init__(sock, *args, **options)
        self.fp = BufferedReader(_Timed(sock, self.fp.detach()))


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
    """Follows a limited number of redirects, and none that leave HTTPS."""

    def redirect_request(
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: Any,
        newurl: str,
    ) -> urllib.request.Request | None:
        """The request to follow; raises `DownloadError` if the new address is not allowed."""
        fp.close()  # the standard handler reads the body without a bound
        if not newurl.startswith(("https://", f"{req.type}://")) or not _is_address(newurl):
            raise DownloadError(f"expected a redirect to https://, found {quoted(newurl)}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


_OPENER = urllib.request.build_opener(_Handler, _Redirects)
