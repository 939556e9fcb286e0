"""Fixtures for every room's tests."""

import os
import signal
import sys
import threading
from collections.abc import Generator
from importlib.util import find_spec
from pathlib import Path

import pytest

# Tests run side by side, and so do the programs that they start: PyTorch's threads, which wait for
# each other, would only stand in the way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent
SHARED = ROOT.parent / "shared"
# What the source distribution has not, and what needs the companions, which may not be installed.
collect_ignore = [] if (ROOT / "studies").is_dir() else ["tests/studies", "tests/test_docs.py"]
if find_spec("magical_baselines") is None or find_spec("magical_goals") is None:
    collect_ignore += ["baselines", "goals", "tests/studies", "tests/tools", "tests/test_docs.py"]
    collect_ignore += ["tests/test_examples.py"]
if find_spec("magical_play") is None:
    collect_ignore += ["play"]
# Human demonstrations, which cannot be part of the repository: the folder of each fixture below.
# Tests that ask for a fixture are skipped where its folder is missing.
OUTSIDE = {
    "human_archive": SHARED / "human-demos",
    "human_trajectories": SHARED / "human-trajectories",
}


def pytest_configure() -> None:
    """Let programs that tests start receive SIGINT and SIGHUP.

    A test run in the background, or under nohup, ignores them, and programs inherit that. They do
    not inherit handlers.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def human_archive() -> Path:
    """Human demonstrations as published: gzipped pickles, a folder for each task."""
    return _outside("human_archive")


@pytest.fixture(scope="session")
def human_trajectories() -> Path:
    """A dataset of the human demonstrations: 96 x 96 frames and actions."""
    return _outside("human_trajectories")


def _outside(fixture: str) -> Path:
    folder = OUTSIDE[fixture]
    if not folder.is_dir():
        pytest.skip(f"needs the human demonstrations, not part of the repository: no {folder}")
    return folder


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests that are marked for another system."""
    for mark, here in (("posix", os.name == "posix"), ("linux", sys.platform == "linux")):
        if item.get_closest_marker(mark) and not here:
            pytest.skip(f"marked {mark}: needs what this system has not (pyproject.toml)")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where the folders of `OUTSIDE` that a test asks for exist, a skip is a failure."""
    report = yield
    needed = [OUTSIDE[name] for name in getattr(item, "fixturenames", ()) if name in OUTSIDE]
    present = bool(needed) and all(folder.is_dir() for folder in needed)
    if report.skipped and present and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        names = ", ".join(map(str, needed))
        report.longrepr = f"skipped although {names} exists: {report.longrepr}"
    return report
