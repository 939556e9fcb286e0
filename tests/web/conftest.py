"""A server on loopback, where the libraries for it are installed."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from magical.envs import EnvId

if TYPE_CHECKING:
    from tests.web.serving import RunningServer

# What needs the web extra cannot even be imported without it.
INSTALLED = all(map(find_spec, ("starlette", "uvicorn", "websockets")))
collect_ignore = (
    [] if INSTALLED else ["test_browser.py", "test_command.py", "test_library.py", "test_server.py"]
)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Where the server records."""
    return tmp_path / "demos"


@pytest.fixture
def server(dataset: Path) -> Iterator["RunningServer"]:
    """A server for three players that starts them in MoveToRegion."""
    from magical.web.server import PlaySettings
    from tests.web.serving import running

    settings = PlaySettings(EnvId("MoveToRegion", "Demo"), record=dataset, max_players=3)
    with running(settings) as started:
        yield started
