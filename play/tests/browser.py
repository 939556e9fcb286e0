"""Headless Chromium, driven through its DevTools protocol."""

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
TIMEOUT = 60.0  # s for an answer
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
    # The browser itself has nothing to say to the network.
    "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-quic",
)  # fmt: skip


def find_browser() -> str | None:
    """The path of a browser, if one is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """A tab that shares nothing with others."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._calls, self._session = socket, 0, ""
        self.problems: list[str] = []  # what the page reports as errors
        self.context = self.call("Target.createBrowserContext")["browserContextId"]
        made = self.call("Target.createTarget", url="about:blank", browserContextId=self.context)
        found = self.call("Target.attachToTarget", targetId=made["targetId"], flatten=True)
        self._session = found["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call one method of the protocol; returns its result."""
        self._calls += 1
        request = {"id": self._calls, "method": method, "params": parameters}
        in_tab = {"sessionId": self._session} if self._session else {}
        self._socket.send(json.dumps({**request, **in_tab}))
        while True:
            answer = json.loads(self._socket.recv(timeout=TIMEOUT))
            if answer.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded"):
                self.problems.append(json.dumps(answer["params"]))
            if answer.get("id") == self._calls:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        options = {"expression": script, "awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", **options)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, condition: str) -> None:
        """Wait until an expression is true in the page."""
        script = f"new Promise(done => {{ const look = () => ({condition}) ? done(true) : "
        assert self.evaluate(script + "setTimeout(look, 20); look(); })")

    def key(self, key: str, *, down: bool) -> None:
        """Press a key or let it go."""
        code = {" ": "Space"}.get(key, key if len(key) > 1 else f"Key{key.upper()}")
        event = {"type": "keyDown" if down else "keyUp", "key": key, "code": code}
        if down and len(key) == 1:
            event["text"] = key
        self.call("Input.dispatchKeyEvent", **event)

    def tap(self, key: str) -> None:
        """Press a key and let it go."""
        self.key(key, down=True)
        self.key(key, down=False)


@contextmanager
def start_browser(program: str, folder: Path) -> Iterator[Tab]:
    """A tab of a browser that keeps its files in a folder, ended with the block."""
    command = [program, *FLAGS, f"--user-data-dir={folder}", "--remote-debugging-port=0"]
    environment = {**os.environ, "HOME": str(folder), "TMPDIR": str(folder)}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        line = next(line for line in process.stderr if "DevTools listening on" in line)
        with connect(line.split()[-1], max_size=None, ping_interval=None) as socket:
            yield Tab(socket)
    finally:
        process.kill()
        process.communicate()
