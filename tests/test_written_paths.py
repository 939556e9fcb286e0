"""Every command that writes takes a relative path, with spaces, into another folder."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from magical.cli import main
from magical.demos.generate import generate
from tests.demos.conftest import published, write

ENV = "magical/MoveToRegion-Demo-v0"
EVALUATED = "--task MoveToRegion --variants Demo --rollouts 1"
COMMANDS = {  # the command, what it needs, what it writes below --out
    "import": ("demos import {in}/published --workers 1", "", "000000.npz"),
    "generate": (f"demos generate --env {ENV} -n 1 --workers 1", "", "000000.npz"),
    "video": ("demos video {in}/demos", "av", ".mp4"),
    "minari": ("demos export {in}/demos --to minari", "minari", "magical"),
    "evaluate": (f"evaluate noop {EVALUATED}", "", "entry.json"),
    "report": ("report {in}/entry", "jinja2 matplotlib", ".html"),
    "leaderboard": ("leaderboard {in}/entry", "jinja2 matplotlib", "index.html"),
    "show": (f"show {ENV}", "", ".png"),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset, a published file and an entry, in a folder with a space in its name."""
    folder = tmp_path_factory.mktemp("other") / "the inputs"
    generate(ENV, 1, folder / "demos", workers=1)
    write(folder / "published" / "demo.pkl.gz", published())
    assert main(["evaluate", "noop", *EVALUATED.split(), "--out", str(folder / "entry")]) == 0
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_paths_are_the_callers(
    tmp_path: Path, inputs: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    words, needed, written = COMMANDS[command]
    if missing := [module for module in needed.split() if not find_spec(module)]:
        pytest.skip(f"needs {', '.join(missing)}, of an optional extra")
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    suffix = written if written.startswith(".") else ""
    relative = f"../{inputs.parent.name}/{inputs.name}"
    (tmp_path / inputs.parent.name).symlink_to(inputs.parent)
    arguments = [word.replace("{in}", relative) for word in words.split()]
    assert main([*arguments, "--out", f"../else where/the out{suffix}"]) == 0
    target = tmp_path / f"else where/the out{suffix}"
    assert target.is_file() if suffix else (target / written).exists()
    assert not list(here.iterdir())
    assert {path.name for path in tmp_path.iterdir()} == {"here", inputs.parent.name, "else where"}
