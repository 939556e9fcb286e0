"""The web application: the page's files, and the WebSocket over which a session is played."""

import asyncio
import socket as sockets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from time import monotonic

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from magical.errors import MagicalError
from magical.render import warm_up
from magical_play.episodes import SAMPLES
from magical_play.messages import MAX_BYTES, MessageError, parse_message
from magical_play.policies import Driver
from magical_play.security import HEADERS, Guard, GuardMiddleware
from magical_play.session import Session

PAGE = Path(__file__).parent / "page"
PAGE_FILES = {
    "/": ("index.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    "/main.js": ("main.js", "text/javascript"),
    "/input.js": ("input.js", "text/javascript"),
}
SHUTDOWN_TIME = 2  # s that an open connection has to end
REPLACED = 4001  # the WebSocket's close code when the page was opened elsewhere


class PlayServer:
    """The application of a session, for one page at a time: a new one replaces another."""

    def __init__(self, guard: Guard, session: Session) -> None:
        self.session = session
        self._socket: WebSocket | None = None
        self._wake = asyncio.Event()  # there may be something to send
        self._asking: asyncio.Task[None] | None = None
        self.app = Starlette(
            # No route takes a file path from requests, so none can leave the page's folder.
            routes=[*map(_page_route, PAGE_FILES), WebSocketRoute("/socket", self._play)],
            lifespan=self._lifespan,
            middleware=[Middleware(GuardMiddleware, guard=guard, public=PAGE_FILES)],
        )

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(self._run_clock()), asyncio.create_task(self._send())]
        yield
        for task in tasks:
            task.cancel()

    async def _play(self, socket: WebSocket) -> None:
        """Follow the messages of one page until it leaves or is replaced."""
        await socket.accept()
        self.session.joined()
        replaced, self._socket = self._socket, socket
        self._wake.set()
        if replaced:
            with suppress(RuntimeError):  # meanwhile closed by its page
                await replaced.close(REPLACED)
        while (event := await socket.receive())["type"] != "websocket.disconnect":
            if self._socket is not socket:
                continue
            try:
                message = parse_message(event.get("text") or "")  # empty: a binary message
                self.session.handle(message, monotonic())
            except MessageError as error:
                self.session.note_problem(error)
            self._wake.set()
        if self._socket is socket:
            self._socket = None
            self.session.pause()

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            with suppress(WebSocketDisconnect, RuntimeError):  # closed; `_play` notes it
                while (socket := self._socket) and (parts := self.session.take_update(monotonic())):
                    for part in parts:
                        kind = "text" if isinstance(part, str) else "bytes"
                        await socket.send({"type": "websocket.send", kind: part})

    async def _run_clock(self) -> None:
        while True:
            await asyncio.sleep(max(0.0, self.session.step_at - monotonic()))
            self.session.advance(monotonic())
            if driver := self.session.take_question():
                self._asking = asyncio.create_task(self._ask(driver))
            self._wake.set()

    async def _ask(self, driver: Driver) -> None:
        await asyncio.to_thread(driver.ask)  # a network or a planner must not hold up the page
        self.session.changes += 1
        self._wake.set()


def _page_route(path: str) -> Route:
    name, kind = PAGE_FILES[path]
    return Route(path, Response((PAGE / name).read_bytes(), media_type=kind), methods=["GET"])


def listen(host: str, port: int) -> sockets.socket:
    """A socket that listens on an address; raises `MagicalError` if that is impossible."""
    try:
        family = sockets.AF_INET6 if ":" in host else sockets.AF_INET
        dual = host == "::" and sockets.has_dualstack_ipv6()
        listening = sockets.create_server((host, port), family=family, dualstack_ipv6=dual)
        # asyncio disables Nagle's algorithm only if the socket's protocol is stated to be TCP.
        tcp = (family, sockets.SOCK_STREAM, sockets.IPPROTO_TCP)
        return sockets.socket(*tcp, fileno=listening.detach())
    except (OSError, OverflowError) as error:
        raise MagicalError(
            f"cannot listen on {host}, port {port}: {error}; choose another --host or --port (0 "
            "takes a free port)"
        ) from error


def make_server(app: Starlette) -> uvicorn.Server:
    """The server for an application: `run(sockets=[listening])` serves until it is stopped.

    The renderer is compiled, or loaded from the cache, here, so that no visitor waits for it later.
    """
    warm_up(SAMPLES)
    config = uvicorn.Config(
        app,
        lifespan="on",
        log_level="warning",
        access_log=False,  # it would contain the token
        server_header=False,
        headers=list(HEADERS.items()),
        proxy_headers=False,
        http="h11",
        ws="websockets-sansio",
        ws_max_size=MAX_BYTES,
        ws_per_message_deflate=False,  # frames are compressed already
        timeout_graceful_shutdown=SHUTDOWN_TIME,
    )
    return uvicorn.Server(config)
