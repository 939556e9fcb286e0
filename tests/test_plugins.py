"""What other distributions offer, by entry points and by `module:NAME`."""

import json
import os
import re
import shutil
import subprocess
import sys
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterator
from contextlib import closing
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
LINE = "magical.tasks.make_line:TASK"


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    for found in (plugins._entries, plugins._distributions):
        found.cache_clear()
    yield
    for found in (plugins._entries, plugins._distributions):
        found.cache_clear()


def install(folder: Path, name: str, *lines: str, group: str = GROUP) -> None:
    """Make a distribution with these entry points importable from a folder."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]))


def run_python(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run an interpreter that finds what this one does."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_entry_points_and_references(path: Path) -> None:
    install(path, "other", f"mine = {LINE}")
    install(path, "unrelated", "mine = json:loads", group="console_scripts")
    assert THINGS.names() == ["mine"]
    assert THINGS.get("mine") is THINGS.get(LINE) is get_task("MakeLine")
    with pytest.raises(UnknownNameError, match=r"thing 'your' is unknown.*mine.*module:NAME"):
        THINGS.get("your")
    assert versions()["other"] == "1.0"  # which runs record
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
    install(path, "other", f"broken = {value}", f"good = {LINE}")
    assert THINGS.get("good").name == "MakeLine"
    with pytest.raises(PluginError, match=message):
        THINGS.get("broken")


def test_policies_of_other_distributions(path: Path) -> None:
    with pytest.raises(MissingDependencyError, match="integrations/lerobot_env_magical"):
        load_policy("lerobot:policy")
    plugins._entries.cache_clear()
    plugins._distributions.cache_clear()
    install(path, "other", "lerobot = tool:Loaded", group=POLICIES)
    (path / "tool.py").write_text(
        "class Loaded:\n"
        "    def __init__(self, what): self.what = what\n"
        "    def act(self, observations, env_ids, rng): return [0] * len(env_ids)\n"
        "    def reset(self, mask): pass\n"
    )
    assert vars(load_policy("lerobot:runs/a:b")) == {"what": "runs/a:b"}


def test_two_distributions_with_one_name_do_not_keep_the_package_from_being_imported(
    path: Path,
) -> None:
    install(path, "one", "Same = a:A", "MakeLine = a:A", group="magical.tasks")
    install(path, "two", "Same = b:B", group="magical.tasks")
    program = (
        "import gymnasium, magical\n"
        "print('magical/MakeLine-Demo-v0' in gymnasium.registry)\n"
        "gymnasium.make('magical/Same-Demo-v0')\n"
    )
    done = run_python("-c", program, cwd=path)
    assert done.stdout == "True\n"
    assert "magical.tasks: two distributions offer 'Same': a:A and b:B" in done.stderr


TASK = """
from dataclasses import replace
from magical.tasks import get_task
TASK = replace(get_task("MoveToRegion"), name="DriveThere", section="")
"""


@pytest.fixture
def driving(path: Path) -> Iterator[Path]:
    (path / "driving_task.py").write_text(TASK)
    yield path
    for name in {"DriveThere", "DriveBack"} & set(TASKS):
        unregister_task(name)
    sys.modules.pop("driving_task", None)


def test_a_task_by_module_and_name(driving: Path) -> None:
    for env_id in ("magical/DriveThere-Demo-v0", "driving_task:TASK-Demo-v0"):
        with pytest.raises(UnknownNameError, match=r"task '.*' is not registered; expected"):
            parse_env_id(env_id)
    assert "driving_task" not in sys.modules  # ids may come from anywhere, and import nothing
    assert task_name("driving_task:TASK") == "DriveThere"
    assert get_task("DriveThere") is load_task("driving_task:TASK")
    assert parse_env_id("magical/DriveThere-Demo-v0").task == "DriveThere"
    with pytest.raises(PluginError, match="expected a Task, found function"):
        load_task("driving_task:replace")
    with pytest.raises(ArgumentTypeError, match="no 'NO' in the module"):
        task_name("driving_task:NO")


def test_all_tasks_are_those_that_can_be_imported(driving: Path) -> None:
    (driving / "raising_task.py").write_text("raise ImportError('no licence,\\nno task')")
    entries = ("Broken = raising_task:TASK", "DriveThere = driving_task:TASK")
    install(driving, "other", *entries, group="magical.tasks")
    done = run_python("-m", "magical", "envs", "--json", cwd=driving)
    assert done.returncode == 0, done.stderr
    assert {"MakeLine", "DriveThere"} <= set(re.findall(r"\w+", done.stdout))
    assert "Broken" not in done.stdout
    assert [line for line in done.stderr.splitlines() if "Broken" in line] == [
        "warning: magical.tasks: 'Broken' of other cannot be imported from raising_task:TASK: "
        "ImportError: no licence, no task"
    ]


def test_entry_points_that_are_something_else(path: Path) -> None:
    install(path, "other", f"Misnamed = {LINE}", group="magical.tasks")
    install(path, "third", "actions = magical.scene:NUM_ACTIONS", group="magical.observations")
    assert list(TASKS)[-1] == "Misnamed"
    with pytest.raises(PluginError, match="expected the task 'Misnamed', found 'MakeLine'"):
        get_task("Misnamed")
    with pytest.raises(PluginError, match="'actions': expected an ObservationSpec, or a function"):
        make_spec("actions", get_task("MakeLine"))


REGISTERING = """
from dataclasses import replace
from magical.tasks import get_task, register_task
for name in ("DriveThere", "DriveBack"):
    register_task(replace(get_task("MoveToRegion"), name=name, section=""))
