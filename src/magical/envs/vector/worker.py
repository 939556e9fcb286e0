"""A worker process: it owns some of the sub-environments and steps them on request.

Requests come in on a pipe, replies go out on another; arrays travel in shared memory only. A
message is one byte, its kind, and for all but the two of a plain step a length and JSON. When the
pipe of requests closes, because the parent closed it or has ended, the worker ends.
"""

import contextlib
import gc
import json
import os
import select
import struct
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from magical.envs.episode import Episode
from magical.envs.vector.buffers import VectorBuffers, open_memory
from magical.envs.vector.sub_envs import SubEnvs, VectorSpec
from magical.messages import quoted
from magical.processes import describe
from magical.scene.actions import NOOP
from magical.scene.scene import Dynamics, Scene
from magical.tasks import load_tasks

STEP, CALL = b"s", b"c"  # requests
DONE, RESULT, ERROR = b".", b"r", b"!"  # replies
_BARE = (STEP, DONE)  # kinds without data
# pymunk leaves the spaces of past episodes, some 80 kB each, to the garbage collector, which by
# itself would run only after a few hundred.
EPISODES_KEPT = 16
_LENGTH = struct.Struct("!I")


def encode(kind: bytes, data: Any = None) -> bytes:
    """A message's bytes; scenes, dynamics and numpy's scalars become plain data."""
    if kind in _BARE:
        return kind
    text = json.dumps(data, default=_plain).encode()
    return kind + _LENGTH.pack(len(text)) + text


def send(descriptor: int, message: bytes, deadline: float | None = None) -> None:
    """Write a message.

    Args:
        descriptor: the writing end of a pipe.
        message: what `encode` returned.
        deadline: the latest value of `time.monotonic()`; None waits for ever.

    Raises:
        BrokenPipeError: the reading end is closed.
        TimeoutError: the pipe stayed full until the deadline.
    """
    rest = memoryview(message)
    while rest:
        if deadline is None:
            rest = rest[os.write(descriptor, rest) :]
        else:
            _wait(descriptor, select.POLLOUT, deadline)
            rest = rest[os.write(descriptor, rest[: select.PIPE_BUF]) :]  # never waits


def receive(descriptor: int, deadline: float | None = None) -> tuple[bytes, Any]:
    """Wait for a message and return its kind and data.

    Args:
        descriptor: the reading end of a pipe.
        deadline: as for `send`.

    Raises:
        EOFError: the writing end is closed.
        TimeoutError: the message was not complete at the deadline.
    """
    kind = _read(descriptor, 1, deadline)
    if kind in _BARE:
        return kind, None
    (length,) = _LENGTH.unpack(_read(descriptor, _LENGTH.size, deadline))
    return kind, json.loads(_read(descriptor, length, deadline))


def main(requests: int, replies: int) -> None:
    """Serve the parent until it closes the pipes; `RemoteSubEnvs` starts this in a child."""
    _, setup = receive(requests)
    try:
        sub_envs = _make_sub_envs(**setup)
    except Exception as error:
        send(replies, encode(ERROR, describe(error)))
        return
    # What is loaded by now stays; without it collections take a millisecond or two.
    gc.collect()
    gc.freeze()
    send(replies, encode(DONE))
    episodes = 0  # since the last collection
    while True:
        kind, request = receive(requests)
        try:
            if kind == STEP:
                result: Any = sub_envs.step()
            else:
                result = getattr(sub_envs, request["call"])(*request["args"])
            reply = encode(RESULT, result) if result else encode(DONE)
            episodes += len(result) if isinstance(result, list) else 0
        except Exception as error:
            reply = encode(ERROR, describe(error))
        send(replies, reply)
        if episodes >= EPISODES_KEPT:
            gc.collect()
            episodes = 0  # since the last collection


def _make_sub_envs(
    spec: dict[str, Any], rows: Sequence[int], handle: int | str, plugins: Sequence[str]
) -> SubEnvs:
    for plugin in plugins:
        load_tasks(plugin)
    checked = VectorSpec.from_dict(spec)
    layout = checked.layout()
    memory = open_memory(handle, layout.size)
    if isinstance(handle, int):
        os.close(handle)
    _warm_up(checked)
    return SubEnvs(checked, rows, VectorBuffers(layout, memory))


def _warm_up(spec: VectorSpec) -> None:
    """Take one step in an episode of no further use, so that everything needed is loaded."""
    variant, observation_spec = spec.env_ids[0].variant, spec.observation_spec()
    episode = Episode(spec.tasks()[0], variant, observation_spec, spec.horizon, spec.reward)
    with contextlib.suppress(Exception):  # an error here will be raised again by the first reset
        episode.start(np.random.default_rng(0))
        episode.step(NOOP)


def _plain(value: Any) -> Any:
    if isinstance(value, Scene):
        return value.to_dict()
    if isinstance(value, Dynamics):
        return value.to_dict()
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"expected plain data, found {quoted(value)}")


def _read(descriptor: int, size: int, deadline: float | None = None) -> bytes:
    data = b""
    while len(data) < size:
        if deadline is not None:
            _wait(descriptor, select.POLLIN, deadline)
        piece = os.read(descriptor, size - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


def _wait(descriptor: int, event: int, deadline: float) -> None:
    """Wait until a pipe can be read or written; raises `TimeoutError` at the deadline."""
    poll = select.poll()
    poll.register(descriptor, event)
    while not poll.poll(1000 * min(1.0, max(0.0, deadline - time.monotonic()))):
        if time.monotonic() >= deadline:
            raise TimeoutError
