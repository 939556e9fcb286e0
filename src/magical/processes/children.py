"""A child process: a fresh interpreter that ends with this one, however this one ends."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from magical.errors import WorkerDiedError
from magical.processes.channel import receive_result, send

_START = Path(__file__).with_name("start.py")
_WAIT = 2.0  # seconds that a child is given to end once its pipes are closed
# A child uses one core; libraries that start a thread for each core would only cost memory.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Child:
    """A fresh interpreter that runs `main(requests, replies)` of a module.

    `main` gets two pipes, one to read requests from and one to write replies to (`serve`); what it
    prints goes to standard error. The child has this process's `sys.path`. It ends when this
    process does, even in the middle of a computation, and ignores Ctrl-C, which is this process's
    to handle.

    Args:
        module: the module's name.
        name: what error messages call the child.
        environ: environment variables, in addition to this process's.

    Attributes:
        process: the process.
        requests: the writing end of the pipe of requests.
        replies: the reading end of the pipe of replies.
    """

    def __init__(
        self,
        module: str,
        name: str,
        environ: Mapping[str, str] = {},
    ) -> None:
        self.name = name
        entries = (entry for entry in sys.path if isinstance(entry, str))  # others are ignored
        setup = {"module": module, "path": [str(Path(entry).absolute()) for entry in entries]}
        read_end, write_end = _lifeline()
        try:
            self.process = _start(setup, read_end, environ)
        except BaseException:
            os.close(write_end)
            raise
        finally:
            os.close(read_end)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.requests: IO[bytes] = self.process.stdin
        self.replies: IO[bytes] = self.process.stdout
        self._lifeline = os.fdopen(write_end, "wb")

    def send(self, message: bytes) -> None:
        """Send a pickled request; raises `WorkerDiedError`."""
        try:
            send(self.requests, message)
        except OSError:
            raise self._died() from None

    def receive(self) -> tuple[bool, Any]:
        """Wait for a reply: True and the result, or False and the exception.

        Raises `WorkerDiedError`.
        """
        try:
            return receive_result(self.replies)
        except (EOFError, OSError):
            raise self._died() from None

    def close(self) -> None:
        """Kill the process if it runs, and close all pipes."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.requests, self.replies, self._lifeline):
            with suppress(OSError):  # data that can no longer be written
                pipe.close()

    def _died(self) -> WorkerDiedError:
        return WorkerDiedError(f"{self.name} {self._describe_end()}")

    def _describe_end(self) -> str:
        """How the process ended, for a message: "was killed by signal 9 (SIGKILL)"."""
        try:
            code = self.process.wait(_WAIT)
        except subprocess.TimeoutExpired:
            return "stopped answering"
        if code >= 0:
            return f"ended with exit status {code}"
        name = f" ({signal.Signals(-code).name})" if -code in set(signal.Signals) else ""
        return f"was killed by signal {-code}{name}"


def _lifeline() -> tuple[int, int]:
    """A pipe, never at descriptors 0 to 2, even if free: a child has its standard streams there."""
    read_end, write_end = os.pipe()
    return above_standard(read_end), above_standard(write_end)


def above_standard(descriptor: int) -> int:
    """The same file at a descriptor above 2; if the given one is not, it is closed."""
    if sys.platform == "win32" or descriptor > 2:
        return descriptor
    import fcntl

    above = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 3)
    os.close(descriptor)
    return above


def _start(
    setup: dict[str, Any], lifeline: int, environ: Mapping[str, str]
) -> "subprocess.Popen[bytes]":
    platform: dict[str, Any]
    # A process group of its own keeps a terminal's Ctrl-C away while the interpreter starts.
    if sys.platform == "win32":
        import msvcrt

        lifeline = msvcrt.get_osfhandle(lifeline)
        os.set_handle_inheritable(lifeline, True)
        platform = {
            "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP,
            "startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [lifeline]}),
        }
    else:
        platform = {"process_group": 0, "pass_fds": (lifeline,)}
    return subprocess.Popen(
        # -P: the folder of the file that is run is not put on `sys.path`.
        [sys.executable, "-P", str(_START), json.dumps({**setup, "lifeline": lifeline})],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, **_ONE_THREAD, **environ},
        **platform,
    )
