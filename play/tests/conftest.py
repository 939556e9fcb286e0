"""A server on loopback, a page in a browser, a dataset."""

import os
import threading

import pytest

from magical.demos import DatasetWriter
from magical.demos.generate import demonstrate
from magical_play.policies import Policies
from magical_play.security import make_guard
from magical_play.server import PlayServer, listen, make_server
from magical_play.session import Session
from play.tests.browser import find_browser, start_browser
from play.tests.serving import ENV, TOKEN, RunningServer


@pytest.fixture
def server(tmp_path):
    """On a free port of loopback, in MoveToRegion; it records into `demos` in the test's folder."""
    record = tmp_path / "demos"
    session = Session(ENV, Policies(), [record], DatasetWriter(record))
    with listen("127.0.0.1", 0) as listening:
        server = make_server(PlayServer(make_guard("127.0.0.1", TOKEN), session).app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield RunningServer(listening.getsockname()[1], session)
        finally:
            server.should_exit = True
            thread.join()


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
