"""The web application: the page's files, a JSON API, and the WebSocket for playing."""

import asyncio
import json
import socket as sockets
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from time import monotonic

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from magical.demos.dataset import DatasetWriter
from magical.demos.trajectory import Trajectory
from magical.envs.ids import EnvId
from magical.errors import MagicalError, ServerError
from magical.render import warm_up
from magical.web import frames
from magical.web.connection import Close, Connection
from magical.web.library.routes import Library
from magical.web.messages import MAX_BYTES
from magical.web.players import Players
from magical.web.policies import Policies
from magical.web.security import HEADERS, Guard, GuardMiddleware, TimedProtocol
from magical.web.session import Session

PAGE = Path(__file__).parent / "page"
SCRIPTS = ("chart", "common", "grid", "input", "look", "main", "pane", "play")
PAGE_FILES = {
    "/": ("index.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in SCRIPTS},
}
SHUTDOWN_TIME = 2  # s that open connections have to end
DRIVING_THREADS = 2  # threads that call watched policies
SWEEP_TIME = 5.0  # s between checks for sessions that were not resumed in time


class PlayServer:
    """A server's application and the state that its routes share.

    Args:
        guard: decides which requests are answered.
        env_id: the environment in which a new player starts.
        record: the folder of the dataset to record into; `None`: nothing is recorded.
        max_players: the maximum number of sessions, each with its own environment.
        datasets: folders of datasets to view; the dataset being recorded is always listed.
        runs: run folders, or folders with run folders in them, whose policies can be watched.

    Raises:
        DatasetError: the recording folder cannot be written, or another folder holds no dataset.
        RunFolderError: a folder of runs does not exist.
    """

    def __init__(
        self,
        guard: Guard,
        env_id: EnvId,
        *,
        record: Path | None = None,
        max_players: int = 16,
        datasets: Sequence[Path] = (),
        runs: Sequence[Path] = (),
    ) -> None:
        recorded = [record] if record else []
        folders = {path.resolve(): path for path in [*datasets, *recorded]}
        policies = Policies(runs, [env_id.task])
        rng = np.random.default_rng()  # samples the seeds of scenes
        self._writer = DatasetWriter(record) if record else None
        self._saving: set[asyncio.Task[None]] = set()
        self._library = Library(list(folders.values()), policies)
        self._threads = ThreadPoolExecutor(DRIVING_THREADS, "driver")
        new_session = partial(Session, env_id, rng, policies, record is not None)
        self.players = Players(new_session, max_players)
        self.app = Starlette(
            routes=[  # none takes a file path from requests, so none can leave the page's folder
                *(Route(path, _page_file(*file)) for path, file in PAGE_FILES.items()),
                *self._library.routes(),
                WebSocketRoute("/socket", self._play),
            ],
            lifespan=self._lifespan,
            middleware=[Middleware(GuardMiddleware, guard=guard, public=PAGE_FILES)],
        )

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Regularly drop expired sessions; at the end, wait for episodes that are being stored."""
        sweep = asyncio.create_task(self._drop_expired())
        yield
        sweep.cancel()
        self._library.close()
        self._threads.shutdown(wait=True, cancel_futures=True)
        await asyncio.gather(*self._saving)

    async def _play(self, socket: WebSocket) -> None:
        """Play over a socket; the URL parameter `session` resumes the session with that key."""
        await socket.accept()
        try:
            key = socket.query_params.get("session")
            player = self.players.find_or_add(key, monotonic())
        except MagicalError as error:
            await socket.send_text(json.dumps({"type": "refused", "reason": str(error)}))
            await socket.close(Close.FULL)
            return
        if key and key != player.key:
            player.session.note_problem(
                "Your previous session was not resumed in time and has ended."
            )
        await socket.send_text(json.dumps({"type": "hello", "session": player.key}))
        reason = await Connection(socket, player, self._save, self._threads).run()
        if reason is Close.IDLE:
            self.players.remove(player)
        if reason is not None:
            with suppress(RuntimeError):  # meanwhile closed by the page
                await socket.close(reason)

    def _save(self, session: Session, trajectory: Trajectory) -> asyncio.Task[None]:
        """Start storing an episode in a thread; losing the connection does not stop it."""
        task = asyncio.create_task(self._store(session, trajectory))
        self._saving.add(task)
        task.add_done_callback(self._saving.discard)
        return task

    async def _store(self, session: Session, trajectory: Trajectory) -> None:
        assert self._writer is not None  # otherwise a session does not offer to keep anything
        try:
            await asyncio.to_thread(self._writer.append, trajectory)
        except MagicalError as error:
            session.not_stored(f"Not kept: {error}")
        else:
            session.stored()

    async def _drop_expired(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_TIME)
            self.players.drop_expired(monotonic())


def _page_file(name: str, media_type: str) -> Callable[[Request], Response]:
    content = (PAGE / name).read_bytes()
    return lambda _: Response(content, media_type=media_type)


def listen(host: str, port: int) -> sockets.socket:
    """A socket that listens on an address; port 0 picks a free port.

    Raises:
        ServerError: the address is not this machine's, or is in use.
    """
    try:
        family = sockets.AF_INET6 if ":" in host else sockets.AF_INET
        dual = host == "::" and sockets.has_dualstack_ipv6()
        listening = sockets.create_server((host, port), family=family, dualstack_ipv6=dual)
        # asyncio disables Nagle's algorithm only if the socket's protocol is stated to be TCP.
        tcp = (family, sockets.SOCK_STREAM, sockets.IPPROTO_TCP)
        return sockets.socket(*tcp, fileno=listening.detach())
    except (OSError, OverflowError) as error:
        raise ServerError(
            f"cannot listen on {host}, port {port}: {error}; choose another --host or --port (0 "
            "takes a free port)"
        ) from error


def make_server(app: Starlette) -> uvicorn.Server:
    """The server for an application: `run(sockets=[listening])` serves until it is stopped.

    The renderer is compiled, or loaded from the cache, here, so that the first player need not
    wait for it.
    """
    warm_up(frames.SAMPLES)
    config = uvicorn.Config(
        app,
        lifespan="on",
        log_level="warning",
        access_log=False,  # it would contain the token
        server_header=False,
        headers=list(HEADERS.items()),
        proxy_headers=False,
        http=TimedProtocol,
        ws="websockets-sansio",
        ws_max_size=MAX_BYTES,
        ws_per_message_deflate=False,  # frames are compressed already
        timeout_graceful_shutdown=SHUTDOWN_TIME,
    )
    return uvicorn.Server(config)
