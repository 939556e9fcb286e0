"""What other distributions offer, by entry points and by `module:NAME`."""

import json
import os
import re
import shutil
import subprocess
import sys
from argparse import ArgumentTypeError
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from magical import plugins
from magical.cli import main
from magical.commands._common import task_name
from magical.envs import parse_env_id
from magical.envs.vector import MagicalVectorEnv
from magical.errors import MissingDependencyError, PluginError, UnknownNameError
from magical.evaluation.policy import GROUP as POLICIES
from magical.evaluation.policy import load_policy
from magical.observe import make_spec
from magical.plugins import Registry
from magical.runs import versions
from magical.tasks import TASKS, Task, get_task, load_task, unregister_task
from magical.tasks.registry import defining_modules

GROUP = "magical.things"
THINGS = Registry("thing", Task, GROUP)


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    for found in (plugins.plugins, plugins.distributions):
        found.cache_clear()
    yield
    for found in (plugins.plugins, plugins.distributions):
        found.cache_clear()


def install(folder: Path, name: str, *lines: str, group: str = GROUP) -> None:
    """Make a distribution with these entry points importable from a folder."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]))


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_entry_points_and_references(path: Path) -> None:
    install(path, "other", "mine = magical.tasks.make_line:TASK")
    assert THINGS.names() == ["mine"]
    assert THINGS.get("mine") is get_task("MakeLine")
    assert THINGS.get("magical.tasks.make_line:TASK").name == "MakeLine"


def test_what_a_run_records_names_distributions_with_plugins(path: Path) -> None:
    install(path, "other", "mine = magical.tasks.make_line:TASK")
    install(path, "unrelated", "mine = json:loads", group="console_scripts")
    assert versions()["other"] == "1.0"
    assert "unrelated" not in versions()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_module:TASK", "'broken' of other cannot be imported from no_such_module:TASK"),
        ("magical.tasks:NO", "cannot be imported from magical.tasks:NO"),
        ("magical.tasks:TASKS", "thing 'broken': expected Task, found _Tasks"),
        ("raising_plugin:TASK", "'broken' of other cannot .* ZeroDivisionError: no licence"),
    ],
)
def test_a_broken_plugin_is_named_and_leaves_the_others(
    path: Path, value: str, message: str
) -> None:
    (path / "raising_plugin.py").write_text("raise ZeroDivisionError('no licence')")
    install(path, "other", f"broken = {value}", "good = magical.tasks.make_line:TASK")
    assert THINGS.get("good").name == "MakeLine"
    with pytest.raises(PluginError, match=message):
        THINGS.get("broken")


def test_a_loader_of_a_distribution_loads_policies(path: Path) -> None:
    install(path, "other", "lerobot = tool:Loaded", group=POLICIES)
    (path / "tool.py").write_text(
        "class Loaded:\n"
        "    def __init__(self, what): self.what = what\n"
        "    def act(self, observations, env_ids, rng): return [0] * len(env_ids)\n"
        "    def reset(self, mask): pass\n"
    )
    assert vars(load_policy("lerobot:runs/a:b")) == {"what": "runs/a:b"}


def test_a_loader_that_is_not_installed_is_named_with_the_command() -> None:
    command = "pip install ./integrations/lerobot_env_magical"
    with pytest.raises(MissingDependencyError, match=command):
        load_policy("lerobot:policy")


def test_two_distributions_with_one_name(path: Path) -> None:
    install(path, "one", "same = a:A")
    install(path, "two", "same = b:B", "mine = magical.tasks.make_line:TASK")
    with pytest.raises(PluginError, match="two distributions offer 'same': a:A and b:B; uninstall"):
        THINGS.get("same")
    assert THINGS.get("mine").name == "MakeLine"


def test_tasks_of_one_name_do_not_keep_the_package_from_being_imported(path: Path) -> None:
    install(path, "one", "Same = a:A", "MakeLine = a:A", group="magical.tasks")
    install(path, "two", "Same = b:B", group="magical.tasks")
    program = (
        "import gymnasium, magical\n"
        "print('magical/MakeLine-Demo-v0' in gymnasium.registry)\n"
        "gymnasium.make('magical/Same-Demo-v0')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "True\n"
    assert "magical.tasks: two distributions offer 'Same': a:A and b:B" in done.stderr


def test_an_unknown_name_lists_the_known_ones(path: Path) -> None:
    install(path, "other", "mine = a:A")
    with pytest.raises(UnknownNameError, match=r"thing 'your' is unknown.*mine.*module:NAME"):
        THINGS.get("your")


DRIVE_THERE = "magical/DriveThere-Demo-v0"
TASK = """
from dataclasses import replace
from magical.tasks import get_task
TASK = replace(get_task("MoveToRegion"), name="DriveThere", section="")
"""


def test_a_task_by_module_and_name(path: Path) -> None:
    (path / "driving_task.py").write_text(TASK)
    for env_id in ("magical/DriveThere-Demo-v0", "driving_task:TASK-Demo-v0"):
        with pytest.raises(UnknownNameError, match=r"task '.*' is not registered; expected"):
            parse_env_id(env_id)
    assert "driving_task" not in sys.modules  # ids may come from anywhere, and import nothing
    try:
        assert task_name("driving_task:TASK") == "DriveThere"
        assert get_task("DriveThere") is load_task("driving_task:TASK")
        assert parse_env_id("magical/DriveThere-Demo-v0").task == "DriveThere"
    finally:
        unregister_task("DriveThere")
    with pytest.raises(PluginError, match="expected a Task, found function"):
        load_task("driving_task:replace")
    with pytest.raises(ArgumentTypeError, match="no 'NO' in the module"):
        task_name("driving_task:NO")


@pytest.mark.parametrize("command", ["envs", "evaluate noop --rollouts 1 --workers 0 --out noop"])
def test_all_tasks_are_those_that_can_be_imported(path: Path, command: str) -> None:
    (path / "raising_task.py").write_text("raise ImportError('no licence,\\nno task')")
    (path / "driving_task.py").write_text(TASK)
    entries = ("Broken = raising_task:TASK", "DriveThere = driving_task:TASK")
    install(path, "other", *entries, group="magical.tasks")
    done = subprocess.run(
        [sys.executable, "-m", "magical", *command.split(), "--json"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path))},
        cwd=path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert {"MakeLine", "DriveThere"} <= set(re.findall(r"\w+", done.stdout))
    assert "Broken" not in done.stdout
    assert [line for line in done.stderr.splitlines() if "Broken" in line] == [
        "warning: magical.tasks: 'Broken' of other cannot be imported from raising_task:TASK: "
        "ImportError: no licence, no task"
    ]


def test_a_task_of_another_name_than_its_entry_points(path: Path) -> None:
    install(path, "other", "Misnamed = magical.tasks.make_line:TASK", group="magical.tasks")
    assert list(TASKS)[-1] == "Misnamed"
    with pytest.raises(PluginError, match="expected the task 'Misnamed', found 'MakeLine'"):
        get_task("Misnamed")


REGISTERING = """
from dataclasses import replace
from magical.tasks import get_task, register_task
for name in ("DriveThere", "DriveBack"):
    register_task(replace(get_task("MoveToRegion"), name=name, section=""))
