"""Faults and ends of worker processes: named errors; no process, memory or descriptor remains."""

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.envs.env import MagicalEnv
from magical.envs.vector.workers import RemoteSubEnvs, split
from magical.errors import (
    ClosedEnvironmentError,
    InvalidScoreError,
    InvalidTaskError,
    ResetNeededError,
    WorkerDiedError,
)
from magical.processes import WorkerTraceback
from magical.tasks import register_task, unregister_task
from tests.envs.vector.making import IDS, started, vector
from tests.waiting import alive, gone

pytestmark = pytest.mark.posix
MODULE = """
import os
from dataclasses import replace
from magical import get_task

def score_fn(scene, poses):
    {body}

TASK = replace(get_task("MakeLine"), name="Misbehaving", score_fn=score_fn)
"""
MISBEHAVING = ("magical/Misbehaving-Demo-v0",)
Misbehave = Callable[[str], Any]


@pytest.fixture
def misbehave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Misbehave]:
    """Registers a task of a module outside the package, with a body of its score function."""

    def register(body: str) -> Any:
        (tmp_path / "misbehaving_task.py").write_text(MODULE.replace("{body}", body))
        monkeypatch.syspath_prepend(tmp_path)
        module = __import__("misbehaving_task")
        register_task(module.TASK)
        return module

    yield register
    unregister_task("Misbehaving")
    sys.modules.pop("misbehaving_task", None)


def descriptors() -> int:
    gc.collect()  # environments of other tests
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.linux
@pytest.mark.parametrize(("killed", "rows"), [(0, "0 to 1"), (1, "2 to 3")])
def test_a_killed_worker_is_named_and_the_others_end(killed: int, rows: str) -> None:
    before = descriptors()
    envs = started()
    workers = envs.worker_process_ids
    os.kill(workers[killed], signal.SIGKILL)
    began = time.monotonic()
    with pytest.raises(WorkerDiedError) as caught:
        envs.step([0] * 4)
    assert time.monotonic() - began < 5
    assert f"worker {killed} (environments {rows}: {', '.join(IDS)})" in str(caught.value)
    assert "killed by signal 9 (SIGKILL)" in str(caught.value)
    assert gone(workers)
    assert not [path for path in Path("/dev/shm").iterdir() if "magical" in path.name]
    assert descriptors() == before
    with pytest.raises(ClosedEnvironmentError):
        envs.step([0] * 4)
    envs.close()


def test_a_worker_that_exits_is_named(misbehave: Misbehave) -> None:
    misbehave("os._exit(7)")
    envs = started(MISBEHAVING, 1, horizon=1)
    with pytest.raises(WorkerDiedError, match="ended with exit status 7"):
        envs.step([0])


def test_an_exception_keeps_its_class_its_environment_and_its_traceback(
    misbehave: Misbehave,
) -> None:
    misbehave("print('a task that prints'); raise ValueError('no score today')")
    envs = started((*IDS, *MISBEHAVING), 2, horizon=1)
    workers = envs.worker_process_ids
    with pytest.raises(ValueError, match="no score today") as caught:
        envs.step([0, 0, 0])
    assert type(caught.value) is ValueError
    assert caught.value.__notes__ == ["in environment 2 (magical/Misbehaving-Demo-v0)"]
    assert isinstance(caught.value.__cause__, WorkerTraceback)
    assert "misbehaving_task.py" in str(caught.value.__cause__)
    assert "in score_fn" in str(caught.value.__cause__)
    with pytest.raises(ResetNeededError, match="in 3 of 3"):
        envs.step([0, 0, 0])
    envs.reset()
    envs.step([0, 0, 0], active=np.array([True, True, False]))
    assert envs.worker_process_ids == workers
    envs.close()


@pytest.mark.parametrize("value", ["float('nan')", "float('inf')", "-0.1", "1.5", "None", "'1'"])
def test_scores_are_numbers_from_0_to_1(misbehave: Misbehave, value: str) -> None:
    misbehave(f"return {value}")
    env = MagicalEnv("Misbehaving", "Demo", observation="state", horizon=1)
    env.reset(seed=0)
    expected = f"Misbehaving.*from 0 to 1, found {eval(value)!r}"  # noqa: S307
    with pytest.raises(InvalidScoreError, match=expected):
        env.step(0)
    for workers in (0, 1):
        envs = started(MISBEHAVING, workers, horizon=1)
        with pytest.raises(InvalidScoreError) as caught:
            envs.step([0])
        assert caught.value.__notes__ == ["in environment 0 (magical/Misbehaving-Demo-v0)"]
        envs.reset()  # the worker goes on
        envs.close()


