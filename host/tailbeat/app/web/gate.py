"""Takes the page's connections, in a thread of its own with a bounded share of the descriptors.

A connection is passed to the web server only once its request header is complete and allowed.
ABORT is answered here, so it needs neither the server's thread nor a free place in the server.

Connections whose header is incomplete are limited in number. A new one beyond the limit takes the
place of the oldest, so idle connections cannot keep a new one out, whichever address they have. The
limits leave most descriptors to the event log, the trial logs and the link to the board.

Puts connections that the gate has let in into the web server's event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from tailbeat.app.web.access import ABORTED, Reply, Request, Rules
from tailbeat.core.platform.programs import open_files_max

if TYPE_CHECKING:
    import uvicorn

HandOver = Callable[[socket.socket, bytes], None]
"""Given to the web server: a connection and what was read of it."""

_TURN_S = 1.0
HEADER_S = 5.0  # for a complete header; a browser sends it at once
_ACCEPTED_AT_ONCE = 16
_RECEIVED_BYTES = 65536
_SPARES = 4
_NO_DESCRIPTOR_S = 0.02
_log = logging.getLogger(__name__)
_FULL = Reply(
    HTTPStatus.SERVICE_UNAVAILABLE,
    "tailbeat: too many connections; close other pages, then load this one again\n",
)
_MALFORMED = Reply(HTTPStatus.BAD_REQUEST, "tailbeat: this is no HTTP request\n")


@dataclass(frozen=True)
class GateLimits:
    """How many connections: without a complete header, and passed to the web server; in all, and
    from one address."""

    waiting: int = 64
    waiting_each: int = 32
    served: int = 160
    served_each: int = 64

    @classmethod
    def of(cls, descriptors: int) -> GateLimits:
        """For a process that may open so many: less than a third of them in all."""
        waiting, served = max(4, min(64, descriptors // 8)), max(8, min(160, descriptors // 6))
        return cls(waiting, max(2, waiting // 2), served, max(4, 2 * served // 5))

    @classmethod
    def of_process(cls) -> GateLimits:
        """For this process."""
        descriptors = open_files_max()
        return cls() if descriptors is None else cls.of(descriptors)


@dataclass(eq=False)
class _Waiting:
    """A connection whose header is incomplete."""

    socket: socket.socket
    address: str
    since_s: float
    read: bytearray = field(default_factory=bytearray)
    parser: h11.Connection = field(default_factory=lambda: h11.Connection(h11.SERVER))


class Gate:
    """Before the web server. ``abort`` stops the tail and never blocks."""

    def __init__(
        self,
        listener: socket.socket,
        rules: Rules,
        abort: Callable[[], None],
        limits: GateLimits | None = None,
    ) -> None:
        self._listener = listener
        self._rules = rules
        self._abort = abort
        self._limits = limits or GateLimits.of_process()
        self._waiting: dict[_Waiting, None] = {}  # oldest first
        self._served: list[tuple[str, socket.socket]] = []
        self._spares: list[int] = []
        self._closing = False
        self._selector = selectors.DefaultSelector()
        self._bell, self._rope = socket.socketpair()
        self._hand_over: HandOver | None = None
        self._thread = threading.Thread(target=self._run, name="gate", daemon=True)
        self._refill()

    def open(self, hand_over: HandOver) -> None:
        """Begins to answer, in a thread."""
        self._hand_over = hand_over
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._bell, selectors.EVENT_READ)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and what waits. Connections of the web server are its own."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._rope.send(b"x")
        if self._thread.is_alive():
            self._thread.join()
        for waiting in list(self._waiting):
            self._drop(waiting)
        for spare in self._spares:
            os.close(spare)
        self._spares.clear()
        self._selector.close()
        self._bell.close()
        self._rope.close()

    def _run(self) -> None:
        while not self._closing:
            try:
                self._turn()
            except Exception:  # whatever one connection did, the next one may be ABORT
                _log.exception("the page's gate has failed on a connection")

    def _turn(self) -> None:
        ready = [key.data for key, _ in self._selector.select(_TURN_S)]
        for waiting in ready:  # before new ones take their places
            if isinstance(waiting, _Waiting) and waiting in self._waiting:
                self._read(waiting)
        if None in ready and not self._closing:
            self._accept()
        self._drop_late()
        self._refill()

    def _accept(self) -> None:
        for _ in range(_ACCEPTED_AT_ONCE):
            try:
                connection, peer = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError:  # no descriptor is left: the rest of the program took them all
                self._release_one()
                continue
            connection.setblocking(False)
            waiting = _Waiting(connection, str(peer[0]), time.monotonic())
            self._make_place(waiting.address)
            self._waiting[waiting] = None
            self._selector.register(connection, selectors.EVENT_READ, waiting)
            self._read(waiting)

    def _make_place(self, address: str) -> None:
        """One more from ``address`` keeps within the limits: the oldest goes of this address, or of
        the address that has most."""
        counts = Counter(waiting.address for waiting in self._waiting)
        if counts[address] >= self._limits.waiting_each:
            self._drop_oldest(address)
        elif len(self._waiting) >= self._limits.waiting:
            self._drop_oldest(counts.most_common(1)[0][0])

    def _drop_oldest(self, address: str) -> None:
        self._drop(next(waiting for waiting in self._waiting if waiting.address == address))

    def _drop_late(self) -> None:
        now_s = time.monotonic()
        for waiting in list(self._waiting):
            if now_s - waiting.since_s <= HEADER_S:
                break
            self._drop(waiting)

    def _release_one(self) -> None:
        """Makes a descriptor free, for the connection that is to be taken now."""
        if self._spares:  # first: without descriptors accept fails also when nobody comes
            os.close(self._spares.pop())
        elif self._waiting:
            self._drop(next(iter(self._waiting)))
        else:
            time.sleep(_NO_DESCRIPTOR_S)

    def _refill(self) -> None:
        while len(self._spares) < _SPARES:
            try:
                self._spares.append(os.open(os.devnull, os.O_RDONLY))
            except OSError:
                return

    def _drop(self, waiting: _Waiting) -> None:
        self._take(waiting).close()

    def _take(self, waiting: _Waiting) -> socket.socket:
        del self._waiting[waiting]
        self._selector.unregister(waiting.socket)
        return waiting.socket

    def _read(self, waiting: _Waiting) -> None:
        try:
            data = waiting.socket.recv(_RECEIVED_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self._drop(waiting)
            return
        if not data:
            self._drop(waiting)
            return
        waiting.read += data
        try:
            waiting.parser.receive_data(data)
            event = waiting.parser.next_event()
        except h11.RemoteProtocolError:
            self._answer(waiting, _MALFORMED)
            return
        if isinstance(event, h11.Request):
            self._decide(waiting, Request.of(_scope(event)))

    def _decide(self, waiting: _Waiting, request: Request) -> None:
        reply = self._rules.reply(request)
        if reply is ABORTED:
            self._abort()
        elif reply is None and not self._has_room(waiting.address):
            reply = _FULL
        if reply is None:
            self._pass_on(waiting)
        else:
            self._answer(waiting, reply)

    def _pass_on(self, waiting: _Waiting) -> None:
        assert self._hand_over is not None
        connection = self._take(waiting)
        self._served.append((waiting.address, connection))
        try:
            self._hand_over(connection, bytes(waiting.read))
        except RuntimeError:  # the server has ended
            connection.close()

    def _has_room(self, address: str) -> bool:
        self._served = [one for one in self._served if one[1].fileno() != -1]
        each = sum(one == address for one, _ in self._served)
        return len(self._served) < self._limits.served and each < self._limits.served_each

    def _answer(self, waiting: _Waiting, reply: Reply) -> None:
        head = b"HTTP/1.1 %d %s\r\n" % (reply.status, reply.status.phrase.encode())
        lines = [name + b": " + value for name, value in reply.all_headers()]
        connection = self._take(waiting)
        with contextlib.suppress(OSError):
            connection.send(head + b"\r\n".join(lines) + b"\r\n\r\n" + reply.text.encode())
            connection.shutdown(socket.SHUT_WR)
        connection.close()


def _scope(request: h11.Request) -> dict[str, object]:
    """As ASGI has it."""
    path, _, query = request.target.partition(b"?")
    headers = [(name.lower(), value) for name, value in request.headers]
    upgrades = any(name == b"upgrade" and value.lower() == b"websocket" for name, value in headers)
    return {
        "type": "websocket" if upgrades else "http",
        "scheme": "ws" if upgrades else "http",
        "method": request.method.decode("ascii"),
        "path": unquote(path.decode("ascii")),
        "query_string": query,
        "headers": headers,
    }


class _Begun(H11Protocol):
    """One whose first bytes were read already."""

    def __init__(self, begun: bytes, **given: Any) -> None:
        super().__init__(**given)
        self._begun = begun

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.data_received(self._begun)


class Entrance:
    """Of a server that has started in ``loop``."""

    def __init__(self, server: uvicorn.Server, loop: asyncio.AbstractEventLoop) -> None:
        self._server = server
        self._loop = loop
        self._tasks: set[asyncio.Task[None]] = set()

    def take(self, connection: socket.socket, begun: bytes) -> None:
        """From any thread. Raises RuntimeError when the loop has ended."""
        self._loop.call_soon_threadsafe(self._begin, connection, begun)

    def _begin(self, connection: socket.socket, begun: bytes) -> None:
        task = self._loop.create_task(self._connect(connection, begun))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connect(self, connection: socket.socket, begun: bytes) -> None:
        def protocol() -> _Begun:
            return _Begun(
                begun,
                config=self._server.config,
                server_state=self._server.server_state,
                app_state=self._server.lifespan.state,
                _loop=self._loop,
            )

        try:
            await self._loop.connect_accepted_socket(protocol, connection)
        except OSError:
            connection.close()
