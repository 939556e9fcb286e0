"""Headless Chromium, driven through its DevTools protocol."""

import json
import os
import shutil
import subprocess
from contextlib import contextmanager

from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
TIMEOUT = 60.0  # s for an answer
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
    # The browser itself has nothing to say to the network.
    "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-quic",
)  # fmt: skip


def find_browser():
    """The path of a browser, if one is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """A tab that shares nothing with others."""

    def __init__(self, socket):
        self._socket, self._calls, self._session = socket, 0, ""
        self.problems = []  # what the page reports as errors
        context = self.call("Target.createBrowserContext")["browserContextId"]
        made = self.call("Target.createTarget", url="about:blank", browserContextId=context)
        found = self.call("Target.attachToTarget", targetId=made["targetId"], flatten=True)
        self._session = found["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
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
                return answer["result"]

    def evaluate(self, script):
        """The value of a JavaScript expression; promises are awaited."""
        options = {"expression": script, "awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", **options)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, condition):
        """Wait until an expression is true in the page."""
        script = f"new Promise(done => {{ const look = () => ({condition}) ? done(true) : "
        assert self.evaluate(script + "setTimeout(look, 20); look(); })")

    def key(self, key, *, down):
        """Press a key or let it go."""
        code = {" ": "Space"}.get(key, key if len(key) > 1 else f"Key{key.upper()}")
        event = {"type": "keyDown" if down else "keyUp", "key": key, "code": code}
        if down and len(key) == 1:
            event["text"] = key
        self.call("Input.dispatchKeyEvent", **event)

    def tap(self, *keys):
        """Press each key and let it go."""
        for key in keys:
            self.key(key, down=True)
            self.key(key, down=False)


@contextmanager
def start_browser(program, folder):
    """A tab of a browser that keeps its files in a folder, ended with the block."""
    command = [program, *FLAGS, f"--user-data-dir={folder}", "--remote-debugging-port=0"]
    env = {**os.environ, "HOME": str(folder), "TMPDIR": str(folder)}
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, env=env, text=True, **pipes)
    try:
        line = next(line for line in process.stderr if "DevTools listening on" in line)
        with connect(line.split()[-1], max_size=None, ping_interval=None) as socket:
            yield Tab(socket)
    finally:
        process.kill()
        process.communicate()
