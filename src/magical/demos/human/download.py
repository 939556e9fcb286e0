"""Fetching the published archive over HTTPS, file by file, checked and resumable."""

import hashlib
import http.client
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

from magical.errors import DownloadError

# The repository at the commit whose sums are in data/human-demos.sha256.
COMMIT = "42eb21c4bd6c0e2262ccc2fc00ef2a36b10b6a5a"
BASE_URL = f"https://raw.githubusercontent.com/qxcv/magical-data/{COMMIT}"
MAX_BYTES = 64 << 20  # of one file; the largest has 2.5 MB
TIMEOUT = 30.0  # s without an answer
ATTEMPTS = 3
_CHUNK = 1 << 16


def fetch_all(
    sums: Mapping[str, str],
    folder: Path,
    base_url: str = BASE_URL,
    progress: Callable[[int], None] | None = None,
) -> list[DownloadError]:
    """Bring every file of `sums` (path: SHA-256) into `folder`; whole ones there are kept.

    A file that was begun is continued where the server allows it. Files appear under their names
    only when their sums are right.

    Returns:
        The files that could not be had, each as an error that names it.

    Raises:
        DownloadError: no server answers, or the address is no http(s) address.
        OSError: the folder cannot be written.
    """
    if urllib.parse.urlsplit(base_url).scheme not in ("http", "https"):
        raise DownloadError(f"base URL: expected http:// or https://, found {base_url!r}")
    failed = []
    for name, digest in sums.items():
        target = folder / name
        if not (target.is_file() and _sum(target) == digest):
            url = f"{base_url.rstrip('/')}/{urllib.parse.quote(name)}"
            try:
                _fetch(url, target, digest)
            except _UnreachableError:
                raise
            except DownloadError as error:
                failed.append(error)
        if progress:
            progress(1)
    return failed


def _fetch(url: str, target: Path, digest: str) -> None:
    """Fetch one file, in several attempts; each goes on where the one before broke off."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.part")
    for attempt in range(1, ATTEMPTS + 1):
        try:
            _continue(url, part)
            found = _sum(part)
            if found == digest:
                part.replace(target)
                return
            part.unlink()
            problem = f"expected SHA-256 {digest[:12]}..., found {found[:12]}..."
        except urllib.error.HTTPError as error:
            problem = f"the server says {error.code} {error.reason}"
            error.close()
            if error.code == 416:  # the part is longer than the file: begin anew
                part.unlink(missing_ok=True)
            elif error.code < 500:
                break
        except urllib.error.URLError as error:
            if attempt == ATTEMPTS:
                raise _UnreachableError(f"{url}: no answer: {error.reason}") from error
            problem = str(error.reason)
        except (http.client.HTTPException, ConnectionError, TimeoutError) as error:
            problem = f"broke off: {error!r}"
    raise DownloadError(f"{url}: could not be fetched: {problem}; run again to go on")


def _continue(url: str, part: Path) -> None:
    have = part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
    with urllib.request.urlopen(request, timeout=TIMEOUT) as answer:
        resumed = answer.status == http.client.PARTIAL_CONTENT
        with part.open("ab" if resumed else "wb") as file:
            expected = int(answer.headers.get("Content-Length") or 0)
            if (have if resumed else 0) + expected > MAX_BYTES:
                raise DownloadError(f"{url}: expected at most {MAX_BYTES} bytes, found more")
            _copy(answer, file, expected)


def _copy(answer: Any, file: IO[bytes], expected: int) -> None:
    """Copy the answer's body; raises `IncompleteRead` if it ends early."""
    received = 0
    while received < MAX_BYTES and (chunk := answer.read(_CHUNK)):
        file.write(chunk)
        received += len(chunk)
    if received < expected:
        raise http.client.IncompleteRead(b"", expected - received)


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _UnreachableError(DownloadError):
    """No server answers at all."""
