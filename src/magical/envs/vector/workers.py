"""Worker processes: how they are started, called and ended, and what each of them does.

Requests go to a worker on a pipe, replies come back on another (`magical.processes`); arrays travel
in shared memory only.
"""

import gc
import os
import pickle
import select
import subprocess
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any, NoReturn

import numpy as np

from magical.envs.episode import Episode
from magical.envs.saved_state import SavedState
from magical.envs.vector.buffers import SharedMemory, VectorBuffers, VectorSpec, open_memory
from magical.envs.vector.sub_envs import Restored, Seeds, Started, SubEnvs
from magical.errors import (
    ObservationError,
    WorkerDiedError,
    WorkerTimeoutError,
)
from magical.processes import Child, serve
from magical.scene.actions import NOOP
from magical.tasks import load_tasks
from magical.tasks.registry import defining_modules

_GRACE_PERIOD = 2.0  # seconds that workers have to exit on their own
_STEP = pickle.dumps(("step", ()))
# pymunk leaves the spaces of past episodes, some 80 kB each, to the garbage collector, which on
# its own would run only after a few hundred.
_EPISODES_KEPT = 16


class RemoteSubEnvs:
    """All sub-environments of a vector environment, spread over worker processes.

    It has the methods of `SubEnvs`. The processes end when `close` is called, when this object is
    collected or when this process exits, whichever comes first.

    Args:
        spec: what the vector environment consists of.
        workers: the number of processes, at most one for each sub-environment.
        memory: holds the buffers.
        timeout: seconds that a call may take, which does not limit the start; None for no limit.
    """

    def __init__(
        self,
        spec: VectorSpec,
        workers: int,
        memory: SharedMemory,
        timeout: float | None,
    ) -> None:
        self._timeout: float | None = None
        self._workers: list[_Worker] = []
        self.close = weakref.finalize(self, _end, self._workers, os.getpid())
        try:
            modules = defining_modules(spec.tasks())
            if type(spec.observation).__module__ == "__main__":
                raise ObservationError(
                    "observation: workers never import the main script, which defines this one; "
                    "put it into a module, or use workers=0"
                )
            for rows in split(len(spec.env_ids), workers):
                self._workers.append(_Worker(len(self._workers), rows, spec, memory))
            setup = modules, spec, memory.handle
            self._exchange(
                {worker: pickle.dumps(("start", (*setup, worker.rows))) for worker in self._workers}
            )
        except BaseException:
            self.close()
            raise
        finally:
            memory.release_handle()
        self._timeout = timeout

    @property
    def process_ids(self) -> list[int]:
        """The workers' process ids."""
        return [worker.process.pid for worker in self._workers]

    def step(self) -> Started:
        """See `SubEnvs.step`."""
        replies = self._exchange(dict.fromkeys(self._workers, _STEP))
        return [started for reply in replies for started in reply]

    def reset(self, seeds: Seeds, options: Mapping[str, Any] | None) -> Started:
        """See `SubEnvs.reset`."""
        requests = {}
        for worker in self._workers:
            share = [(row, seed) for row, seed in seeds if row in worker.rows]
            if share:
                requests[worker] = pickle.dumps(("reset", (share, options)))
        return [started for reply in self._exchange(requests) for started in reply]

    def get_state(self, row: int) -> dict[str, Any]:
        """See `SubEnvs.get_state`."""
        state: dict[str, Any] = self._call("get_state", row)
        return state

    def set_state(self, row: int, state: SavedState) -> Restored:
        """See `SubEnvs.set_state`."""
        restored: Restored = self._call("set_state", row, state)
        return restored

    def _call(self, name: str, row: int, *args: Any) -> Any:
        """Call a method of the `SubEnvs` that sub-environment `row` belongs to."""
        (worker,) = (worker for worker in self._workers if row in worker.rows)
        return self._exchange({worker: pickle.dumps((name, (row, *args)))})[0]

    def _exchange(self, requests: "Mapping[_Worker, bytes]") -> list[Any]:
        """Send requests and wait for the results, within the timeout; raise the first error."""
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        waiting, replies = list(requests), []
        try:
            for worker, request in requests.items():
                worker.send(request)
            for worker in requests:
                if deadline is not None and not worker.has_replied(deadline):
                    late = [each for each in waiting if not each.has_replied()]
                    self._raise_timeout(late or [worker])
                replies.append(worker.receive())
                waiting.remove(worker)
        except WorkerDiedError as error:
            self.close()
            raise WorkerDiedError(
                f"{error}; all other workers were ended; make another vector environment"
            ) from None
        for succeeded, value in replies:
            if not succeeded:
                raise value
        return [value for _, value in replies]

    def _raise_timeout(self, late: "Sequence[_Worker]") -> NoReturn:
        for worker in late:
            worker.process.kill()
        self.close()
        raise WorkerTimeoutError(
            f"expected every worker to finish within {self._timeout:g} s, found at work: "
            f"{'; '.join(worker.name for worker in late)}; all workers were ended; make another "
            "vector environment, with a longer timeout if a call may take longer"
        )