def test_a_task_that_workers_cannot_import(misbehave: Misbehave) -> None:
    module = misbehave("return 0.0")
    task = module.TASK
    del module.TASK
    with pytest.raises(InvalidTaskError, match="give it a name in a module, or use workers=0"):
        vector(MISBEHAVING, 1)
    started(MISBEHAVING, 0)
    module.TASK = task
    started(MISBEHAVING, 1).close()


@pytest.mark.linux
def test_an_interrupted_exchange_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(worker: Any) -> None:
        raise KeyboardInterrupt

    envs = started()
    workers = envs.worker_process_ids
    monkeypatch.setattr("magical.processes.Child.receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        envs.step([0] * 4)
    assert envs.closed
    assert gone(workers)


@pytest.mark.linux
@pytest.mark.parametrize("how", ["closing twice", "garbage collection"])
def test_the_end_of_an_environment_ends_everything(how: str) -> None:
    before = descriptors()
    envs = started()
    workers = envs.worker_process_ids
    observations = envs.reset(seed=0)[0]
    if how == "closing twice":
        envs.close()
        envs.close()
    else:
        del envs
        gc.collect()
    assert not any(map(alive, workers))
    assert descriptors() == before
    assert np.isfinite(observations).all()


def test_arrays_of_the_buffers_outlive_the_environment() -> None:
    envs = vector(IDS, 2, copy=False)
    observations, _ = envs.reset(seed=0)
    before = observations.copy()
    envs.close()
    del envs
    gc.collect()
    np.testing.assert_array_equal(observations, before)


def test_no_more_workers_than_sub_environments() -> None:
    envs = started(IDS, workers=5)
    assert envs.workers == 2
    assert isinstance(envs._sub_envs, RemoteSubEnvs)
    envs.close()
    assert [list(rows) for rows in split(7, 3)] == [[0, 1], [2, 3], [4, 5, 6]]


MAIN = """
from task_of_a_script import TASK
from magical.evaluation import environments, evaluate
if __name__ == "__main__":
    evaluate("noop", environments([TASK.name], ["Demo"]), rollouts=2, workers=2)
"""


def test_a_script_may_import_a_task_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "task_of_a_script.py").write_text(
        "from dataclasses import replace\n"
        "from magical.tasks import get_task, register_task\n"
        "TASK = register_task(replace(get_task('MoveToRegion'), name='Mine', section=''))\n"
    )
    (tmp_path / "script.py").write_text(MAIN)
    subprocess.run([sys.executable, "script.py"], cwd=tmp_path, check=True, timeout=120)


IN_MAIN = """
import sys
from dataclasses import replace
from magical.demos.generate import generate
from magical.errors import InvalidTaskError, ObservationError
from magical.evaluation import NoopPolicy, environments, evaluate
from magical.experts import MovePlan, Planner, register_planner
from magical.observe import StateSpec
class Mine(StateSpec):
    pass
if __name__ == "__main__":
    policy = NoopPolicy()
    policy.observation = Mine(0, 1)
    env_ids = environments(["MoveToRegion"], ["Demo"])
    try:
        evaluate(policy, env_ids, rollouts=2, workers=2)
    except ObservationError as error:
        print(error)
    register_planner("MoveToRegion", Planner(lambda view, strategy, last: MovePlan()))
    try:
        generate(env_ids[0], 2, sys.argv[1], workers=2)
    except InvalidTaskError as error:
        print(error)
"""


def test_what_only_the_main_script_holds_is_refused(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(IN_MAIN)
    command = [sys.executable, "script.py", "demos"]
    done = subprocess.run(
        command, cwd=tmp_path, check=True, timeout=120, capture_output=True, text=True
    )
    first, second = done.stdout.splitlines()
    assert first.startswith("observation: workers never import the main script")
    assert second.startswith("expert of MoveToRegion: workers import experts by themselves")


# However a script ends; it has no `__main__` guard and does not close.
SCRIPT = """
import os, signal
from magical.envs.vector import MagicalVectorEnv
envs = MagicalVectorEnv(["magical/MakeLine-Demo-v0"] * 2, workers=2, observation="state")
envs.reset(seed=0)
print(*envs.worker_process_ids, flush=True)
{end}
"""


@pytest.mark.linux
@pytest.mark.parametrize(
    ("end", "status"),
    [("envs.step([0, 0])", 0), ("os.kill(os.getpid(), signal.SIGKILL)", -9)],
    ids=["end", "SIGKILL"],
)
def test_workers_end_with_their_script(end: str, status: int, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(end=end))
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (status, "")
    workers = [int(worker) for worker in done.stdout.split()]
    assert len(workers) == 2
    assert gone(workers)
