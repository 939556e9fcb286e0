"""The pool of processes: order, laziness, errors and deaths of its children."""

import itertools
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import active_count
from typing import Any

import pytest

from magical.errors import WorkerDiedError
from magical.processes import ProcessPool, available_cores, map_in_processes, outcomes_in_processes
from tests.processes import work
from tests.waiting import gone, soon

pytestmark = pytest.mark.posix


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.linux
@pytest.mark.parametrize("workers", [1, 3])
def test_results_come_in_the_items_order(workers: int) -> None:
    before = descriptors(), active_count()
    assert list(map_in_processes(abs, range(-20, 0), workers)) == [*range(20, 0, -1)]
    assert list(map_in_processes(abs, [], workers)) == []
    assert (descriptors(), active_count()) == before


@pytest.mark.linux
def test_one_worker_is_this_process_and_several_are_others() -> None:
    here = list(map_in_processes(partial(work.exit_at, -1), range(3), 1))
    there = list(map_in_processes(partial(work.exit_at, -1), range(6), 2))
    assert {process_id for _, process_id in here} == {os.getpid()}
    processes = {process_id for _, process_id in there}
    assert os.getpid() not in processes
    assert len(processes) <= 2
    assert gone(processes)


def test_items_may_be_infinite_and_only_a_few_are_taken_ahead() -> None:
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


@pytest.mark.linux
def test_closing_kills_the_processes_in_the_middle_of_their_work(tmp_path: Path) -> None:
    before = descriptors(), active_count()
    results = map_in_processes(work.compute_for_ever, ["", *[str(tmp_path)] * 9], 2)
    assert next(results) is None
    assert soon(lambda: len(list(tmp_path.iterdir())) == 2, 20)
    results.close()
    assert gone(int(path.name) for path in tmp_path.iterdir())
    assert (descriptors(), active_count()) == before


def test_a_dead_process_costs_one_item_and_is_replaced() -> None:
    results = outcomes_in_processes(partial(work.exit_at, 5), range(30), 2)
    items = [result if isinstance(result, Exception) else result[0] for result in results]
    died = items.pop(5)
    assert isinstance(died, WorkerDiedError)
    assert str(died) == "a worker process ended with exit status 7"
    assert items == [*range(5), *range(6, 30)]


@pytest.mark.linux
def test_all_processes_may_die() -> None:
    numbers = [signal.SIGSEGV, signal.SIGKILL, 35, signal.SIGSEGV, signal.SIGTERM]
    results = list(outcomes_in_processes(work.kill_itself, numbers, 2))
    assert [str(result) for result in results] == [
        f"a worker process was killed by signal {end}"
        for end in ("11 (SIGSEGV)", "9 (SIGKILL)", "35", "11 (SIGSEGV)", "15 (SIGTERM)")
    ]


def test_processes_take_turns_with_environment_variables() -> None:
    with closing(ProcessPool(1, [{"CUDA_VISIBLE_DEVICES": "3"}, {}])) as pool:
        assert pool.submit(os.getenv, "CUDA_VISIBLE_DEVICES").result() == "3"


def test_a_dead_process_is_an_error() -> None:
    with pytest.raises(WorkerDiedError, match="exit status 7"):
        list(map_in_processes(partial(work.exit_at, 1), itertools.count(), 2))


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_is_raised_or_returned(workers: int) -> None:
    with pytest.raises(ValueError, match="not this one"):
        list(map_in_processes(work.raise_error, ["value"], workers))
    outcomes = outcomes_in_processes(work.raise_error, ["file", "value"], workers)
    assert list(map(type, outcomes)) == [FileNotFoundError, ValueError]


def test_what_cannot_be_pickled() -> None:
    with pytest.raises(AttributeError, match="local object"):
        list(map_in_processes(work.not_to_be_pickled, [1], 2))
    with pytest.raises(AttributeError, match="local object"):
        list(map_in_processes(lambda item: item, [1], 2))


@pytest.mark.linux
def test_an_exception_of_the_items_ends_the_work() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise KeyError("no more")

    before = descriptors(), active_count()
    with pytest.raises(KeyError, match="no more"):
        list(map_in_processes(abs, items(), 2))
    assert (descriptors(), active_count()) == before


def test_large_items_and_results() -> None:
    items = [b"\x01" * 3_000_000] * 8
    assert sum(map(len, map_in_processes(bytes, items, 2))) == 24_000_000
    results = map_in_processes(work.large, [3_000_000] * 8, 2)
    assert all(result == items[0] for result in results)


def test_output_is_no_reply_and_a_child_has_one_thread(capfd: Any) -> None:
    ((read, environment),) = map_in_processes(work.print_and_read, ["printed"], 2)
    assert read == ""
    assert environment["OMP_NUM_THREADS"] == environment["OPENBLAS_NUM_THREADS"] == "1"
    assert capfd.readouterr() == ("", "printed\n")


def test_a_terminated_pool_lets_work_finish_and_starts_no_more(tmp_path: Path) -> None:
    file = tmp_path / "waiting"
    with closing(ProcessPool(1)) as pool:
        first, second = pool.submit(work.wait_for_sigterm, str(file)), pool.submit(abs, -1)
        assert soon(file.exists, 60.0)
        pool.terminate()
        assert first.result() == "received [15]"
        with pytest.raises(WorkerDiedError, match="the pool of processes is closed"):
            second.result()


def test_a_closed_pool_takes_no_tasks() -> None:
    pool = ProcessPool(1)
    assert pool.submit(abs, -1).result(20) == 1
    pool.close()
    with pytest.raises(WorkerDiedError, match="the pool of processes is closed"):
        pool.submit(abs, -1).result(20)


def test_a_cancelled_task_is_not_computed_and_the_next_one_is(tmp_path: Path) -> None:
    file = tmp_path / "waiting"
    with closing(ProcessPool(1)) as pool:
        first = pool.submit(work.wait_for_sigterm, str(file))
        cancelled, second = (pool.submit(Path.touch, tmp_path / name) for name in ("a", "b"))
        assert soon(file.exists, 60.0)
        assert cancelled.cancel()
        os.kill(pool._children[0].process.pid, signal.SIGTERM)
        assert (first.result(20), second.result(20)) == ("received [15]", None)
    assert [(tmp_path / name).exists() for name in ("a", "b")] == [False, True]


def test_a_result_that_cannot_be_unpickled_costs_one_task() -> None:
    results = list(outcomes_in_processes(work.one_way, [True, False] * 2, 2))
    assert [type(result) for result in results] == [ZeroDivisionError, bool] * 2


def test_available_cores() -> None:
    assert 1 <= available_cores() <= (os.cpu_count() or 1)