class _Worker(Child):
    """One worker process, with the rows of its sub-environments."""

    def __init__(self, index: int, rows: range, spec: VectorSpec, memory: SharedMemory) -> None:
        self.rows = rows
        names = ", ".join(dict.fromkeys(spec.env_ids[row] for row in rows))
        name = f"worker {index} (environments {rows[0]} to {rows[-1]}: {names})"
        super().__init__(__name__, name, memory.inherited)

    def has_replied(self, deadline: float = 0.0) -> bool:
        """Whether a reply or the process's end can be read by `deadline` (`time.monotonic()`).

        A worker writes a reply in one go, so there is no need to wait for the rest of it.
        """
        poll = select.poll()
        poll.register(self.replies, select.POLLIN)
        return bool(poll.poll(1000 * max(0.0, deadline - time.monotonic())))


def split(count: int, workers: int) -> Iterator[range]:
    """Rows of `count` sub-environments for each of the workers, divided evenly."""
    for i in range(workers):
        yield range(count * i // workers, count * (i + 1) // workers)


def _end(workers: "list[_Worker]", owner: int) -> None:
    """End workers and wait until they have; kill those that take too long."""
    if os.getpid() != owner:  # a fork of the process they belong to
        return
    for worker in workers:
        with suppress(OSError):  # a request that could not be written
            worker.requests.close()
    deadline = time.monotonic() + _GRACE_PERIOD
    for worker in workers:
        with suppress(subprocess.TimeoutExpired):
            worker.process.wait(max(0.0, deadline - time.monotonic()))
        worker.close()


def main(requests: IO[bytes], replies: IO[bytes]) -> None:
    """The worker's side: make sub-environments at the first request, then call their methods."""
    sub_envs: SubEnvs
    episodes = 0  # since the last garbage collection

    def answer(request: tuple[str, tuple[Any, ...]]) -> Any:
        nonlocal sub_envs, episodes
        name, args = request
        if name == "start":
            sub_envs = _start(*args)
            return []
        result = getattr(sub_envs, name)(*args)
        episodes += len(result) if isinstance(result, list) else 0
        return result

    def collect_garbage() -> None:
        nonlocal episodes
        if episodes >= _EPISODES_KEPT:
            gc.collect()
            episodes = 0

    serve(answer, requests, replies, after=collect_garbage)


def _start(modules: Sequence[str], spec: VectorSpec, handle: int | str, rows: range) -> SubEnvs:
    load_tasks(modules)
    memory = open_memory(handle, spec.size)
    if isinstance(handle, int):
        os.close(handle)
    _warm_up(spec)
    sub_envs = SubEnvs(spec, rows, VectorBuffers(spec, memory))
    # What is loaded by now stays loaded; excluding it, a collection takes a millisecond or two.
    gc.collect()
    gc.freeze()
    return sub_envs


def _warm_up(spec: VectorSpec) -> None:
    """Take one step in a throwaway episode, so that everything needed is loaded."""
    variant = spec.env_ids[0].variant
    episode = Episode(spec.tasks()[0], variant, spec.observation, spec.horizon, spec.reward)
    with suppress(Exception):  # an error here will be raised again by the first reset
        episode.start(np.random.default_rng(0))
        episode.step(NOOP)
