"""A function mapped over items in processes: order, laziness, errors, deaths."""

import itertools
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from magical.errors import WorkerDiedError
from magical.processes import checked_workers, map_in_processes
from tests.processes import work
from tests.waiting import gone, soon

pytestmark = pytest.mark.posix


def test_one_worker_is_this_process_and_several_are_others() -> None:
    assert set(map_in_processes(work.process_id, range(3), 1)) == {os.getpid()}
    processes = set(map_in_processes(work.process_id, range(6), 2))
    assert os.getpid() not in processes
    assert 1 <= len(processes) <= 2


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


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_is_raised(workers: int) -> None:
    with pytest.raises(KeyError, match="3"):
        list(map_in_processes(work.raise_error, [3], workers))


def test_a_process_that_is_killed_is_an_error() -> None:
    with pytest.raises(WorkerDiedError, match="a worker process was killed"):
        list(map_in_processes(partial(work.kill_at, 1), itertools.count(), 2))


@pytest.mark.linux
def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    program = (
        "from magical.processes import map_in_processes\n"
        "from tests.processes import work\n"
        f"list(map_in_processes(work.wait_for_ever, [{str(tmp_path)!r}] * 2, 2))\n"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        assert soon(lambda: len(list(tmp_path.iterdir())) == 2, 120)
        process.kill()
    assert gone(int(path.name) for path in tmp_path.iterdir())


def test_fewer_than_no_workers_are_refused() -> None:
    with pytest.raises(ValueError, match="workers: expected at least 0"):
        checked_workers(-1)
