"""The server over real connections: what is refused, recording, lost connections, faults."""

import errno
import json
import random
import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from magical.demos import Dataset, DatasetWriter
from magical.demos import dataset as datasets
from magical.demos.summary import replay
from magical.envs.keys import controls_of
from magical.experts import rollout
from magical.web import connection, security
from magical.web import session as session_module
from magical.web.connection import MAX_UNSEEN
from magical.web.messages import MAX_BYTES
from magical.web.security import HEADERS
from magical.web.server import PAGE, PAGE_FILES
from tests.web.serving import TIMEOUT, TOKEN, Player, RunningServer, close_code
from tests.web.test_messages import malformed

SEED = 5  # of the scenes that are played


def play(player: Player, env_id: str = "magical/MoveToRegion-Demo-v0") -> dict[str, Any]:
    """Play an episode to its end, holding one key; returns its last status."""
    player.hold()
    player.send(type="start", env_id=env_id, seed=SEED)
    player.wait_for(lambda status: status["phase"] == "ready" and status["seed"] == SEED)
    player.hold("forward", "right")
    return player.wait_for(lambda status: status["phase"] == "ended")


# What is sent to whom


def test_the_page_is_sent_with_headers_that_protect_it(server: RunningServer) -> None:
    for path, (name, media_type) in PAGE_FILES.items():
        answer = server.get(path, token=None)
        assert (answer.status, answer.body) == (200, (PAGE / name).read_bytes())
        assert answer.headers["content-type"].startswith(media_type)
        assert {name.lower(): value for name, value in HEADERS.items()}.items() <= (
            answer.headers.items()
        )


@pytest.mark.parametrize("token", [None, "", "wrong", TOKEN[:-1], TOKEN + "x"])
def test_without_the_token_nothing_but_the_page_is_sent(
    server: RunningServer, token: str | None
) -> None:
    assert server.get("/api/library", token=token).status == 403
    assert server.get("/elsewhere", token=token).status == 403
    with pytest.raises(InvalidStatus, match="403"):
        server.connect("" if token is None else f"token={token}")


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://127.0.0.1:1"])
def test_sockets_of_other_origins_are_refused(server: RunningServer, origin: str | None) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        server.connect(origin=origin)
    if origin:
        assert server.get("/api/library", Origin=origin).status == 403


