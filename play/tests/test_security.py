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
    assert [GUARD.knows(token) for token in ("secret", "", "secre", "Secret", "sécret")] == [
        True,
        *[False] * 4,
    ]


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


@pytest.mark.parametrize("required", [True, False])
def test_origins(required: bool) -> None:
    host = "127.0.0.1:8000"
    assert GUARD.accepts_origin({"host": host}, required=False)
    assert not GUARD.accepts_origin({"host": host}, required=True)
    for origin in (f"http://{host}", f"https://{host}"):
        assert GUARD.accepts_origin({"host": host, "origin": origin}, required=required)
    other = "http://127.0.0.1:8001", "http://evil.example", f"http://{host}.evil.example"
    for origin in (*other, f"file://{host}", "null", ""):
        assert not GUARD.accepts_origin({"host": host, "origin": origin}, required=required)


def test_the_address_of_the_page() -> None:
    assert page_url("127.0.0.1", 81, "t") == "http://127.0.0.1:81/?token=t"
    assert page_url("::1", 81, "t") == "http://[::1]:81/?token=t"