"""


def test_tasks_that_an_imported_file_registers_are_found_by_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    Path("registering_tasks.py").write_text(f"{REGISTERING}del name\n")
    command = "evaluate noop --task DriveThere --variants Demo --rollouts 2 --workers 2"
    try:
        assert main(["--import", "registering_tasks.py", *command.split()]) == 0
        assert defining_modules([get_task("DriveBack")]) == ["registering_tasks"]
    finally:
        unregister_task("DriveThere")
        unregister_task("DriveBack")


def test_a_task_within_a_class_is_found_by_workers(path: Path) -> None:
    (path / "grouped_tasks.py").write_text(f"{TASK}\nclass Tasks:\n    drive = TASK\ndel TASK\n")
    install(path, "other", "DriveThere = grouped_tasks:Tasks.drive", group="magical.tasks")
    try:
        with closing(MagicalVectorEnv([DRIVE_THERE], workers=1, observation="state")) as envs:
            envs.reset(seed=0)
    finally:
        unregister_task("DriveThere")


def test_an_observation_that_is_none(path: Path) -> None:
    install(path, "other", "actions = magical.scene:NUM_ACTIONS", group="magical.observations")
    with pytest.raises(PluginError, match="'actions': expected an ObservationSpec, or a function"):
        make_spec("actions", get_task("MakeLine"))


def test_a_file_finds_its_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "neighbour_of_plugin.py").write_text("from magical.tasks import get_task\n")
    file = tmp_path / "user_plugin.py"
    file.write_text('import neighbour_of_plugin\nT = neighbour_of_plugin.get_task("MakeLine")\n')
    monkeypatch.setattr("sys.path", [*sys.path])
    assert THINGS.get(f"{file}:T").name == "MakeLine"


def test_a_file_that_was_corrected_can_be_named_in_other_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.path", [*sys.path])
    file = tmp_path / "corrected_plugin.py"
    file.write_text("raise ZeroDivisionError\n")
    with pytest.raises(ZeroDivisionError):
        plugins.load_reference(f"{file}:act")
    for written, result in enumerate(("1", "22")):
        file.write_text(f"def act(): return {result}\n")
        os.utime(file, (written, written))
        act = plugins.load_reference(f"{file}:act")
        assert sys.modules["corrected_plugin"].act is act
        assert act() == int(result)


PLAN = """
tasks = ["EmptyRegion"]
demos = "expert"
expert_demos = 3
num_demos = 3
preset = "quick"
threads = 1
rollouts = 1