del name
"""


def test_tasks_that_an_imported_file_registers_are_found_by_workers(
    driving: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(driving)
    Path("registering_tasks.py").write_text(REGISTERING)
    command = "evaluate noop --task DriveThere --variants Demo --rollouts 2 --workers 2"
    assert main(["--import", "registering_tasks.py", *command.split()]) == 0
    assert defining_modules([get_task("DriveBack")]) == ["registering_tasks"]


def test_a_task_within_a_class_is_found_by_workers(driving: Path) -> None:
    grouped = f"{TASK}\nclass Tasks:\n    drive = TASK\ndel TASK\n"
    (driving / "grouped_tasks.py").write_text(grouped)
    install(driving, "other", "DriveThere = grouped_tasks:Tasks.drive", group="magical.tasks")
    ids = ["magical/DriveThere-Demo-v0"]
    with closing(MagicalVectorEnv(ids, workers=1, observation="state")) as envs:
        envs.reset(seed=0)


def test_a_file_finds_its_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "neighbour_of_plugin.py").write_text("from magical.tasks import get_task\n")
    file = tmp_path / "user_plugin.py"
    file.write_text('import neighbour_of_plugin\nT = neighbour_of_plugin.get_task("MakeLine")\n')
    monkeypatch.setattr("sys.path", [*sys.path])
    assert THINGS.get(f"{file}:T").name == "MakeLine"


Run = Callable[..., str]


@pytest.fixture(scope="module")
def installed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs an interpreter in a folder, `examples/plugin` being installed; returns its output."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(root / "examples" / "plugin", folder / "source")
    build = ("build", "--wheel", "--no-isolation", "--outdir", ".", "source")
    subprocess.run([sys.executable, "-m", *build], cwd=folder, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    pip = ("pip", "install", "--quiet", "--no-index", "--no-deps", "--target", "site", wheel.name)
    subprocess.run([sys.executable, "-m", *pip], cwd=folder, check=True)
    (folder / "plan.toml").write_text(PLAN)

    def run(*arguments: str) -> str:
        words = arguments if arguments[0] == "-c" else ("-m", "magical", *arguments[0].split())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("sys.path", [str(folder / "site"), *sys.path])
            done = run_python(*words, cwd=folder)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


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


def test_tasks_experts_and_policies_of_a_distribution(installed: Run) -> None:
    assert "EmptyRegion has no variant 'TestLayout'; it has: Demo," in installed("-c", LAZY)
    for policy in ("circle", "expert"):
        command = f"evaluate {policy} --task EmptyRegion --variants All --rollouts 2 --json"
        scores = json.loads(installed(f"{command} --out {policy}").splitlines()[-1])
        assert scores["All"]["mean"] == 1.0
    assert "confirmed: " in installed("verify circle")


PLAN = """
tasks = ["EmptyRegion"]
demos = "expert"
expert_demos = 3
num_demos = 3
preset = "quick"
threads = 1
rollouts = 1
variants = ["Demo"]

[[methods]]
name = "Smooth BC"
algorithm = "smooth-bc"
settings = { batches = 3, network = "patches", observation = "TwoFrames" }
"""


def test_an_algorithm_of_a_distribution_is_planned_and_reported(installed: Run) -> None:
    pytest.importorskip("magical_baselines")
    installed("run plan.toml --out runs --workers 1")
    assert "Smooth BC" in installed("report runs")
