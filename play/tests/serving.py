"""A server on loopback, and players without a browser."""

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from magical.envs import EnvId
from magical_play.players import Players
from magical_play.security import make_guard
from magical_play.server import PlayServer, listen, make_server

TOKEN = "a-token-of-the-tests"
TIMEOUT = 60.0  # s


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request."""

    status: int
    headers: dict[str, str]
    body: bytes


class RunningServer:
    """A server in a thread of this process."""

    def __init__(self, port: int, players: Players) -> None:
        self.port = port
        self.players = players
        self.host = f"127.0.0.1:{port}"

    def get(
        self,
        path: str,
        method: str = "GET",
        token: str | None = TOKEN,
        content: bytes | None = None,
        **headers: str,
    ) -> Answer:
        """Send one request; the path, which may have a query, is sent as it is."""
        client = http.client.HTTPConnection("127.0.0.1", self.port, timeout=TIMEOUT)
        joint = "&" if "?" in path else "?"
        target = path if token is None else f"{path}{joint}token={token}"
        client.request(method, target, content, {"Host": self.host, **headers})
        answer = client.getresponse()
        names = {name.lower(): value for name, value in answer.getheaders()}
        result = Answer(answer.status, names, answer.read())
        client.close()
        return result

    def connect(
        self, query: str = f"token={TOKEN}", origin: str | None = "", **headers: str
    ) -> ClientConnection:
        """Open the socket; the origin is the server's own unless another is given."""
        return connect(
            f"ws://{self.host}/socket?{query}",
            origin=f"http://{self.host}" if origin == "" else origin,  # type: ignore[arg-type]
            additional_headers=headers,
            proxy=None,
        )

    @contextmanager
    def player(self, session: str | None = None) -> Iterator["Player"]:
        """A player who has the first frame."""
        query = f"token={TOKEN}" + (f"&session={session}" if session else "")
        with self.connect(query) as socket:
            player = Player(socket)
            player.next_frame()
            yield player


class Player:
    """A player's end of the socket, which confirms every frame as the page does."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.held: list[str] = []
        self.frame = b""
        self.status: dict[str, Any] = {}
        self.session = json.loads(socket.recv(timeout=TIMEOUT))["session"]

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def hold(self, *controls: str) -> None:
        """Hold these controls and no others."""
        self.held = list(controls)
        self.send(type="keys", held=self.held, seen=0)

    def keep(self, demonstrator: str) -> None:
        """Keep the episode that has ended."""
        self.send(type="keep", demonstrator=demonstrator)
        self.wait_for(lambda status: status["kept"] == 1)

    def receive(self) -> dict[str, Any]:
        """The next status, when its frame has come too."""
        self.status = json.loads(self.socket.recv(timeout=TIMEOUT))
        frame = self.socket.recv(timeout=TIMEOUT)
        assert isinstance(frame, bytes)
        self.frame = frame
        return self.status

    def next_frame(self) -> dict[str, Any]:
        """The next status, whose frame is confirmed."""
        status = self.receive()
        self.send(type="keys", held=self.held, seen=status["number"])
        return status

    def wait_for(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first status of which the condition holds, the present one included."""
        while not condition(self.status):
            self.next_frame()
        return self.status


def close_code(socket: ClientConnection) -> int:
    """The code that the server closes a socket with, whatever it sends before."""
    with suppress(ConnectionClosed):
        while True:
            socket.recv(timeout=TIMEOUT)
    assert socket.close_code is not None
    return socket.close_code


@contextmanager
def running(**settings: Any) -> Iterator[RunningServer]:
    """A server on a free port of loopback that starts players in MoveToRegion."""
    with listen("127.0.0.1", 0) as listening:
        playing = PlayServer(
            make_guard("127.0.0.1", TOKEN), EnvId("MoveToRegion", "Demo"), **settings
        )
        server = make_server(playing.app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield RunningServer(listening.getsockname()[1], playing.players)
        finally:
            server.should_exit = True
            thread.join()
