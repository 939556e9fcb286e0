"""A server on loopback, and a page's end of its socket without a browser."""

import http.client
import json
from contextlib import contextmanager, suppress

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from magical.envs import EnvId

TOKEN = "a-token-of-the-tests"
TIMEOUT = 60.0  # s
ENV = EnvId("MoveToRegion", "Demo")


class RunningServer:
    """A server in a thread of this process."""

    def __init__(self, port, session):
        self.session, self.host = session, f"127.0.0.1:{port}"
        self.origin = f"http://{self.host}"

    def get(self, path, method="GET", token=TOKEN, **headers):
        """Send one request; returns status, headers and body. The path is sent as it is."""
        client = http.client.HTTPConnection(self.host, timeout=TIMEOUT)
        target = path if token is None else f"{path}?token={token}"
        client.request(method, target, None, {"Host": self.host, **headers})
        answer = client.getresponse()
        names = {name.lower(): value for name, value in answer.getheaders()}
        result = answer.status, names, answer.read()
        client.close()
        return result

    def connect(self, query=f"token={TOKEN}", origin=""):
        """Open the socket; the origin is the server's own unless another is given."""
        named = self.origin if origin == "" else origin
        return connect(f"ws://{self.host}/socket?{query}", origin=named, proxy=None)

    @contextmanager
    def page(self):
        """A page that has the first frame."""
        with self.connect() as socket:
            page = Page(socket)
            page.wait_for(lambda _: True)
            yield page


class Page:
    """A page's end of the socket, which confirms every frame."""

    def __init__(self, socket):
        self.socket, self.held, self.frame, self.status = socket, [], b"", {}

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def hold(self, *controls):
        """Hold these controls and no others."""
        self.held = list(controls)
        self.send(type="keys", held=self.held, seen=0)

    def wait_for(self, condition):
        """The first status of which the condition holds, the present one included."""
        while not self.status or not condition(self.status):
            message = json.loads(self.socket.recv(timeout=TIMEOUT))
            if message["type"] == "status":
                self.status, self.frame = message, self.socket.recv(timeout=TIMEOUT)
                self.send(type="keys", held=self.held, seen=message["number"])
        return self.status


def close_code(socket):
    """The code that the server closes a socket with, whatever it sends before."""
    with suppress(ConnectionClosed):
        while True:
            socket.recv(timeout=TIMEOUT)
    return socket.close_code
