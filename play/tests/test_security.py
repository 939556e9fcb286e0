"""The token, hosts and origins."""

import pytest

from magical_play.security import TOKEN_BYTES, Guard, make_guard, new_token, page_url

GUARD = Guard("secret")


def test_tokens_are_long_and_random_and_not_shown_with_the_guard() -> None:
    assert TOKEN_BYTES * 8 >= 128
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= TOKEN_BYTES * 8 / 6
    assert "secret" not in repr(GUARD)


@pytest.mark.parametrize("token", ["", "secre", "secret ", "Secret", "sécret"])
def test_other_tokens_are_refused(token: str) -> None:
    assert GUARD.knows("secret")
    assert not GUARD.knows(token)


def test_hosts() -> None:
    for host in ("127.0.0.1:8000", "localhost", "localhost:1", "[::1]:8000"):
        assert GUARD.accepts_host({"host": host}), host
    others = ("", "evil.example", "127.0.0.1.evil.example", "10.0.0.1", "127.0.0.1:x", "[::1", "@")
    for host in others:
        assert not GUARD.accepts_host({"host": host}), host
    assert not GUARD.accepts_host({})
    assert make_guard("LAB.example", "token").accepts_host({"host": "lab.example:8000"})


def test_a_server_for_other_machines_accepts_addresses_and_named_hosts() -> None:
    guard = make_guard("0.0.0.0", "secret", frozenset({"Lab.example"}))
    for host in ("10.0.0.1:8000", "[fe80::1]", "lab.example:80", "localhost"):
        assert guard.accepts_host({"host": host}), host
    assert not guard.accepts_host({"host": "evil.example"})


@pytest.mark.parametrize(
    ("origin", "accepted"),
    [
        ("http://127.0.0.1:8000", True),
        ("https://127.0.0.1:8000", True),
        ("http://127.0.0.1:8001", False),
        ("http://evil.example", False),
        ("http://127.0.0.1:8000.evil.example", False),
        ("file://127.0.0.1:8000", False),
        ("null", False),
        ("", False),
    ],
)
def test_origins(origin: str, accepted: bool) -> None:
    headers = {"host": "127.0.0.1:8000", "origin": origin}
    assert GUARD.accepts_origin(headers, required=True) is accepted
    assert GUARD.accepts_origin(headers, required=False) is accepted


def test_an_origin_may_be_missing_where_nothing_is_changed() -> None:
    assert GUARD.accepts_origin({"host": "localhost"}, required=False)
    assert not GUARD.accepts_origin({"host": "localhost"}, required=True)


def test_the_address_of_the_page() -> None:
    assert page_url("127.0.0.1", 81, "t") == "http://127.0.0.1:81/?token=t"
    assert page_url("::1", 81, "t") == "http://[::1]:81/?token=t"
