"""Latency from key to frame, and frames per second, of `magical play` with several players.

python benchmarks/play.py --players 1 4 16 --seconds 10
python benchmarks/play.py --players 1 --delay 0.1
python benchmarks/play.py --players 1 --rollouts

Players connect over loopback, or with `--delay` through a proxy that holds back everything for so
many seconds in each direction. Each holds keys, changes them at random times and confirms every
frame, as the page does. The latency is from sending a change to the first frame after a step that
executed it. The environment steps every 125 ms, so a key waits for 62 ms on average, whatever the
server does; the second latency is without that wait: of messages that take effect at once, here
changes of the view. With `--rollouts` the page is looked on meanwhile: the expert is rolled out
without pause.
"""

import argparse
import asyncio
import json
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
from websockets.asyncio.client import ClientConnection, connect

TURNS = ("left", "right")
VIEWS = ("allo", "ego")
ENV = "magical/ClusterColour-Demo-v0"  # the longest episodes


@dataclass
class Measured:
    """What one or all players saw, in seconds."""

    steps: list[float] = field(default_factory=list)  # from a key to a frame with its action
    views: list[float] = field(default_factory=list)  # from a choice of view to its frame
    intervals: list[float] = field(default_factory=list)  # between frames while playing
    frames: int = 0
    size: int = 0  # bytes of all frames


@contextmanager
def serve(players: int) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """A server in a process of its own: the process, its port and token."""
    options = ["--port", "0", "--env", ENV, "--max-players", str(players)]
    command = [sys.executable, "-m", "magical", "play", *options]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        url = urlsplit(process.stdout.readline().strip())
        assert url.port is not None
        yield process, url.port, parse_qs(url.query)["token"][0]
    finally:
        process.terminate()
        process.communicate()


def wait_for(port: int) -> None:
    """Wait until the server answers: its renderer is then compiled."""
    urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=120).read()


def processor_time(process_id: int) -> float:
    """Seconds of processor time that a process has used (Linux)."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


async def delayed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay: float) -> None:
    """Copy a stream, each piece `delay` seconds late."""
    pieces: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def write() -> None:
        while True:
            due, piece = await pieces.get()
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            writer.write(piece)
            await writer.drain()

    task = asyncio.create_task(write())
    while piece := await reader.read(1 << 16):
        pieces.put_nowait((time.perf_counter() + delay, piece))
    task.cancel()
    writer.close()


async def start_proxy(port: int, delay: float) -> int:
    """Delay all connections to a port; returns the port to connect to instead."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        up, down = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(delayed(reader, down, delay), delayed(up, writer, delay))

    proxy = await asyncio.start_server(handle, "127.0.0.1", 0)
    chosen: int = proxy.sockets[0].getsockname()[1]
    return chosen


class Player:
    """Plays one session for a time and measures it."""

    def __init__(self, socket: ClientConnection, rng: np.random.Generator) -> None:
        self.socket, self.rng = socket, rng
        self.measured = Measured()
        self._held = TURNS[0]
        self._view = VIEWS[0]
        self._pressed_at: float | None = None
        self._viewed_at: float | None = None
        self._last: float | None = None

    async def play(self, seconds: float) -> Measured:
        """Play for so many seconds."""
        await self.socket.recv()  # the greeting
        await self._send(type="keys", held=[self._held], seen=0)
        changes = asyncio.create_task(self._change())
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            status = json.loads(await self.socket.recv())
            frame = await self.socket.recv()
            self._note(status, len(frame))
            held = [self._held]
            if status["phase"] != "playing":  # a new episode begins with a new key
                await self._send(type="restart")
                await self._send(type="keys", held=[], seen=status["number"])
            await self._send(type="keys", held=held, seen=status["number"])
        changes.cancel()
        return self.measured

    def _note(self, status: dict[str, object], size: int) -> None:
        now = time.perf_counter()
        self.measured.frames += 1
        self.measured.size += size
        if self._last is not None and self._viewed_at is None:
            self.measured.intervals.append(now - self._last)
        self._last = now if self._viewed_at is None else None
        if self._pressed_at is not None and status["executed"] == [self._held]:
            self.measured.steps.append(now - self._pressed_at)
            self._pressed_at = None
        if self._viewed_at is not None and status["view"] == self._view:
            self.measured.views.append(now - self._viewed_at)
            self._viewed_at, self._last = None, None

    async def _change(self) -> None:
        while True:
            await asyncio.sleep(self.rng.uniform(0.4, 0.8))
            if self._pressed_at is not None or self._viewed_at is not None:
                continue
            now = time.perf_counter()
            if self.rng.random() < 0.5:
                self._held = TURNS[1 - TURNS.index(self._held)]
                self._pressed_at = now
                await self._send(type="keys", held=[self._held], seen=0)
            else:
                self._view = VIEWS[1 - VIEWS.index(self._view)]
                self._viewed_at = now
                await self._send(type="view", view=self._view)

    async def _send(self, **message: object) -> None:
        await self.socket.send(json.dumps(message))


async def play_all(port: int, token: str, players: int, seconds: float, delay: float) -> Measured:
    """Let all players play at once; what they measured, together."""
    port = await start_proxy(port, delay) if delay else port
    address = f"ws://127.0.0.1:{port}/socket?token={token}"

    async def play(number: int) -> Measured:
        origin = f"http://127.0.0.1:{port}"
        async with connect(address, origin=origin, proxy=None) as socket:  # type: ignore[arg-type]
            return await Player(socket, np.random.default_rng(number)).play(seconds)

    total = Measured()
    for one in await asyncio.gather(*map(play, range(players))):
        total.steps += one.steps
        total.views += one.views
        total.intervals += one.intervals
        total.frames += one.frames
        total.size += one.size
    return total


@contextmanager
def rolling_out(port: int, token: str) -> Iterator[None]:
    """Ask for one rollout of the expert after another, in a thread."""
    ended = threading.Event()
    body = json.dumps({"policy": 0, "env_id": ENV, "seed": None}).encode()
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}/api/rollouts?token={token}",
        body,
        {"Origin": f"http://127.0.0.1:{port}"},
    )

    def ask() -> None:
        while not ended.is_set():
            urllib.request.urlopen(request, timeout=120).read()

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def percentiles(seconds: list[float]) -> str:
    """Median and 99th percentile in milliseconds."""
    median, high = 1000 * np.percentile(seconds, [50, 99])
    return f"{median:6.1f} {high:7.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--players", type=int, nargs="+", default=[1, 4, 16], metavar="N")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each (default: 10)")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds, each way (default: 0)")
    parser.add_argument("--rollouts", action="store_true", help="roll out the expert meanwhile")
    args = parser.parse_args()
    print("           key to frame   view to frame  between frames  frames/s   server, ms  kB")
    print("players    median    99 %  median    99 %  median    99 %  a player   a frame  a frame")
    for players in args.players:
        with serve(players) as (process, port, token):
            wait_for(port)
            before = processor_time(process.pid)
            with rolling_out(port, token) if args.rollouts else nullcontext():
                found = asyncio.run(play_all(port, token, players, args.seconds, args.delay))
            used = processor_time(process.pid) - before
        print(
            f"{players:7}    {percentiles(found.steps)} {percentiles(found.views)} "
            f"{percentiles(found.intervals)}  {found.frames / players / args.seconds:8.2f}  "
            f"{1000 * used / found.frames:8.2f}  {found.size / found.frames / 1000:7.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
