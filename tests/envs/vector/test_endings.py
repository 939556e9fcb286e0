"""However a script ends, its worker processes end as well."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.waiting import alive, gone

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and /proc")
USE = """
import sys
from magical.envs.vector import MagicalVectorEnv
envs = MagicalVectorEnv(["magical/MakeLine-Demo-v0"] * 2, workers=2, observation="state")
envs.reset(seed=0)
print(*envs.worker_process_ids, flush=True)
"""
Start = Callable[[str], "subprocess.Popen[str]"]


@pytest.fixture
def script(tmp_path: Path) -> Start:
    """Starts a script that has no `__main__` guard."""

    def start(text: str) -> "subprocess.Popen[str]":
        path = tmp_path / "script.py"
        path.write_text(text)
        return subprocess.Popen(
            [sys.executable, path], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    return start


def test_a_script_without_a_main_guard_that_does_not_close(script: Start) -> None:
    output, errors = script(f"print('once')\n{USE}\nenvs.step([0, 0])").communicate(timeout=30)
    once, workers = output.splitlines()
    assert (once, errors) == ("once", "")
    assert gone([int(i) for i in workers.split()])


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_parent(script: Start, how: signal.Signals) -> None:
    process = script(f"{USE}\nwhile True: envs.step([0, 0])")
    assert process.stdout is not None
    workers = [int(i) for i in process.stdout.readline().split()]
    assert all(map(alive, workers))
    process.send_signal(how)
    errors = process.communicate(timeout=30)[1]
    assert gone(workers)
    assert errors.count("Traceback") == (how is signal.SIGINT)


def test_a_fork_does_not_end_its_parents_workers(script: Start) -> None:
    text = f"""{USE}
import os
if not (child := os.fork()):
    sys.exit()
os.waitpid(child, 0)
envs.step([0, 0])
print("goes on")
"""
    output, errors = script(text).communicate(timeout=30)
    assert (output.splitlines()[1:], errors) == (["goes on"], "")
