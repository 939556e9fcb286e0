"""A server on loopback, a page in a browser, a dataset."""

import os

import pytest

from magical.demos import DatasetWriter
from magical.demos.generate import demonstrate
from play.tests.browser import find_browser, start_browser
from play.tests.serving import running


@pytest.fixture
def server(tmp_path):
    """A server that records into `demos` in the test's folder."""
    with running(tmp_path / "demos") as started:
        yield started


@pytest.fixture
def tab(tmp_path_factory):
    """Of headless Chromium; without it, tests are skipped, or fail if REQUIRE_CHROMIUM is set."""
    program = find_browser()
    if program is None:
        missing = pytest.fail if os.environ.get("REQUIRE_CHROMIUM") else pytest.skip
        missing("no Chromium is installed")
    with start_browser(program, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture(scope="session")
def demos(tmp_path_factory):
    """A dataset of two perturbed demonstrations, of seeds 1 and 2."""
    folder = tmp_path_factory.mktemp("datasets") / "demos"
    writer = DatasetWriter(folder)
    for seed in (1, 2):
        writer.append(demonstrate("magical/MoveToRegion-Demo-v0", seed, perturb=0.2))
    return folder
