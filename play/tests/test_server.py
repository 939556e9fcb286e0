"""The server over real connections: what is refused, lost and replaced connections, policies."""

import json

import pytest
from websockets.exceptions import InvalidStatus

from magical_play import session
from magical_play.messages import MAX_BYTES
from magical_play.security import HEADERS, make_guard, page_url
from magical_play.server import PAGE, PAGE_FILES, REPLACED
from play.tests.serving import TOKEN, close_code


@pytest.mark.parametrize(
    ("guard", "accepted", "refused"),
    [
        (
            make_guard("127.0.0.1", "token"),
            ("127.0.0.1:8000", "localhost", "localhost:1", "[::1]:8000"),
            ("", "evil.example", "127.0.0.1.evil.example", "10.0.0.1", "127.0.0.1:x", "[::1", "@"),
        ),
        (make_guard("LAB.example", "token"), ("lab.example:8000",), ("evil.example",)),
        (
            make_guard("0.0.0.0", "secret", frozenset({"Lab.example"})),
            ("10.0.0.1:8000", "[fe80::1]", "lab.example:80", "localhost"),
            ("evil.example",),
        ),
    ],
)
def test_hosts(guard, accepted, refused):
    assert [guard.accepts_host({"host": host}) for host in accepted] == [True] * len(accepted)
    assert [guard.accepts_host({"host": host}) for host in refused] == [False] * len(refused)
    assert not guard.accepts_host({})


def test_the_address_of_the_page():
    assert page_url("127.0.0.1", 81, "t") == "http://127.0.0.1:81/?token=t"
    assert page_url("::1", 81, "t") == "http://[::1]:81/?token=t"


def test_the_page_is_sent_with_headers_that_protect_it(server):
    assert {name for name, _ in PAGE_FILES.values()} == {file.name for file in PAGE.iterdir()}
    for path, (name, media_type) in PAGE_FILES.items():
        status, headers, body = server.get(path, token=None)
        assert (status, body) == (200, (PAGE / name).read_bytes())
        assert headers["content-type"].startswith(media_type)
        assert {name.lower(): value for name, value in HEADERS.items()}.items() <= headers.items()


@pytest.mark.parametrize("token", [None, "", "wrong", TOKEN[:-1], TOKEN + "x"])
def test_without_the_token_nothing_but_the_page_is_sent(server, token):
    assert server.get("/elsewhere", token=token)[0] == 403
    assert server.get("/", "POST", token=token, Origin=server.origin)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        server.connect("" if token is None else f"token={token}")


@pytest.mark.parametrize(
    "origin",
    [None, "null", "http://evil.example", "http://127.0.0.1:1", "http://HOST.evil", "file://HOST"],
)
def test_other_origins_are_refused(server, origin):
    origin = origin and origin.replace("HOST", server.host)
    with pytest.raises(InvalidStatus, match="403"):
        server.connect(origin=origin)
    named = {} if origin is None else {"Origin": origin}
    assert server.get("/", "GET" if named else "POST", **named)[0] == 403


def test_other_hosts_are_refused(server):
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    upgrade |= {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Origin": "http://evil.example"}
    for path, headers in (("/", {}), ("/socket", upgrade)):
        assert server.get(path, Host="evil.example", **headers)[0] == 403


@pytest.mark.parametrize(
    "path", ["/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/..\\a.py"]
)
def test_no_path_leads_out_of_the_page(server, path):
    assert server.get(path)[0] == 404
    assert server.get(path, token=None)[0] == 403


def test_malformed_messages_are_said_and_long_ones_end_the_connection(server):
    with server.page() as page:
        frame = page.frame
        for message in (b"\x00\x01", "{", '{"type": "keys"}'):
            page.socket.send(message)
        page.wait_for(lambda status: "expected the field held" in status["notice"])
        assert (page.status["phase"], page.frame) == ("ready", frame)
        page.socket.send(json.dumps({"type": "seek", "step": 1}) + " " * MAX_BYTES)
        assert close_code(page.socket) == 1009


def test_a_lost_connection_pauses_the_episode_until_a_page_is_there_again(server, monkeypatch):
    monkeypatch.setattr(session, "SILENCE_TIME", 60.0)
    with server.page() as page:
        page.hold("forward")
        seed = page.wait_for(lambda status: status["steps"] == 2)["seed"]
    while server.session.phase == "playing":
        server.get("/")  # lets time pass
    assert server.session.phase == "paused"
    with server.page() as page:
        assert (page.status["phase"], page.status["seed"]) == ("paused", seed)
        page.hold("forward")
        page.wait_for(lambda status: status["phase"] == "playing")


def test_a_second_page_replaces_the_first(server):
    with server.page() as first, server.page() as second:
        assert close_code(first.socket) == REPLACED
        second.send(type="show", view="ego", speed=1)
        second.wait_for(lambda status: status["view"] == "ego")


def test_a_policy_is_watched_until_the_end(server, monkeypatch):
    monkeypatch.setattr(session, "STEP_TIME", 0.004)
    with server.page() as page:
        page.send(type="start", env_id="MoveToRegion-Demo-v0", seed=5, policy=0)
        status = page.wait_for(lambda status: status["phase"] == "ended")
        assert (status["policy_name"], status["facts"]["Score"]) == ("expert", "1.00")
