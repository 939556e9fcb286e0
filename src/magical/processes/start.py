"""The first code that every child process runs. `Child` runs this file; nothing imports it.

Only the standard library is imported before `sys.path` is set to the parent's.
"""

import contextlib
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence


def main(module: str, path: Sequence[str], lifeline: int) -> None:
    """Set up this process, then run `module.main(requests, replies)`.

    Args:
        module: a module's name.
        path: `sys.path`.
        lifeline: the descriptor of a pipe (on Windows its handle) that the parent keeps open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    _end_with_parent(lifeline)
    sys.path[:] = path
    requests, replies = _take_pipes()
    serve = importlib.import_module(module).main
    with (
        contextlib.suppress(EOFError, BrokenPipeError),  # the parent has closed the pipes
        os.fdopen(requests, "rb") as incoming,
        os.fdopen(replies, "wb") as outgoing,
    ):
        serve(incoming, outgoing)


def _end_with_parent(lifeline: int) -> None:
    """End this process when the other end of the lifeline closes, that is, when the parent ends.

    A thread does so on every platform, as soon as it can run. On Linux the kernel does so too (by
    SIGIO, which ends a process), even while a call into compiled code keeps all threads waiting.
    """
    if sys.platform == "win32":
        import msvcrt

        lifeline = msvcrt.open_osfhandle(lifeline, os.O_RDONLY)
    elif sys.platform == "linux":
        import fcntl

        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        flags = fcntl.fcntl(lifeline, fcntl.F_GETFL)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, flags | os.O_ASYNC)
    threading.Thread(target=_exit_at_end_of, args=(lifeline,), daemon=True).start()


def _exit_at_end_of(pipe: int) -> None:
    os.read(pipe, 1)  # nothing is ever written
    os._exit(1)


def _take_pipes() -> tuple[int, int]:
    """Take standard input and output for the parent's messages; returns their new descriptors.

    What is printed goes to standard error, and standard input is empty.
    """
    requests, replies = os.dup(0), os.dup(1)
    os.dup2(2, 1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    return requests, replies


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
