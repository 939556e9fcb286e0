"""Who may use the server: a secret token, and requests that come from its own page."""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import SplitResult, urlsplit

TOKEN_BYTES = 32  # of randomness, twice the least that the token must have
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})

# Sent with every answer. Nothing is loaded from elsewhere, the page cannot be framed, and its
# address, which has the token in it, is not given to other sites.
HEADERS: Mapping[str, str] = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def new_token() -> str:
    """A random token of 256 bits, fit for a URL."""
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True, slots=True)
class Guard:
    """Decides which requests are answered.

    The Host header protects against DNS rebinding: a page of another site that has its own name
    resolved to this machine still sends that name. Addresses cannot be rebound, so a server that
    is not bound to loopback alone accepts any.

    Args:
        token: the secret, which every request but those for the page's files must carry.
        hosts: names and addresses under which the server may be addressed; ports are not
            compared, since a tunnel may change them.
        any_address: whether any IP address is accepted as well.
    """

    token: str = field(repr=False)
    hosts: frozenset[str] = LOOPBACK
    any_address: bool = False

    def knows(self, token: str | None) -> bool:
        """Whether a token is the right one; takes the same time wherever they differ."""
        return hmac.compare_digest((token or "").encode(), self.token.encode())

    def accepts_host(self, headers: Mapping[str, str]) -> bool:
        """Whether the Host header names this server."""
        name = _split(f"//{headers.get('host', '')}").hostname
        if not name:
            return False
        return name in self.hosts or (self.any_address and _is_address(name))

    def accepts_origin(self, headers: Mapping[str, str], *, required: bool) -> bool:
        """Whether a request comes from this server's own page.

        Args:
            headers: of the request.
            required: whether a request without an Origin header is refused: browsers send one with
                every WebSocket and every request that changes something.
        """
        origin = headers.get("origin")
        if origin is None:
            return not required
        parts = _split(origin)
        return parts.scheme in ("http", "https") and parts.netloc == headers.get("host", "")


def make_guard(host: str, token: str, allowed: frozenset[str] = frozenset()) -> Guard:
    """The guard of a server that is bound to `host` and may also be called by the allowed names."""
    names = LOOPBACK | {host} | {name.lower() for name in allowed}
    if host in LOOPBACK:
        return Guard(token, names)
    return Guard(token, names | {socket.gethostname().lower()}, any_address=True)


def page_url(host: str, port: int, token: str) -> str:
    """The page's address."""
    name = socket.gethostname() if host in ("0.0.0.0", "::") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/?token={token}"


def _split(url: str) -> SplitResult:
    """The parts of a URL; all empty where it is none."""
    try:
        parts = urlsplit(url)
        _ = parts.port  # raises where it is no number
    except ValueError:
        return SplitResult("", "", "", "", "")
    return parts


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
