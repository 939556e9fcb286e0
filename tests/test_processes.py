"""A function mapped over items in processes: order, laziness, errors, deaths; progress."""

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from magical import progress
from magical.errors import WorkerDiedError
from magical.processes import map_in_processes
from tests.waiting import gone, soon

pytestmark = pytest.mark.posix


def kill_at_one(item: int) -> int:
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def wait_for_ever(folder: str) -> None:
    """Leave the process id as a file's name, then wait for a signal."""
    (Path(folder) / str(os.getpid())).touch()
    signal.pause()


def test_results_come_in_order_and_only_a_few_items_are_taken_ahead() -> None:
    taken = 0

    def items() -> Iterator[int]:
        nonlocal taken
        for taken in itertools.count(1):
            yield -taken

    with closing(map_in_processes(abs, items(), 2)) as results:
        assert taken == 0
        for i in range(1, 30):
            assert next(results) == i
            assert taken <= i + 4


def test_an_exception_is_raised_and_a_process_that_is_killed_is_an_error() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        list(map_in_processes(int, ["x"], 2))
    with pytest.raises(WorkerDiedError, match="a worker process was killed"):
        list(map_in_processes(kill_at_one, itertools.count(), 2))


@pytest.mark.linux
def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    program = (
        "from magical.processes import map_in_processes\n"
        "from tests.test_processes import wait_for_ever\n"
        f"list(map_in_processes(wait_for_ever, [{str(tmp_path)!r}] * 2, 2))\n"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        assert soon(lambda: len(list(tmp_path.iterdir())) == 2, 120)
        process.kill()
    assert gone(int(path.name) for path in tmp_path.iterdir())


def test_without_a_terminal_there_are_lines_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress.ProgressBar("rollouts", 3) as bar:
        bar.advance(1)  # too soon
        monkeypatch.setattr(progress, "LINE_INTERVAL", -1.0)
        bar.advance(2)
    with progress.ProgressBar("bc", 2) as bar:
        bar.update(1, {"loss": 0.25})
    assert capsys.readouterr().err == "rollouts 3/3\nbc 1/2  loss 0.25\n"
