"""A worker process: it owns some worlds and steps them when told.

Requests come in on a pipe, replies go out on another; arrays travel in shared memory only. A
message is one byte, its kind, and for all but the two of a plain step a length and JSON. When the
pipe of requests closes, because the parent closed it or is gone, the worker ends.
"""

import contextlib
import gc
import json
import os
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from magical.envs.episode import Episode
from magical.envs.vector.buffers import VectorBuffers, open_memory
from magical.envs.vector.sub_envs import SubEnvs, VectorSpec
from magical.processes import describe
from magical.scene.actions import NOOP
from magical.scene.scene import Dynamics, Scene
from magical.tasks import load_tasks

STEP, CALL = b"s", b"c"  # requests
DONE, RESULT, ERROR = b".", b"r", b"!"  # replies
_BARE = (STEP, DONE)  # kinds without data
# pymunk leaves worlds that have ended, some 80 kB each, to the garbage collector, which by itself
# would come only after a few hundred.
EPISODES_KEPT = 16
_LENGTH = struct.Struct("!I")


def encode(kind: bytes, data: Any = None) -> bytes:
    """A message's bytes; scenes, dynamics and numpy's scalars become plain data."""
    if kind in _BARE:
        return kind
    text = json.dumps(data, default=_plain).encode()
    return kind + _LENGTH.pack(len(text)) + text


def send(descriptor: int, message: bytes) -> None:
    """Write a message; raises `BrokenPipeError` if nobody reads it any more."""
    rest = memoryview(message)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def receive(descriptor: int) -> tuple[bytes, Any]:
    """Wait for a message and return its kind and data; raises `EOFError` if none can come."""
    kind = _read(descriptor, 1)
    if kind in _BARE:
        return kind, None
    (length,) = _LENGTH.unpack(_read(descriptor, _LENGTH.size))
    return kind, json.loads(_read(descriptor, length))


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
    begun = 0
    while True:
        kind, request = receive(requests)
        try:
            if kind == STEP:
                result: Any = sub_envs.step()
            else:
                result = getattr(sub_envs, request["call"])(*request["args"])
            reply = encode(RESULT, result) if result else encode(DONE)
            begun += len(result) if isinstance(result, list) else 0
        except Exception as error:
            reply = encode(ERROR, describe(error))
        send(replies, reply)
        if begun >= EPISODES_KEPT:
            gc.collect()
            begun = 0


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
    """Take one step in an episode that is thrown away, so that everything needed is loaded."""
    variant, observation_spec = spec.env_ids[0].variant, spec.observation_spec()
    episode = Episode(spec.tasks()[0], variant, observation_spec, spec.horizon, spec.reward)
    with contextlib.suppress(Exception):  # an error here will be raised again by the first reset
        episode.start(np.random.default_rng(0))
        episode.step(NOOP)


def _plain(value: Any) -> Any:
    if isinstance(value, Scene):
        return value.to_dict(exact=True)
    if isinstance(value, Dynamics):
        return value.to_dict()
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"expected plain data, found {value!r}")


def _read(descriptor: int, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = os.read(descriptor, size - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data
