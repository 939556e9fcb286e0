"""The token, hosts and origins."""

import pytest

from magical.web.security import TOKEN_BYTES, Guard, make_guard, new_token, page_url

GUARD = Guard("secret")


def test_tokens_are_long_and_random() -> None:
    assert TOKEN_BYTES * 8 >= 128
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= TOKEN_BYTES * 8 / 6


@pytest.mark.parametrize("token", ["", "secre", "secret ", "Secret", "sécret"])
def test_other_tokens_are_refused(token: str) -> None:
    assert GUARD.knows("secret")
    assert not GUARD.knows(token)


def test_the_token_is_not_shown_with_the_guard() -> None:
    assert "secret" not in repr(GUARD)


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost", "localhost:1", "[::1]:8000"])
def test_this_machine_is_a_host(host: str) -> None:
    assert GUARD.accepts_host({"host": host})


@pytest.mark.parametrize(
    "host", ["", "evil.example", "127.0.0.1.evil.example", "10.0.0.1", "127.0.0.1:x", "[::1", "@"]
)
def test_other_hosts_are_refused(host: str) -> None:
    assert not GUARD.accepts_host({"host": host})
    assert not GUARD.accepts_host({})


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


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("127.0.0.1", "http://127.0.0.1:81/?token=t"),
        ("::1", "http://[::1]:81/?token=t"),
    ],
)
def test_the_address_of_the_page(host: str, url: str) -> None:
    assert page_url(host, 81, "t") == url
