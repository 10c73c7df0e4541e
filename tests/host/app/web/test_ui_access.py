"""Who gets through the door of the page: plain requests, written by hand."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import pytest

from tailbeat.app.web.access import ABORTED, Guarded, Request, Rules, is_loopback, new_token
from tailbeat.app.web.cards import reference_of_csv, reference_of_text
from tailbeat.app.web.server import reached_at
from tailbeat.core.errors import InputError
from tailbeat.core.reference import thesis

TOKEN = "s3cret-Token_16c"
Headers = dict[str, str]


async def _inside(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"the tank"})


class Answer:
    """What came back: of the door, or of the page behind it. ``status`` of a websocket: 101 when it
    was let in. ``aborted``: the tail was stopped."""

    def __init__(
        self, status: int, headers: Iterable[tuple[bytes, bytes]], body: bytes, aborted: bool
    ) -> None:
        self.status, self.body, self.aborted = status, body, aborted
        self.headers = {k.decode(): v.decode() for k, v in headers}


def knock(
    token: str | None,
    headers: Headers,
    kind: str = "http",
    query: str = "",
    path: str = "/",
    more: tuple[tuple[bytes, bytes], ...] = (),
    method: str = "GET",
) -> Answer:
    """One request to a page on port 8080."""
    sent: list[dict[str, Any]] = []
    raw = [(name.lower().encode(), value.encode()) for name, value in headers.items()]
    scope = {
        "type": kind,
        "scheme": "ws" if kind == "websocket" else "http",
        "method": method,
        "path": path,
        "query_string": query.encode(),
        "headers": [*raw, *more],
    }

    async def receive() -> dict[str, str]:
        return {"type": "websocket.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Guarded(_inside, Rules(token, 8080))(scope, receive, send))
    if (reply := Rules(token, 8080).reply(Request.of(scope))) is not None:
        # Should it get past the gate, which answers it, the web server refuses it, too.
        assert sent[0].get("status") == 403 or sent[0]["type"] == "websocket.close"
        body = reply.text.encode()
        return Answer(reply.status, reply.all_headers(), body, reply is ABORTED)
    if kind == "websocket":
        return Answer(101, (), b"", False)
    return Answer(sent[0]["status"], sent[0]["headers"], sent[1]["body"], False)


def abort(token: str | None, headers: Headers) -> Answer:
    return knock(token, headers, path="/abort", method="POST")


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "LOCALHOST"])
def test_this_computer_needs_no_token(host: str) -> None:
    assert knock(None, {"Host": host}).status == 200
    own = {"Host": host, "Origin": f"http://{host}"}
    assert knock(None, own, "websocket").status == 101


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8080",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.168.1.20:8080",
        "evil@127.0.0.1:8080",
        "127.0.0.1:8080;x",
        "[::1",
        "",
    ],
)
def test_a_rebound_name_is_refused(host: str) -> None:
    answer = knock(None, {"Host": host})
    assert (answer.status, b"the tank" in answer.body) == (403, False)
    assert knock(None, {"Host": host, "Origin": f"http://{host}"}, "websocket").status == 403


def test_two_host_headers_are_refused() -> None:
    twice = ((b"host", b"evil.example"),)
    assert knock(None, {"Host": "127.0.0.1:8080"}, more=twice).status == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:3000", "https://127.0.0.1:8080", "null", ""]
)
def test_another_page_is_refused(origin: str) -> None:
    headers = {"Host": "127.0.0.1:8080", "Origin": origin}
    assert knock(None, headers).status == 403
    assert knock(None, headers, "websocket").status == 403


def test_a_websocket_says_where_it_comes_from() -> None:
    assert knock(None, {"Host": "127.0.0.1:8080"}, "websocket").status == 403


LAN = {"Host": "192.168.1.20:8080", "Origin": "http://192.168.1.20:8080"}


@pytest.mark.parametrize(
    "path",
    ["/", "/raw/0001.ulg", "/beats/0001.csv", "/abort", "/_nicegui/3.18.0/static/nicegui.js",
     "/_nicegui_ws/socket.io/", "/nowhere"],
)  # fmt: skip
@pytest.mark.parametrize("given", ["", "token=", "token=wrong", f"token={TOKEN[:-1]}"])
def test_without_the_token_nothing_is_answered(path: str, given: str) -> None:
    for kind in ("http", "websocket"):
        answer = knock(TOKEN, LAN, kind, given, path)
        assert (answer.status, b"the tank" in answer.body) == (403, False)
        cookie = {**LAN, "Cookie": f"tailbeat_8080={given.removeprefix('token=')}"}
        assert knock(TOKEN, cookie, kind, "", path).status == 403


def test_the_first_visit_leaves_a_cookie_that_opens() -> None:
    first = knock(TOKEN, {"Host": LAN["Host"]}, query=f"token={TOKEN}")
    cookie = first.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= {p.strip() for p in cookie.split(";")}
    assert b"the tank" not in first.body
    assert b'content="0; url=/"' in first.body
    assert first.headers["referrer-policy"] == "no-referrer"
    known = {**LAN, "Cookie": f"other=1; {cookie.partition(';')[0]}"}
    assert knock(TOKEN, known).body == b"the tank"
    assert knock(TOKEN, known, "websocket").status == 101


def test_abort_is_answered_at_the_door() -> None:
    own = {"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}
    known = {**LAN, "Cookie": f"tailbeat_8080={TOKEN}"}
    for answer in (abort(None, own), abort(TOKEN, known)):
        assert (answer.status, answer.aborted, answer.body) == (200, True, b'{"asked":true}')
    assert not knock(None, own, path="/abort").aborted  # a link that is followed stops nothing


def test_nobody_aborts_who_may_not_come_in() -> None:
    own = {"Host": "127.0.0.1:8080"}
    for token, headers in (
        (None, {**own, "Origin": "http://evil.example"}),
        (None, {"Host": "evil.example"}),
        (None, {**own, "Sec-Fetch-Site": "cross-site"}),
        (TOKEN, LAN),
        (TOKEN, {**LAN, "Cookie": "tailbeat_8080=wrong"}),
        (TOKEN, {**LAN, "Cookie": f"tailbeat_8080={TOKEN}", "Origin": "http://evil.example"}),
    ):
        answer = abort(token, headers)
        assert (answer.status, answer.aborted) == (403, False)


def test_the_cookie_of_another_port_does_not_open() -> None:
    assert knock(TOKEN, {**LAN, "Cookie": f"tailbeat_8081={TOKEN}"}).status == 403


def test_the_token_does_not_open_to_other_sites() -> None:
    known = {"Host": LAN["Host"], "Cookie": f"tailbeat_8080={TOKEN}"}
    assert knock(TOKEN, {**known, "Origin": "http://evil.example"}, "websocket").status == 403
    assert knock(TOKEN, {**known, "Host": "evil.example"}).status == 403


def test_the_page_may_not_be_framed_nor_ask_elsewhere() -> None:
    headers = knock(None, {"Host": "127.0.0.1:8080"}).headers
    assert headers["x-frame-options"] == "DENY"
    policy = headers["content-security-policy"]
    assert "frame-ancestors 'none'" in policy
    assert "connect-src 'self' ws://127.0.0.1:8080;" in policy


def test_tokens_are_long_and_differ() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 16


def test_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[bytes, bytes]] = []

    def compare(given: bytes, wanted: bytes) -> bool:
        seen.append((given, wanted))
        return False

    monkeypatch.setattr("tailbeat.app.web.access.secrets.compare_digest", compare)
    assert knock(TOKEN, LAN, query=f"token={TOKEN}").status == 403
    assert (TOKEN.encode(), TOKEN.encode()) in seen


def test_where_others_reach_it() -> None:
    assert reached_at("192.168.1.20") == ["192.168.1.20"]
    assert reached_at("fe80::1") == ["[fe80::1]"]
    every = reached_at("0.0.0.0")
    assert every
    assert len(set(every)) == len(every)
    assert is_loopback("127.0.0.1") and is_loopback("::1") and is_loopback("localhost")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("192.168.1.20")
    assert not is_loopback("example.org")


def test_a_reference_typed_is_never_a_file(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert reference_of_text(" thesis ").crc == thesis().crc
    assert reference_of_text("trapezoid:0.06,8,20").beats == 36
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trapezoid").write_text("t_s,v_m_s\n0,0\n5,0.05\n")
    for text in ("trapezoid", "/etc/passwd", "thesis/../x.csv", "../tank.csv", ""):
        with pytest.raises(InputError, match="is no reference"):
            reference_of_text(text)


def test_a_csv_keeps_its_name_and_no_path() -> None:
    made = reference_of_csv("../../ramp.csv", b"t_s,v_m_s\n0,0\n5,0.05\n")
    assert (made.name, made.beats) == ("ramp", 5)
    with pytest.raises(InputError, match=r"row 3, column v_m_s"):
        reference_of_csv("bad.csv", b"t_s,v_m_s\n0,0\n5,fast\n")
