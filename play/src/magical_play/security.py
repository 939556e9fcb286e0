"""Who may use the server: the token, the Host and Origin headers, the headers of responses."""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

TOKEN_BYTES = 32  # random bytes in the token, twice the required minimum
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})

# Sent with every response. Nothing is loaded from other hosts, the page cannot be framed, and its
# URL, which contains the token, is not disclosed to other sites.
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
    """A random URL-safe token of 256 bits."""
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True, slots=True)
class Guard:
    """Decides which requests are answered.

    Checking the Host header protects against DNS rebinding: a page of another site whose name
    resolves to this machine still sends that name. IP addresses cannot be rebound, so a server that
    is not bound to loopback alone accepts any. Ports are not compared: a tunnel may change them.
    """

    token: str = field(repr=False)  # that every request must carry, but those for the page's files
    hosts: frozenset[str] = LOOPBACK  # by which the server may be addressed
    any_address: bool = False  # whether any IP address is accepted as well

    def knows(self, token: str) -> bool:
        """Whether a token is the right one; compares in constant time."""
        return hmac.compare_digest(token.encode(), self.token.encode())

    def accepts_host(self, headers: Mapping[str, str]) -> bool:
        """Whether the Host header names this server."""
        try:
            parts = urlsplit(f"//{headers.get('host', '')}")
            name, _ = parts.hostname or "", parts.port  # raises if the port is not a number
            return name in self.hosts or (self.any_address and bool(ipaddress.ip_address(name)))
        except ValueError:
            return False

    def accepts_origin(self, headers: Mapping[str, str], *, required: bool) -> bool:
        """Whether a request comes from this server's own page.

        Browsers send an Origin header with every WebSocket and every request that changes something
        (`required`).
        """
        origin = headers.get("origin")
        if origin is None:
            return not required
        return origin in (f"http://{headers.get('host')}", f"https://{headers.get('host')}")


def make_guard(host: str, token: str, allowed: frozenset[str] = frozenset()) -> Guard:
    """The guard of a server that is bound to `host` and may also be addressed by allowed names."""
    names = LOOPBACK | {host.lower()} | {name.lower() for name in allowed}
    if host in LOOPBACK:  # reachable from this machine alone
        return Guard(token, names)
    return Guard(token, names | {socket.gethostname().lower()}, any_address=True)


def page_url(host: str, port: int, token: str) -> str:
    """The page's URL."""
    name = socket.gethostname() if host in ("0.0.0.0", "::") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{port}/?token={token}"


class GuardMiddleware:
    """Passes on only what the guard accepts; `public` paths may be read without the token."""

    def __init__(self, app: ASGIApp, guard: Guard, public: Collection[str]) -> None:
        self._app, self._guard, self._public = app, guard, public

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or socket."""
        if scope["type"] == "lifespan" or (problem := self._problem(scope)) is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()  # the request to connect
            await send({"type": "websocket.close", "code": 1008})  # before accepting: status 403
        else:
            answer = PlainTextResponse(f"refused: {problem}\n", status_code=403)
            await answer(scope, receive, send)

    def _problem(self, scope: Scope) -> str | None:
        """Why a request is refused; `None` if it is accepted."""
        headers, guard = Headers(scope=scope), self._guard
        reading = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not guard.accepts_host(headers):
            return "the Host header does not name this server; see --allow-host"
        if not guard.accepts_origin(headers, required=not reading):
            return "the Origin header does not name this server"
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if not (reading and scope["path"] in self._public) and not guard.knows(token):
            return "the token is missing or wrong; open the address that the server printed"
        return None
