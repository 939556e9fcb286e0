import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from magical import plugins
from magical.errors import PluginError, UnknownNameError
from magical.plugins import Registry
from magical.tasks import Task

GROUP = "magical.things"
THINGS = Registry("thing", Task, GROUP, "magical.tasks", "TASK")


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    plugins.plugins.cache_clear()
    yield
    plugins.plugins.cache_clear()


def install(folder: Path, name: str, *lines: str) -> None:
    """Make a distribution with these entry points importable from a folder."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines]))


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_ours_and_those_of_other_distributions(path: Path) -> None:
    install(path, "other", "mine = magical.tasks.make_line:TASK")
    assert {"mine", "make-line"} <= set(THINGS.names())
    assert THINGS.get("mine") is THINGS.get("make-line")
    assert THINGS.get("magical.tasks.make_line:TASK").name == "MakeLine"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_module:TASK", "'broken' of other cannot be imported from no_such_module:TASK"),
        ("magical.tasks:NO", "cannot be imported from magical.tasks:NO"),
        ("magical.tasks:TASKS", "thing 'broken': expected Task, found mappingproxy"),
    ],
)
def test_a_broken_plugin_is_named_and_leaves_the_others(
    path: Path, value: str, message: str
) -> None:
    install(path, "other", f"broken = {value}", "good = magical.tasks.make_line:TASK")
    assert THINGS.get("good").name == "MakeLine"
    with pytest.raises(PluginError, match=message):
        THINGS.get("broken")


def test_two_distributions_with_one_name(path: Path) -> None:
    install(path, "one", "same = a:A")
    install(path, "two", "same = b:B")
    with pytest.raises(PluginError, match=r"two distributions offer 'same': [ab]:[AB] and [ab]:"):
        THINGS.names()


def test_an_unknown_name_lists_the_known_ones(path: Path) -> None:
    install(path, "other", "mine = a:A")
    with pytest.raises(UnknownNameError, match=r"thing 'your' is unknown.*mine.*module:NAME"):
        THINGS.get("your")


def test_a_file_finds_its_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "neighbour_of_plugin.py").write_text("from magical.tasks import get_task\n")
    file = tmp_path / "user_plugin.py"
    file.write_text('import neighbour_of_plugin\nT = neighbour_of_plugin.get_task("MakeLine")\n')
    monkeypatch.setattr("sys.path", [*sys.path])
    assert THINGS.get(f"{file}:T").name == "MakeLine"