[[methods]]
name = "Smooth BC"
algorithm = "smooth-bc"
settings = { batches = 3, network = "patches", observation = "TwoFrames" }
"""


@dataclass(frozen=True)
class Installed:
    """A folder in which `examples/plugin`, built and installed, is found by `magical`."""

    folder: Path

    def magical(self, command: str) -> str:
        """The standard output of a command."""
        return self.python("-m", "magical", *command.split())

    def python(self, *arguments: str) -> str:
        """The standard output of an interpreter."""
        given = filter(None, [os.environ.get("PYTHONPATH")])
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(self.folder / "site"), *given])},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(root / "examples" / "plugin", folder / "source")
    build = ("build", "--wheel", "--no-isolation", "--outdir", ".", "source")
    subprocess.run([sys.executable, "-m", *build], cwd=folder, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    pip = ("pip", "install", "--quiet", "--no-index", "--no-deps", "--target", "site", wheel.name)
    subprocess.run([sys.executable, "-m", *pip], cwd=folder, check=True)
    return Installed(folder)


LAZY = """
import sys, gymnasium, magical
from magical.errors import UnknownNameError
from magical.experts import has_expert, rollout
assert {"MoveToCorner", "EmptyRegion"} <= set(magical.TASKS) and has_expert("EmptyRegion")
assert "magical/EmptyRegion-TestAll-LoRes4E-v0" in gymnasium.registry
assert "magical_example" not in sys.modules
env = gymnasium.make("magical/EmptyRegion-Demo-v0")
assert "magical_example" in sys.modules
magical.register_task(env.unwrapped.task)  # again; as a module would that is imported by name
try:
    gymnasium.make("magical/EmptyRegion-TestLayout-v0")
except UnknownNameError as error:
    print(error)
assert rollout("EmptyRegion", seed=0).score == 1.0
"""


def test_entry_points_are_imported_when_they_are_needed(installed: Installed) -> None:
    printed = installed.python("-W", "error::UserWarning", "-c", LAZY)
    assert "EmptyRegion has no variant 'TestLayout'; it has: Demo," in printed


def test_tasks_experts_and_policies_of_a_distribution(installed: Installed) -> None:
    assert "EmptyRegion" in installed.magical("envs")
    for policy in ("circle", "expert"):
        command = f"evaluate {policy} --task EmptyRegion --rollouts 2 --out {policy} --json"
        scores = json.loads(installed.magical(command).splitlines()[-1])
        assert scores["All"]["mean"] == 1.0
        assert "confirmed: " in installed.magical(f"verify {policy}")


def test_an_algorithm_of_a_distribution_is_resumed_and_listed(installed: Installed) -> None:
    pytest.importorskip("magical_baselines")
    installed.magical("demos generate --env magical/EmptyRegion-Demo-v0 -n 3 --out demos")
    installed.magical(
        "train smooth-bc --preset quick --task EmptyRegion --demos demos --num-demos 3 --batches 4 "
        "--network patches --observation TwoFrames --out run --stop-after 2"
    )
    installed.magical("train smooth-bc --out run --resume")
    config = json.loads((installed.folder / "run" / "config.json").read_text())
    assert (config["algorithm"], config["smoothing"]) == ("smooth-bc", 0.1)
    # One process computes larger batches, in less than half the time.
    installed.magical(
        "evaluate run --leaderboard --method Smooth --test-evaluations 0 --workers 0 --out run"
    )
    board = installed.magical("leaderboard run").splitlines()
    (row,) = (line for line in board if "Smooth" in line)
    assert row.startswith("not ranked: fewer than 3 runs")


def test_an_algorithm_of_a_distribution_in_plans_and_reports(installed: Installed) -> None:
    pytest.importorskip("magical_baselines")
    (installed.folder / "plan.toml").write_text(PLAN)
    installed.magical("run plan.toml --out runs --workers 1")
    installed.magical("report runs --format markdown --out report.md")
    assert "Smooth BC" in (installed.folder / "report.md").read_text()
