"""Who may look at the page, and press its buttons.

Two doors. By default it listens on this computer only, and every request must name this computer
(a foreign name in ``Host`` is how DNS rebinding looks) and come from its own pages (``Origin``).
With a token nothing is answered without it: the first visit brings it in the address, after that a
cookie does that no script can read and no other site makes the browser send.

The gate applies these rules before the web server gets a connection, which serves one request, and
answers ABORT itself, however much there is to do behind. The web server refuses what the gate would
have answered.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
Headers = tuple[tuple[bytes, bytes], ...]

_TOKEN_BYTES = 12  # 96 bits, 16 characters: it may have to be typed
# A foreign page may neither frame the buttons nor learn the token from a link, and whatever a
# library might ask of another computer is refused by the browser.
# One request for each connection: the next one, ABORT perhaps, comes through the gate again.
HEADERS = (
    (b"connection", b"close"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' ws://{host};"
    " frame-ancestors 'none'; form-action 'self'; base-uri 'self'"
)
_HOST = re.compile(r"[A-Za-z0-9.:\[\]_-]+")
# Not a redirect: a cookie that is SameSite=Strict would not be sent along one that a link in a
# mail began.
_WELCOME = (
    '<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=/">'
    '<title>tailbeat</title><p><a href="/">tailbeat</a>'
)


@dataclass(frozen=True)
class Reply:
    """An answer that needs nothing of the page."""

    status: HTTPStatus
    text: str
    kind: str = "text/plain"
    headers: Headers = ()

    def all_headers(self) -> list[tuple[bytes, bytes]]:
        """With what it says of itself."""
        return [
            (b"content-type", f"{self.kind}; charset=utf-8".encode()),
            (b"content-length", str(len(self.text.encode())).encode()),
            (b"cache-control", b"no-store"),
            *self.headers,
            *HEADERS,
        ]


ABORTED = Reply(HTTPStatus.OK, '{"asked":true}', "application/json")
_WITHOUT_TOKEN = "give the address with its token, as it was printed"


def new_token() -> str:
    """One that nobody guesses."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches it."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True)
class Rules:
    """Who may ask. ``token`` None: this computer only. ``port`` sets the name of the cookie, which
    browsers share between the ports of a host."""

    token: str | None
    port: int

    @property
    def cookie(self) -> str:
        """Its name."""
        return f"tailbeat_{self.port}"

    def reply(self, request: Request) -> Reply | None:
        """What is answered at once: a refusal, ``ABORTED``, the cookie for the token that the
        address brings; None = the page is to answer."""
        if why := self._foreign(request):
            return Reply(HTTPStatus.FORBIDDEN, f"tailbeat: {why}\n")
        if self.token is None or self._is_token(request.cookie(self.cookie)):
            return ABORTED if request.aborts else None
        if request.websocket or not self._is_token(request.query("token")):
            return Reply(HTTPStatus.FORBIDDEN, f"tailbeat: {_WITHOUT_TOKEN}\n")
        cookie = f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        return Reply(HTTPStatus.OK, _WELCOME, "text/html", ((b"set-cookie", cookie.encode()),))

    def _is_token(self, given: str) -> bool:
        """Takes as long for a nearly right token as for any other."""
        return secrets.compare_digest(given.encode(), (self.token or "").encode())

    def _foreign(self, request: Request) -> str:
        """Why it comes from elsewhere; empty = it does not."""
        if not self._is_ours(request.host):
            return "this page has another name"
        origin = request.origin
        if request.cross_site:
            return "another page may not ask for this"
        if origin is None:  # no browser opens a websocket without
            return "a websocket without an origin" if request.websocket else ""
        same = origin.lower() == f"{request.scheme}://{request.host}".lower()
        return "" if same else "another page may not ask for this"

    def _is_ours(self, host: str) -> bool:
        """A number cannot be rebound; a name only if it is this computer's."""
        if not _HOST.fullmatch(host):
            return False
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if self.token is None:
            return is_loopback(name)
        try:
            ipaddress.ip_address(name)
        except ValueError:
            own = socket.gethostname().lower().partition(".")[0]
            return name == "localhost" or name.partition(".")[0] == own
        return True


@dataclass(frozen=True)
class Request:
    """What the rules look at."""

    websocket: bool
    aborts: bool
    scheme: str
    host: str
    origin: str | None
    cross_site: bool  # something in another site's page, not somebody who follows a link
    cookies: str
    asked: str

    @classmethod
    def of(cls, scope: Scope) -> Request:
        found: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:  # a second Host makes one that is no host
            found[name] = found[name] + b"; " + value if name in found else value
        origin = found.get(b"origin")
        scheme = str(scope["scheme"]).replace("ws", "http")
        return cls(
            websocket=scope["type"] == "websocket",
            aborts=scope.get("method") == "POST" and scope["path"] == "/abort",
            scheme=scheme,
            host=found.get(b"host", b"").decode("latin-1"),
            origin=None if origin is None else origin.decode("latin-1"),
            cross_site=found.get(b"sec-fetch-site") == b"cross-site"
            and found.get(b"sec-fetch-dest") != b"document",
            cookies=found.get(b"cookie", b"").decode("latin-1"),
            asked=scope.get("query_string", b"").decode("latin-1"),
        )

    def cookie(self, name: str) -> str:
        try:
            found = SimpleCookie(self.cookies).get(name)
        except CookieError:
            return ""
        return found.value if found is not None else ""

    def query(self, name: str) -> str:
        return parse_qs(self.asked).get(name, [""])[0]


@dataclass(frozen=True)
class Guarded:
    """Before ``app`` (ASGI): puts the headers on every answer, and lets nothing in that the gate
    should have answered, should it ever get past the gate."""

    app: App
    rules: Rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if "headers" not in scope:
            await self.app(scope, receive, send)
            return
        request = Request.of(scope)
        if self.rules.reply(request) is not None:
            await _refuse(scope, receive, send)
            return
        policy = (b"content-security-policy", _POLICY.format(host=request.host).encode())

        async def guarded(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *HEADERS, policy]
            await send(message)

        await self.app(scope, receive, guarded)


_POLICY_VIOLATION = 1008
_PAST_THE_GATE = Reply(HTTPStatus.FORBIDDEN, "tailbeat: ask on a new connection\n")


async def _refuse(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await receive()  # websocket.connect; closing before accepting it answers 403
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        return
    reply = _PAST_THE_GATE
    head = {"status": reply.status, "headers": reply.all_headers()}
    await send({"type": "http.response.start", **head})
    await send({"type": "http.response.body", "body": reply.text.encode()})