@pytest.mark.parametrize(
    "path",
    [
        *("/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "//etc/passwd"),
        *("/..\\server.py", "/index.html%00.css", "/play.js/../../server.py"),
    ],
)
def test_no_path_leads_out_of_the_page(server: RunningServer, path: str) -> None:
    assert server.get(path).status == 404
    assert server.get(path, token=None).status == 403


# Recording


def test_the_experts_keys_solve_the_task(server: RunningServer, dataset: Path) -> None:
    """In real time: keys change between two steps of the server's clock."""
    actions = rollout("MoveToRegion", "Demo", SEED).actions
    with server.player() as player:
        player.send(type="start", env_id="magical/MoveToRegion-Demo-v0", seed=SEED)
        player.wait_for(lambda status: status["seed"] == SEED)
        for number, action in enumerate(actions):
            player.held = list(controls_of(int(action)))
            player.send(type="keys", held=player.held, seen=player.status["number"])
            player.wait_for(lambda status, after=number: status["steps"] > after)  # type: ignore[misc]
        assert (player.status["phase"], player.status["score"]) == ("ended", 1.0)
        player.keep("Ada")
    (trajectory,) = Dataset.open(dataset)
    assert trajectory.score == 1.0


@pytest.mark.usefixtures("fast")
def test_a_discarded_episode_is_not_stored(server: RunningServer, dataset: Path) -> None:
    with server.player() as player:
        play(player)
        player.send(type="discard")
        assert player.wait_for(lambda status: status["phase"] == "ready")["kept"] == 0
    assert len(Dataset.open(dataset)) == 0


@pytest.mark.usefixtures("fast")
def test_several_people_play_at_once_and_what_they_keep_replays_bit_equally(
    server: RunningServer, dataset: Path
) -> None:
    tasks = ("MoveToRegion", "FixColour", "MoveToCorner")

    played = {}

    def record(task: str) -> None:
        with server.player() as player:
            played[task] = play(player, f"magical/{task}-TestJitter-v0")
            player.keep(task)

    threads = [threading.Thread(target=record, args=(task,)) for task in tasks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    stored = list(Dataset.open(dataset))
    assert sorted(t.demonstrator for t in stored) == sorted(tasks)
    for trajectory in stored:
        status = played[trajectory.demonstrator]
        assert (trajectory.env_id, trajectory.seed) == (status["env_id"], SEED)
        assert (len(trajectory), trajectory.score) == (status["horizon"], status["score"])
        assert trajectory.actions[0] > 0
    assert [replay(t).departure for t in stored] == [0.0] * 3


@pytest.mark.usefixtures("fast")
def test_a_full_disk_is_said_and_the_episode_can_be_kept_later(
    server: RunningServer, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    with server.player() as player:
        play(player)
        with monkeypatch.context() as patch:
            patch.setattr(datasets, "write_atomically", full)
            player.send(type="keep", demonstrator="Ada")
            status = player.wait_for(lambda status: "No space left" in status["notice"])
        assert (status["phase"], status["kept"]) == ("ended", 0)
        assert len(Dataset.open(dataset)) == 0
        player.keep("Ada")
    assert len(Dataset.open(dataset)) == 1


@pytest.mark.usefixtures("fast")
def test_a_lost_connection_does_not_stop_the_storing(
    server: RunningServer, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, lost = threading.Event(), threading.Event()
    append = DatasetWriter.append

    def slow(self: DatasetWriter, trajectory: Any) -> Any:
        begun.set()
        assert lost.wait(TIMEOUT)
        return append(self, trajectory)

    monkeypatch.setattr(DatasetWriter, "append", slow)
    with server.player() as player:
        play(player)
        player.send(type="keep", demonstrator="Ada")
        assert begun.wait(TIMEOUT)
        session = player.session
    lost.set()
    with server.player(session) as player:
        player.wait_for(lambda status: status["kept"] == 1)
    assert len(Dataset.open(dataset)) == 1


# Faults


def test_a_session_that_is_gone_is_said_to_be(server: RunningServer) -> None:
    with server.player("no-such-session") as player:
        assert "not resumed in time" in player.status["notice"]
        assert (player.status["phase"], player.status["steps"]) == ("ready", 0)


def test_a_second_tab_takes_over(server: RunningServer) -> None:
    with server.player() as first, server.player(first.session) as second:
        assert close_code(first.socket) == 4001
        second.send(type="view", view="ego")
        second.wait_for(lambda status: status["view"] == "ego")


def test_the_number_of_environments_is_limited(server: RunningServer) -> None:
    with (
        server.player() as first,
        server.player() as second,
        server.player(),
        server.connect() as socket,
    ):
        assert first.status["seed"] != second.status["seed"]
        assert first.session != second.session
        refused = json.loads(socket.recv(timeout=TIMEOUT))
        assert (refused["type"], "all 3 environments" in refused["reason"]) == ("refused", True)
        assert close_code(socket) == 4003


def test_idle_sessions_end(server: RunningServer, monkeypatch: pytest.MonkeyPatch) -> None:
    with server.player() as player:
        monkeypatch.setattr(session_module, "IDLE_TIME", 0.01)
        assert close_code(player.socket) == 4002
        monkeypatch.undo()
        session = player.session
    with server.player(session) as player:
        assert player.session != session


def test_a_flood_of_malformed_messages_changes_nothing(server: RunningServer) -> None:
    rng = random.Random(1)
    with server.player() as player:
        before, frame = dict(player.status), player.frame
        for _ in range(1000):
            player.socket.send(malformed(rng)[:MAX_BYTES])
        player.socket.send(b"\x00\x01")
    assert player.frame == frame
    with server.player(player.session) as player:
        assert {**player.status, "number": 0} == {**before, "number": 0}
        assert player.frame == frame


def test_a_message_that_is_too_long_ends_the_connection(server: RunningServer) -> None:
    with server.player() as player:
        player.socket.send(json.dumps({"type": "pause"}) + " " * MAX_BYTES)
        assert close_code(player.socket) == 1009


def test_a_page_that_confirms_no_frames_gets_no_more_of_them(server: RunningServer) -> None:
    with server.player() as player:
        (served,) = server.players
        player.hold("forward")
        while served.session.episode.steps < 3 * MAX_UNSEEN:
            server.get("/")  # lets some time pass
        numbers = [player.receive()["number"] for _ in range(MAX_UNSEEN)]
        player.send(type="keys", held=["forward"], seen=numbers[-1] + 10**6)
        assert player.receive()["steps"] >= 3 * MAX_UNSEEN  # those between were never sent


def test_starting_over_and_over_is_limited_and_disturbs_no_one(server: RunningServer) -> None:
    with server.player() as player, server.player() as other:
        for _ in range(500):
            player.send(type="restart")
        other.send(type="view", view="ego")
        other.wait_for(lambda status: status["view"] == "ego")
        player.send(type="keys", held=[], seen=player.status["number"])
        player.wait_for(lambda status: status["number"] > 1)
        assert player.status["number"] < 100


GET = b"GET /play.js HTTP/1.1\r\nHost: localhost\r\n"


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"", b""),
        (GET, b""),
        (GET + b"\r\n" + GET, b"200"),
        (GET + b"Upgrade: websocket\r\nConnection: Upgrade\r\n", b""),
        (
            b"POST /api/rollouts?token=%b HTTP/1.1\r\nHost: localhost\r\n"
            b"Origin: http://localhost\r\nContent-Length: 50\r\n\r\n{" % TOKEN.encode(),
            b"",
        ),
    ],
    ids=["nothing", "half the headers", "half of a second request", "half a handshake", "body"],
)
def test_a_request_that_does_not_arrive_is_given_up(
    server: RunningServer, sent: bytes, status: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(security, "REQUEST_TIME", 0.2)
    with socket.create_connection(("127.0.0.1", server.port), TIMEOUT) as client:
        client.sendall(sent)
        answer = b""
        with suppress(ConnectionResetError):
            while part := client.recv(1 << 16):
                answer += part
    assert answer.startswith(b"HTTP/1.1 " + status if status else b"")
    assert answer.count(b"HTTP/1.1") == bool(status)


def test_connections_that_are_used_outlive_the_deadlines(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(security, "REQUEST_TIME", 0.1)
    monkeypatch.setattr(connection, "FIRST_TIME", 0.1)
    with server.player() as player:
        player.hold("forward")
        player.wait_for(lambda status: status["steps"] == 5)  # half a second later


def test_a_socket_on_which_nothing_is_said_is_closed(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "FIRST_TIME", 0.1)
    with server.connect() as silent:
        assert close_code(silent) == 4004
