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
TIMEOUT = 30.0  # s for an answer
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage")


def find_browser() -> str | None:
    """The path of a browser, if one is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """One tab of the browser."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._calls = 0
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        self.problems: list[str] = []  # what the page reports as errors
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call one method of the protocol and wait for its result."""
        self._calls += 1
        request = {"id": self._calls, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        self._socket.send(json.dumps(request))
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

    def resize(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Give the page this size, in CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if mobile else 1,
            mobile=mobile,
        )


@contextmanager
def open_tab(browser: str, folder: Path) -> Iterator[Tab]:
    """A tab of a new browser that keeps its files in a folder; both end with the block."""
    command = [browser, *FLAGS, f"--user-data-dir={folder}", "--remote-debugging-port=0"]
    environment = {**os.environ, "HOME": str(folder)}
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
