"""A server on loopback, where the libraries for it are installed."""

import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from play.tests.browser import Browser, Tab
    from play.tests.serving import RunningServer

# What needs the web extra cannot even be imported without it.
INSTALLED = all(map(find_spec, ("starlette", "uvicorn", "websockets")))
collect_ignore_glob = [] if INSTALLED else ["test_*.py"]


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Where the server records."""
    return tmp_path / "demos"


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an episode take a moment."""
    from magical_play import session

    monkeypatch.setattr(session, "STEP_TIME", 0.004)
    monkeypatch.setattr(session, "POLL_TIME", 0.001)


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a step take twice as long, so that keys arrive in time on a busy machine."""
    from magical_play import session

    monkeypatch.setattr(session, "STEP_TIME", 0.25)


@pytest.fixture
def server(dataset: Path) -> Iterator["RunningServer"]:
    """A server for three players."""
    from play.tests.serving import running

    with running(record=dataset, max_players=3) as started:
        yield started


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Browser"]:
    """Headless Chromium; without it, tests are skipped, or fail if REQUIRE_CHROMIUM is set."""
    from play.tests.browser import find_browser, start_browser

    program = find_browser()
    if program is None:
        missing = pytest.fail if os.environ.get("REQUIRE_CHROMIUM") else pytest.skip
        missing("no Chromium is installed")
    with start_browser(program, tmp_path_factory.mktemp("browser")) as started:
        yield started


@pytest.fixture
def tab(server: "RunningServer", browser: "Browser") -> Iterator["Tab"]:
    """The page, ready to be played."""
    from play.tests.driving import open_page

    with browser.open_tab() as opened:
        opened.resize(1280, 800)
        open_page(opened, server)
        opened.wait_for("latest?.phase === 'ready'")
        yield opened
