"""The command line: discovery, exit statuses, output."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

import magical
from magical import cli
from magical.commands import envs
from magical.commands._common import print_table
from magical.errors import PlacementError, UnknownNameError
from magical.extras import EXTRAS

COMMANDS = cli.find_commands()  # their help, by name


@pytest.fixture
def fail_with(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], int]:
    """Run `magical envs` while that command raises the given exception."""

    def call(error: BaseException) -> int:
        def run(_: object) -> int:
            raise error

        monkeypatch.setattr(envs, "run", run)
        return cli.main(["envs"])

    return call


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert COMMANDS[name]
    assert cli.main([name, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: magical {name}")


@pytest.mark.parametrize(
    ("words", "name", "found"),
    [
        ("evaluate random --learned-from score --learned-from interaction", "learned_from", 2),
        ("demos generate --out demos --env A B --env C", "env", 3),
        ("leaderboard runs --rerun A --rerun B", "rerun", 2),
    ],
)
def test_an_option_of_several_values_may_be_repeated(words: str, name: str, found: int) -> None:
    values = getattr(cli.build_parser().parse_args(words.split()), name)
    assert len(values) == found


@pytest.mark.parametrize(
    "words",
    [
        "fly",
        "demos",
        "--import",
        "--impor json envs",
        "evaluate noop --roll 1",
        "evaluate noop --test-evaluations 0",
        "evaluate noop --rollouts 0",
        "report runs --format csv",
        "show magical/MoveToCorner-Demo-v0 --seed -1",
        "show magical/MoveToCorner-TestLayout-v0",
        "show magical/MoveToCorner-Demo-v0 --out no-folder/scene.jpg",
        "show magical/MoveToCorner-Demo-v0 --out .",
    ],
)
def test_wrong_usage_exits_2_with_one_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("error: ")
    if command := re.search(r"; see magical(.*) --help$", line):
        assert cli.main([*command[1].split(), "--help"]) == 0


def test_the_command_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    described = capsys.readouterr()
    assert cli.main([]) == 0
    assert capsys.readouterr() == described
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"magical {magical.__version__}\n"


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (UnknownNameError("no such task"), 2, "error: no such task\n"),
        (PlacementError("no room"), 1, "error: no room\n"),
        (FileNotFoundError(2, "No file", "x.png"), 1, "error: [Errno 2] No file: 'x.png'\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_errors_become_exit_statuses(
    fail_with: Callable[[BaseException], int],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    message: str,
) -> None:
    assert fail_with(error) == status
    assert capsys.readouterr().err == message


def test_a_terminated_command_ends_like_an_interrupted_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(envs, "run", lambda _: signal.raise_signal(signal.SIGTERM))
    assert cli.main(["envs"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_missing_library_is_answered_with_the_extra_that_brings_it(
    fail_with: Callable[[BaseException], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert fail_with(ModuleNotFoundError("no av", name="av.video")) == 1
    assert 'pip install "magical-benchmark[video]"' in capsys.readouterr().err
    for bug in (ModuleNotFoundError("no such thing", name="magical.nothing"), ZeroDivisionError()):
        with pytest.raises(type(bug)):
            fail_with(bug)


def test_the_libraries_of_every_extra_are_declared(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    for extra, libraries in EXTRAS.items():
        needs = " ".join(project["optional-dependencies"][extra])
        for library in set(libraries) - {"h5py"}:  # of minari[hdf5]
            assert library.replace("_", "-") in needs


def test_tables_are_aligned(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(("name", "score"), [("a", 0.5), ("long name", 10)])
    assert capsys.readouterr().out == (
        "name       score\n---------  -----\na          0.500\nlong name     10\n"
    )
    print_table(("name", "score"), [])
    assert capsys.readouterr().out == "name  score\n----  -----\n"


def test_a_reader_that_leaves_is_no_traceback() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "magical", "envs", "--json"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, b"")


def test_there_may_be_no_standard_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)  # as after `>&-`, and in a service
    assert cli.main(["envs"]) == 0


def test_a_module_that_cannot_be_imported_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("no_such_module", "no-module", "."):
        assert cli.main(["envs", "--import", name]) == 1
        assert f"{name!r} cannot be imported" in capsys.readouterr().err
    (tmp_path / "module_with_a_mistake.py").write_text("raise ValueError('in line 1')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match="in line 1"):
        cli.main(["envs", "--import", "module_with_a_mistake"])


def test_envs_lists_the_registry(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["envs", "--json"]) == 0
    *table, last = capsys.readouterr().out.splitlines()
    report = json.loads(last)
    assert report["ids"] == magical.all_env_ids(presets=True)
    assert report["tasks"]["MoveToCorner"]["horizon"] == 80
    rows = [line.split() for line in table]
    for name, task in report["tasks"].items():
        assert [name, str(task["horizon"]), *task["variants"]] in rows


def test_show_writes_both_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "new" / "scene.png"
    argv = ["show", "magical/FindDupe-TestAll-LoRes4E-v0", "--seed", "3"]
    assert cli.main([*argv, "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"wrote {out}\n"
    assert list(out.parent.iterdir()) == [out]
    with Image.open(out) as image:
        assert image.size == (768, 384)
        assert len(set(image.getdata())) > 50
    assert cli.main([*argv, "--json"]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["out"] == "magical-FindDupe-TestAll-LoRes4E-v0.png"
    assert Path(report["out"]).read_bytes() == out.read_bytes()


def test_names_of_any_bytes_can_be_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="utf-8"))
    cli.main(["--version"])
    print("\udcff", flush=True)
    assert written.getvalue().endswith(b"\\udcff\n")


def test_a_command_of_a_distribution_that_is_not_installed_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "plugins", lambda group: [])
    assert cli.main(["train", "bc", "--out", "run"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: magical train: this command is of magical-baselines, which is")
    assert "pip install ./baselines" in error
