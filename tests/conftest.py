"""Fixtures for every room's tests."""

from collections.abc import Generator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """The reference directory beside the repository; tests that need it are skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"the reference directory {SHARED} is missing")
    return SHARED


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where the reference directory exists, a test that asks for it must not be skipped."""
    report = yield
    needs_shared = "shared" in getattr(item, "fixturenames", ())
    if report.skipped and needs_shared and SHARED.is_dir() and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped although {SHARED} exists: {report.longrepr}"
    return report
