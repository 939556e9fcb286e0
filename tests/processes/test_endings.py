"""However a program ends, the processes of its pool end as well and leave nothing behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from tests.waiting import alive, gone

pytestmark = pytest.mark.linux
PROGRAM = """
import os, signal, sys
from pathlib import Path
from magical.processes import map_in_processes
from tests.processes import work
results = map_in_processes(work.{function}, ["", *["."] * 9], 2)
next(results)
while len(found := [*Path().iterdir()]) < 2:
    pass
print(*found, flush=True)
{end}
"""


Run = Callable[..., "Program"]


class Program:
    """A program whose processes are known by a mark in their environment."""

    def __init__(self, *command: str) -> None:
        self.mark = f"MARK={uuid4()}"
        environment = {**os.environ, "MARK": self.mark.partition("=")[2]}
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def process_ids(self) -> list[int]:
        """Every process of the program that runs."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(int(folder.name))
            except OSError:  # has ended
                continue
        return [process_id for process_id in found if alive(process_id)]


@pytest.fixture
def run() -> Iterator[Run]:
    """Starts programs, all of whose processes are killed in the end."""
    programs: list[Program] = []

    def start(*command: str) -> Program:
        programs.append(Program(sys.executable, *command))
        return programs[-1]

    yield start
    for program in programs:
        for process_id in program.process_ids():
            os.kill(process_id, signal.SIGKILL)
        program.process.communicate()


@pytest.mark.parametrize(
    ("end", "function"),
    [
        ("sys.exit(3)", "compute_for_ever"),  # with an iterator that is still open
        ("raise RuntimeError", "wait_for_ever"),
        ("os._exit(3)", "wait_for_ever"),
        ("os.kill(os.getpid(), signal.SIGINT)", "compute_for_ever"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "compute_for_ever"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "wait_for_ever"),
    ],
)
def test_processes_end_with_their_parent_in_the_middle_of_their_work(
    end: str,
    function: str,
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    root: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*sys.path, str(root)]))
    program = run("-c", PROGRAM.format(function=function, end=end))
    output, errors = program.process.communicate(timeout=60)
    assert (len(output.split()), program.process.returncode != 0) == (2, True)
    assert gone(map(int, output.split()))
    assert program.process_ids() == []
    assert errors.count("Traceback") == (end.startswith("raise") or "SIGINT" in end)


@pytest.mark.parametrize("closed", ["<&-", "<&- 2>&-", "<&- >&- 2>&-"])
def test_standard_streams_may_be_closed(closed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    text = """
from magical.processes import map_in_processes
assert list(map_in_processes(abs, [-1, -2], 2)) == [1, 2]
"""
    command = ["sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, text]
    assert subprocess.run(command, check=False).returncode == 0


def test_a_fork_does_not_end_the_processes_of_its_parent(
    run: Run, monkeypatch: pytest.MonkeyPatch, root: Path
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*sys.path, str(root)]))
    text = """
import itertools, os, sys
from magical.processes import map_in_processes
results = map_in_processes(abs, itertools.count(), 2)
print(next(results), flush=True)
if not (child := os.fork()):
    sys.exit()
print(os.waitpid(child, 0)[1], *itertools.islice(results, 9))
"""
    output, errors = run("-W", "ignore", "-c", text).process.communicate(timeout=60)
    assert (output, errors) == ("0\n0 1 2 3 4 5 6 7 8 9\n", "")
