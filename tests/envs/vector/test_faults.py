"""Faults of worker processes: named errors, and no process, memory or descriptor remains."""

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.envs.vector import MagicalVectorEnv
from magical.envs.vector.workers import RemoteSubEnvs, split
from magical.errors import (
    ClosedEnvironmentError,
    InvalidTaskError,
    ResetNeededError,
    WorkerDiedError,
    WorkerError,
)
from magical.processes import WorkerTraceback
from magical.tasks import Task, register_task, unregister_task
from tests.waiting import alive, gone, soon

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and /proc")
IDS = ("magical/MakeLine-Demo-v0", "magical/MakeLine-TestColour-v0")
PLUGIN = """
import os
from dataclasses import replace
from magical import get_task, register_task

class CustomError(Exception):
    pass

def score_fn(scene, poses):
    if os.environ.get("HOW") == "exit":
        os._exit(7)
    if os.environ.get("HOW") == "custom":
        raise CustomError("strange", 5)
    print("a task that prints")
    raise ValueError("no score today")

TASK = replace(get_task("MakeLine"), name="Breaking", score_fn=score_fn)
"""


def process_ids(envs: MagicalVectorEnv) -> list[int]:
    assert len(envs.worker_process_ids) == envs.workers
    return envs.worker_process_ids


def processor_ticks(process_id: int) -> int:
    return sum(map(int, Path(f"/proc/{process_id}/stat").read_text().split()[13:15]))


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def shared_memory() -> set[str]:
    return {path.name for path in Path("/dev/shm").iterdir() if "magical" in path.name}


def make(env_ids: tuple[str, ...] = IDS * 2, workers: int = 2, **options: Any) -> MagicalVectorEnv:
    envs = MagicalVectorEnv(env_ids, workers=workers, observation="state", **options)
    envs.reset(seed=0)
    return envs


def step_for_ever(envs: MagicalVectorEnv) -> None:
    while True:
        envs.step([1] * envs.num_envs)


@pytest.fixture
def breaking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Task]:
    """A task in a module outside the package, whose score cannot be computed."""
    (tmp_path / "breaking_task.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    module = __import__("breaking_task")
    register_task(module.TASK)
    yield module.TASK
    unregister_task("Breaking")
    del sys.modules["breaking_task"]


@pytest.mark.parametrize("killed", [0, 1])
def test_a_killed_worker_is_named_and_the_others_end(killed: int) -> None:
    before = descriptors()
    envs = make()
    workers = process_ids(envs)
    os.kill(workers[killed], signal.SIGKILL)
    rows = ("0 to 1", "2 to 3")[killed]
    began = time.monotonic()
    with pytest.raises(WorkerDiedError) as caught:
        envs.step([0] * 4)
    assert time.monotonic() - began < 5
    assert f"worker {killed} (environments {rows}: {', '.join(IDS)})" in str(caught.value)
    assert "killed by signal 9 (SIGKILL)" in str(caught.value)
    assert gone(workers)
    assert shared_memory() == set()
    assert descriptors() == before
    with pytest.raises(ClosedEnvironmentError):
        envs.step([0] * 4)
    envs.close()


def test_a_worker_killed_while_it_works_is_noticed() -> None:
    envs = make(IDS * 32, workers=1)
    (worker,) = process_ids(envs)
    killer = subprocess.Popen([sys.executable, "-c", f"import os; os.kill({worker}, 9)"])
    with pytest.raises(WorkerDiedError):
        step_for_ever(envs)
    killer.wait()


def test_a_worker_that_exits_is_named(breaking: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOW", "exit")
    envs = make(("magical/Breaking-Demo-v0",), 1, horizon=1)
    with pytest.raises(WorkerDiedError, match="ended with exit status 7"):
        envs.step([0])


def test_an_exception_keeps_its_class_its_environment_and_its_traceback(breaking: Task) -> None:
    envs = make((*IDS, "magical/Breaking-Demo-v0"), 2, horizon=1)
    workers = process_ids(envs)
    with pytest.raises(ValueError, match="no score today") as caught:
        envs.step([0, 0, 0])
    assert type(caught.value) is ValueError
    assert caught.value.__notes__ == ["in environment 2 (magical/Breaking-Demo-v0)"]
    assert isinstance(caught.value.__cause__, WorkerTraceback)
    assert "breaking_task.py" in str(caught.value.__cause__)
    assert "in score_fn" in str(caught.value.__cause__)
    with pytest.raises(ResetNeededError, match="in 3 of 3"):
        envs.step([0, 0, 0])
    envs.reset()
    envs.step([0, 0, 0], active=np.array([True, True, False]))
    assert process_ids(envs) == workers
    envs.close()


def test_an_exception_of_a_class_from_outside(
    breaking: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOW", "custom")
    envs = make(("magical/Breaking-Demo-v0",), 1, horizon=1)
    with pytest.raises(WorkerError, match=r"CustomError: \('strange', 5\)"):
        envs.step([0])
    envs.close()


def test_a_task_that_workers_cannot_import(breaking: Task) -> None:
    del sys.modules["breaking_task"].TASK
    env_ids = ["magical/Breaking-Demo-v0"]
    with pytest.raises(InvalidTaskError, match=r"plugins=\[...\], or use workers=0"):
        MagicalVectorEnv(env_ids, workers=1, observation="state")
    MagicalVectorEnv(env_ids, workers=0, observation="state").reset()
    with pytest.raises(ModuleNotFoundError, match="nowhere_at_all"):
        MagicalVectorEnv(env_ids, workers=1, observation="state", plugins=["nowhere_at_all"])
    sys.modules["breaking_task"].TASK = breaking  # type: ignore[attr-defined]
    given = MagicalVectorEnv(env_ids, workers=1, observation="state", plugins=["breaking_task"])
    given.reset()
    given.close()


def test_an_interrupted_exchange_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(worker: Any) -> None:
        raise KeyboardInterrupt

    envs = make()
    workers = process_ids(envs)
    monkeypatch.setattr("magical.processes.Child.receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        envs.step([0] * 4)
    assert envs.closed
    assert gone(workers)


def test_closing_twice_ends_everything() -> None:
    before = descriptors()
    envs = make()
    workers = process_ids(envs)
    envs.close()
    assert not any(map(alive, workers))
    envs.close()
    assert descriptors() == before


def test_garbage_collection_ends_everything() -> None:
    before = descriptors()
    envs = make()
    workers = process_ids(envs)
    observations = envs.reset(seed=0)[0]
    del envs
    gc.collect()
    assert not any(map(alive, workers))
    assert descriptors() == before
    assert np.isfinite(observations).all()


def test_arrays_of_the_buffers_outlive_the_environment() -> None:
    envs = MagicalVectorEnv(IDS, workers=2, observation="state", copy=False)
    observations, _ = envs.reset(seed=0)
    before = observations.copy()
    envs.close()
    del envs
    gc.collect()
    np.testing.assert_array_equal(observations, before)


def test_idle_workers_use_no_processor_time() -> None:
    envs = make()
    before = [processor_ticks(i) for i in process_ids(envs)]
    end = time.monotonic() + 0.3
    assert soon(lambda: time.monotonic() > end)
    assert [processor_ticks(i) for i in process_ids(envs)] == before
    envs.close()


def test_no_more_workers_than_sub_environments() -> None:
    envs = make(IDS, workers=5)
    assert envs.workers == 2
    assert isinstance(envs._sub_envs, RemoteSubEnvs)
    envs.close()
    assert [list(rows) for rows in split(7, 3)] == [[0, 1], [2, 3], [4, 5, 6]]
