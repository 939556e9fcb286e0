"""The server over real connections: what is refused, recording, lost and replaced connections."""

import errno
import json
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from magical.demos import Dataset, DatasetWriter
from magical.demos.replay import replay
from magical.errors import DatasetError
from magical_play import policies
from magical_play.messages import MAX_BYTES
from magical_play.security import HEADERS
from magical_play.server import PAGE, PAGE_FILES, REPLACED
from play.tests.serving import TOKEN, Page, RunningServer, close_code

SEED = 5  # of the scenes that are played


def play(page: Page, env_id: str) -> dict[str, Any]:
    """Play an episode to its end, holding one key; returns its last status."""
    page.hold()
    page.send(type="start", env_id=env_id, seed=SEED, policy=None)
    page.wait_for(lambda status: status["phase"] == "ready" and status["seed"] == SEED)
    page.hold("forward", "right")
    return page.wait_for(lambda status: status["phase"] == "ended")


# What is sent to whom


def test_the_page_is_sent_with_headers_that_protect_it(server: RunningServer) -> None:
    assert {name for name, _ in PAGE_FILES.values()} == {file.name for file in PAGE.iterdir()}
    for path, (name, media_type) in PAGE_FILES.items():
        status, headers, body = server.get(path, token=None)
        assert (status, body) == (200, (PAGE / name).read_bytes())
        assert headers["content-type"].startswith(media_type)
        assert {name.lower(): value for name, value in HEADERS.items()}.items() <= headers.items()


@pytest.mark.parametrize("token", [None, "", "wrong", TOKEN[:-1], TOKEN + "x"])
def test_without_the_token_nothing_but_the_page_is_sent(
    server: RunningServer, token: str | None
) -> None:
    assert server.get("/elsewhere", token=token)[0] == 403
    assert server.get("/", "POST", token=token, Origin=f"http://{server.host}")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        server.connect("" if token is None else f"token={token}")


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://127.0.0.1:1"])
def test_sockets_of_other_origins_are_refused(server: RunningServer, origin: str | None) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        server.connect(origin=origin)
    if origin:
        assert server.get("/", Origin=origin)[0] == 403


def test_other_hosts_are_refused(server: RunningServer) -> None:
    assert server.get("/", Host="evil.example")[0] == 403
    socket = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Origin": "http://evil.example",
    }
    assert server.get("/socket", Host="evil.example", **socket)[0] == 403


@pytest.mark.parametrize(
    "path",
    [
        *("/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd"),
        *("/..\\server.py", "/index.html%00.css", "/main.js/../../server.py"),
    ],
)
def test_no_path_leads_out_of_the_page(server: RunningServer, path: str) -> None:
    assert server.get(path)[0] == 404
    assert server.get(path, token=None)[0] == 403


def test_a_message_that_is_too_long_ends_the_connection(server: RunningServer) -> None:
    with server.page() as page:
        page.socket.send(json.dumps({"type": "seek", "step": 1}) + " " * MAX_BYTES)
        assert close_code(page.socket) == 1009


def test_malformed_messages_are_said_and_change_nothing(server: RunningServer) -> None:
    with server.page() as page:
        frame = page.frame
        for message in (b"\x00\x01", "{", '{"type": "keys"}'):
            page.socket.send(message)
        page.wait_for(lambda status: "expected the field held" in status["notice"])
        assert (page.status["phase"], page.frame) == ("ready", frame)


# Recording


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("task", ["MoveToRegion", "FixColour"])
def test_what_is_kept_replays_bit_equally(server: RunningServer, dataset: Path, task: str) -> None:
    with server.page() as page:
        played = play(page, f"magical/{task}-TestJitter-v0")
        page.send(type="keep", demonstrator="Ada")
        page.wait_for(lambda status: status["kept"] == 1)
    (stored,) = Dataset.open(dataset)
    assert (stored.env_id, stored.seed, stored.demonstrator) == (played["env_id"], SEED, "Ada")
    assert (len(stored), f"{stored.score:.2f}") == (played["length"], played["facts"]["Score"])
    assert stored.actions[0] > 0
    assert replay(stored).departure == 0.0


@pytest.mark.usefixtures("fast")
def test_a_full_disk_is_said_and_the_episode_can_be_kept_later(
    server: RunningServer, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> Any:
        raise DatasetError(f"cannot write {dataset}: {OSError(errno.ENOSPC, 'No space left')}")

    with server.page() as page:
        play(page, "magical/MoveToRegion-Demo-v0")
        with monkeypatch.context() as patch:
            patch.setattr(DatasetWriter, "append", full)
            page.send(type="keep", demonstrator="Ada")
            status = page.wait_for(lambda status: "No space left" in status["notice"])
        assert (status["phase"], status["kept"], status["can_keep"]) == ("ended", 0, True)
        page.send(type="keep", demonstrator="Ada")
        page.wait_for(lambda status: status["kept"] == 1)
    assert len(Dataset.open(dataset)) == 1


# Connections


def test_a_lost_connection_pauses_the_episode_until_a_page_is_there_again(
    server: RunningServer,
) -> None:
    with server.page() as page:
        page.hold("forward")
        page.wait_for(lambda status: status["steps"] == 2)
        seed = page.status["seed"]
    with server.page() as page:
        assert (page.status["phase"], page.status["seed"]) == ("paused", seed)
        assert page.status["steps"] >= 2
        page.hold("forward")
        page.wait_for(lambda status: status["phase"] == "playing")


def test_a_second_page_replaces_the_first(server: RunningServer) -> None:
    with server.page() as first, server.page() as second:
        assert close_code(first.socket) == REPLACED
        second.send(type="show", view="ego", speed=1)
        second.wait_for(lambda status: status["view"] == "ego")


# Policies


def test_the_expert_is_watched_in_a_thread_and_solves_the_task(
    fast: None, server: RunningServer
) -> None:
    with server.page() as page:
        page.send(type="start", env_id="MoveToRegion-Demo-v0", seed=SEED, policy=0)
        status = page.wait_for(lambda status: status["phase"] == "ended")
        assert (status["policy_name"], status["facts"]["Score"]) == ("expert", "1.00")


def test_a_policy_that_cannot_be_loaded_is_said(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise DatasetError("the weights are gone")

    monkeypatch.setattr(policies, "expert_for", fail)
    with server.page() as page:
        page.send(type="start", env_id="MoveToRegion-Demo-v0", seed=SEED, policy=0)
        status = page.wait_for(lambda status: "the weights are gone" in status["notice"])
        assert (status["policy"], status["phase"], status["seed"]) == (None, "ready", SEED)
