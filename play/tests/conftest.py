"""A server on loopback, and a browser."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from magical.demos import DatasetWriter
from magical.demos.generate import demonstrate
from magical_play import session
from play.tests.browser import Browser, find_browser, start_browser
from play.tests.serving import RunningServer, running


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Where the server records."""
    return tmp_path / "demos"


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let an episode take a moment."""
    monkeypatch.setattr(session, "STEP_TIME", 0.004)
    monkeypatch.setattr(session, "POLL_TIME", 0.001)


@pytest.fixture
def server(dataset: Path) -> Iterator[RunningServer]:
    with running(dataset) as started:
        yield started


@pytest.fixture(scope="session")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two perturbed demonstrations, of seeds 1 and 2."""
    folder = tmp_path_factory.mktemp("datasets") / "demos"
    writer = DatasetWriter(folder)
    for seed in (1, 2):
        writer.append(demonstrate("magical/MoveToRegion-Demo-v0", seed, perturb=0.2))
    return folder


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Headless Chromium; without it, tests are skipped, or fail if REQUIRE_CHROMIUM is set."""
    program = find_browser()
    if program is None:
        missing = pytest.fail if os.environ.get("REQUIRE_CHROMIUM") else pytest.skip
        missing("no Chromium is installed")
    with start_browser(program, tmp_path_factory.mktemp("browser")) as started:
        yield started
