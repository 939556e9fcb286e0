"""Who may call a vector environment, and for how long a call may take."""

import copy
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import (
    AlreadyPendingCallError,
    ClosedEnvironmentError,
    NotPicklableError,
    WorkerTimeoutError,
)
from tests.envs.vector.making import IDS, started
from tests.waiting import gone

SECONDS = 20.0  # in which anything that ends at all has ended


FORK = """
import os
from magical.envs.vector import MagicalVectorEnv
from magical.errors import ForkedEnvironmentError
envs = MagicalVectorEnv(["magical/MakeLine-Demo-v0"] * 2, workers={workers}, observation="state")
envs.reset(seed=0)
before = envs.get_state(0)
if not (child := os.fork()):
    try:
        for call in (lambda: envs.step([1, 1]), envs.reset, lambda: envs.set_state(0, before)):
            call()
        print("worked", flush=True)
    except ForkedEnvironmentError as error:
        print("refused", f"process {os.getppid()}," in str(error), flush=True)
    os._exit(0)
os.waitpid(child, 0)
envs.step([1, 1])
print(before["actions"], envs.get_state(0)["actions"])
"""


@pytest.mark.posix
@pytest.mark.parametrize(("workers", "outcome"), [(1, "refused True"), (0, "worked")])
def test_a_fork_does_not_change_its_parents_environments(workers: int, outcome: str) -> None:
    command = [sys.executable, "-c", FORK.replace("{workers}", str(workers))]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert result.stdout.splitlines() == [outcome, "[] [1]"]


@pytest.mark.parametrize("call", ["step", "reset", "get_state", "set_state"])
def test_a_second_call_while_one_is_pending_is_refused(
    monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    envs = started(workers=0)
    state = envs.get_state(0)
    calls: dict[str, Callable[[], Any]] = {
        "step": lambda: envs.step([0] * 4),
        "reset": envs.reset,
        "get_state": lambda: envs.get_state(0),
        "set_state": lambda: envs.set_state(0, state),
    }
    reached, go_on = threading.Event(), threading.Event()
    step = envs._sub_envs.step

    def wait_in_step() -> Any:
        reached.set()
        assert go_on.wait(SECONDS)
        return step()

    monkeypatch.setattr(envs._sub_envs, "step", wait_in_step)
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(envs.step([1] * 4)))
    thread.start()
    assert reached.wait(SECONDS)
    with pytest.raises(AlreadyPendingCallError, match=f"{call}: .* pending call of step"):
        calls[call]()
    go_on.set()
    thread.join(SECONDS)
    assert len(results) == 1
    assert envs.get_state(0)["actions"] == [1]


@pytest.mark.parametrize("copied", [copy.deepcopy, copy.copy, pickle.dumps])
def test_pickle_and_copies_say_what_to_do_instead(copied: Callable[[Any], Any]) -> None:
    env = MagicalEnv("MakeLine", "Demo", observation="state")
    for made in (env, started(workers=0)):
        with pytest.raises(NotPicklableError, match="get_state and set_state"):
            copied(made)


@pytest.mark.linux
@pytest.mark.parametrize("call", ["step", "reset"])
def test_a_stopped_worker_is_named_after_the_timeout(call: str) -> None:
    envs = started(timeout=SECONDS)
    workers = envs.worker_process_ids
    envs._sub_envs._timeout = 0.2  # type: ignore[union-attr]
    os.kill(workers[1], signal.SIGSTOP)
    began = time.monotonic()
    with pytest.raises(WorkerTimeoutError, match=r"within 0.2 s, .*: worker 1 \(environments 2 to"):
        envs.step([0] * 4) if call == "step" else envs.reset()
    assert time.monotonic() - began < SECONDS
    assert gone(workers)
    with pytest.raises(ClosedEnvironmentError):
        envs.step([0] * 4)


@pytest.mark.posix
def test_a_timeout_that_is_kept_changes_nothing() -> None:
    limited, unlimited = started(timeout=SECONDS), started()
    for _ in range(3):
        found, expected = limited.step([1] * 4), unlimited.step([1] * 4)
        np.testing.assert_array_equal(found[0], expected[0])
    large = {"scene": limited.get_state(0)["scene"]}
    limited.reset(options=large)
    limited.close()
    unlimited.close()


@pytest.mark.parametrize("timeout", [0, -1.0, float("nan"), float("inf"), "5", True, 10**400])
def test_impossible_timeouts(timeout: Any) -> None:
    with pytest.raises(ValueError, match="timeout"):
        MagicalVectorEnv(IDS, workers=1, observation="state", timeout=timeout)
    with pytest.raises(ValueError, match="without workers"):
        MagicalVectorEnv(IDS, workers=0, observation="state", timeout=1.0)


@pytest.mark.linux
def test_closing_does_not_wait_for_a_stopped_worker() -> None:
    envs = started()
    workers = envs.worker_process_ids
    os.kill(workers[0], signal.SIGSTOP)
    began = time.monotonic()
    envs.close()
    assert time.monotonic() - began < SECONDS
    assert gone(workers)
