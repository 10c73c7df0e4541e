"""The gate before the page: who gets a place, and ABORT when there is none. Loopback only."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from tailbeat.app.web import gate as module
from tailbeat.app.web.access import Rules
from tailbeat.app.web.gate import Gate, GateLimits

LIMITS = GateLimits(waiting=12, waiting_each=8, served=6, served_each=4)
PATIENCE_S = 600.0
US, OTHER = "127.0.0.1", "127.0.0.2"
HALF = b"GET / HTTP/1.1\r\nHost: x\r\n"


@dataclass
class Tank:
    """A gate and what came through."""

    gate: Gate
    port: int
    token: str | None
    aborts: list[bool] = field(default_factory=list)
    passed: list[tuple[socket.socket, bytes]] = field(default_factory=list)
    clients: list[socket.socket] = field(default_factory=list)
    came: threading.Condition = field(default_factory=threading.Condition)

    def connect(self, address: str = US) -> socket.socket:
        client = socket.create_connection(("127.0.0.1", self.port), PATIENCE_S, (address, 0))
        self.clients.append(client)
        return client

    def wait_for(self, passed: int) -> None:
        with self.came:
            assert self.came.wait_for(lambda: len(self.passed) >= passed, PATIENCE_S)

    def request(self, line: str, *headers: str) -> bytes:
        host = f"Host: 127.0.0.1:{self.port}"
        return "\r\n".join([f"{line} HTTP/1.1", host, *headers, "", ""]).encode()

    def ask(self, line: str, *headers: str, address: str = US) -> bytes:
        """Status and body of the answer; empty = passed on or closed."""
        client = self.connect(address)
        client.sendall(self.request(line, *headers))
        return answer_on(client)

    def abort(self) -> bytes:
        own = f"Origin: http://127.0.0.1:{self.port}"
        cookie = f"Cookie: tailbeat_{self.port}={self.token}"
        return self.ask("POST /abort", own, cookie, "Content-Length: 0")


def answer_on(client: socket.socket) -> bytes:
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while piece := client.recv(4096):
            data += piece
    return data


@contextlib.contextmanager
def tank(
    token: str | None = None, limits: GateLimits = LIMITS, keep: bool = True
) -> Iterator[Tank]:
    listener = socket.create_server(("127.0.0.1", 0), backlog=1024)
    port = listener.getsockname()[1]
    aborts: list[bool] = []
    gate = Gate(listener, Rules(token, port), lambda: aborts.append(True), limits)
    made = Tank(gate, port, token, aborts)

    def hand_over(connection: socket.socket, begun: bytes) -> None:
        with made.came:
            made.passed.append((connection, begun))
            made.came.notify()
        if not keep:
            connection.close()

    gate.open(hand_over)
    try:
        yield made
    finally:
        gate.close()
        for one in (*made.clients, *(one for one, _ in made.passed), listener):
            one.close()


def test_idle_connections_do_not_keep_abort_out() -> None:
    with tank("s3cret") as made:
        for _ in range(200):
            made.connect().sendall(HALF)
        for _ in range(20):
            assert made.abort().startswith(b"HTTP/1.1 200 OK\r\n")
        assert len(made.gate._waiting) <= LIMITS.waiting_each
        assert made.aborts == [True] * 20
        assert made.passed == []


def test_one_address_does_not_take_the_place_of_another() -> None:
    with tank() as made:
        ours = made.connect()
        ours.sendall(b"POST /abort HTTP/1.1\r\n")
        for _ in range(100):
            made.connect(OTHER).sendall(HALF)
        assert made.ask("BAD", address=OTHER).startswith(b"HTTP/1.1 400")  # all are taken in
        ours.sendall(made.request("POST /abort").partition(b"\r\n")[2])
        assert answer_on(ours).endswith(b'{"asked":true}')


def test_all_descriptors_taken_by_the_rest_of_the_program() -> None:
    """The gate has some of its own."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with tank() as made:
        client = socket.socket()
        made.clients.append(client)
        taken: list[int] = []
        resource.setrlimit(resource.RLIMIT_NOFILE, (400, hard))
        try:
            with contextlib.suppress(OSError):
                while True:
                    taken.append(os.open(os.devnull, os.O_RDONLY))
            client.connect(("127.0.0.1", made.port))
            client.sendall(made.request("POST /abort"))
            client.settimeout(PATIENCE_S)
            assert answer_on(client).startswith(b"HTTP/1.1 200 OK\r\n")
        finally:
            for one in taken:
                os.close(one)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_places_in_the_server_are_limited_and_free_again() -> None:
    with tank() as made:
        asked = [made.connect() for _ in range(LIMITS.served_each)]
        for one in asked:
            one.sendall(made.request("GET /"))
        made.wait_for(LIMITS.served_each)  # else a later one may be read first
        assert made.ask("GET /").startswith(b"HTTP/1.1 503")
        assert made.abort().startswith(b"HTTP/1.1 200")
        other = made.connect(OTHER)
        other.sendall(made.request("GET /"))
        made.wait_for(LIMITS.served_each + 1)
        for one, _ in made.passed:
            one.close()
        assert made.ask("GET /no", "Origin: http://evil.example").startswith(b"HTTP/1.1 403")
        again = made.connect()
        again.sendall(made.request("GET /"))
        made.wait_for(LIMITS.served_each + 2)


def test_the_server_gets_every_byte() -> None:
    with tank(keep=False) as made:
        client = made.connect()
        whole = made.request("POST /upload", "Content-Length: 4") + b"body"
        for at in range(0, len(whole), 7):
            client.sendall(whole[at : at + 7])
        with contextlib.suppress(ConnectionError):
            assert answer_on(client) == b""
        ((_, begun),) = made.passed
        assert whole.startswith(begun) and b"\r\n\r\n" in begun


@pytest.mark.parametrize(
    ("line", "headers", "status"),
    [
        ("GET /", [], b"403"),
        ("GET /?token=wrong", [], b"403"),
        ("POST /abort", [], b"403"),
        ("POST /abort?token=s3cret", [], b"200"),  # the first visit: an answer with the cookie
        ("GET /", ["Cookie: tailbeat_{port}=s3cret"], b""),
        ("GET /", ["Cookie: tailbeat_{port}=s3cret", "Origin: http://evil.example"], b"403"),
        ("POST /abort", ["Cookie: tailbeat_{port}=s3cret", "Origin: http://evil.example"], b"403"),
        ("GET /", ["Upgrade: websocket", "Cookie: tailbeat_{port}=s3cret"], b"403"),
        ("GET /", ["Bad Header"], b"400"),
        ("GET /", ["X: " + "x" * 70_000], b"400"),
    ],
)
def test_who_may_not_come_in_takes_no_place(line: str, headers: list[str], status: bytes) -> None:
    with tank("s3cret", keep=False) as made:
        answer = made.ask(line, *(one.format(port=made.port) for one in headers))
        assert answer[9:12] == status
        assert len(made.passed) == (status == b"")
        assert made.aborts == []


def test_a_header_that_never_ends_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HEADER_S", -1.0)
    with tank() as made:
        client = made.connect()
        assert answer_on(client) == b""


def test_the_limits_leave_most_descriptors_to_the_rest() -> None:
    for descriptors in (64, 256, 1024, 1 << 20):
        limits = GateLimits.of(descriptors)
        assert limits.waiting + limits.served <= descriptors / 3
        assert limits.waiting_each < limits.waiting and limits.served_each < limits.served
        assert limits.served_each >= 4
