"""A simulated or emulated board as a process: Bluetooth on a TCP port, the camera on the next, USB
serial on the one after and on a pty, the fault-injection port on the fourth (sim/world.py), in real
time times a factor.

The board goes on swimming when a client drops, as a real one would, and takes the next client
without a restart.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import selectors
import socket
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from tailbeat.core.errors import ConnectError, InputError
from tailbeat.core.platform.ports import open_pty
from tailbeat.link.sockets import taken_line
from tailbeat.sim.board import CONSOLE, RADIO, SimulatedBoard
from tailbeat.sim.world import CameraFrame, CommandLines

DEFAULT_LISTEN = "tcp:127.0.0.1:5760"

_CHUNK_BYTES = 65536
_BACKLOG_MAX_BYTES = 1 << 20
_TURN_AWAY_S = 0.5
_STEP_S = 0.002  # wall time between two looks at the board ...
_QUIET_STEP_S = 0.02  # ... that nobody has said anything to for a while
_QUIET_AFTER_S = 0.1
_CATCH_UP_MAX_S = 0.25  # wall time a slow machine may owe before the clock is set back
_STEP_MAX_S = 0.05  # wall time spent on the board before the ports are looked at again
_PIECE_S = 0.02  # simulated time run at once
_PACE_SPAN_S = 5.0  # wall time over which the pace is judged
_PACE_MIN = 0.95  # of the requested pace
_PORTS = 4  # in a row
_PORT_MAX = 65536 - _PORTS


class _Client:
    """The other end of a TCP connection, with what it has not taken yet."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.connection = connection
        self.gone = False
        self._out = bytearray()

    def read(self) -> bytes:
        """All that has arrived."""
        pieces = []
        while not self.gone:
            try:
                piece = self.connection.recv(_CHUNK_BYTES)
            except BlockingIOError:
                break
            except OSError:
                piece = b""
            self.gone = not piece
            pieces.append(piece)
        return b"".join(pieces)

    def answer_gone(self, data: bytes) -> None:
        """To one that has said its last and may still listen."""
        with contextlib.suppress(OSError):
            self.connection.send(data)

    def write(self, data: bytes) -> None:
        """Sends what can be sent now; a client that does not read is given up."""
        self._out += data
        try:
            while self._out and not self.gone:
                del self._out[: self.connection.send(self._out)]
        except BlockingIOError:
            self.gone = len(self._out) > _BACKLOG_MAX_BYTES
        except OSError:
            self.gone = True


class _Port:
    """A listening TCP port with at most one client."""

    def __init__(self, selector: selectors.BaseSelector, host: str, port: int) -> None:
        self._selector = selector
        self._listener = _listener(host, port)
        host, self.number = self._listener.getsockname()[:2]
        self.address = f"tcp:{host}:{self.number}"
        self.client: _Client | None = None
        self.turn_away = b""  # what a second client is told
        self._waiting: socket.socket | None = None
        self._turn_away_s = 0.0
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._listener.accept()
            if self._waiting is not None:
                _hang_up(connection, self.turn_away)
                return
            self._waiting = connection
            self._turn_away_s = time.monotonic() + _TURN_AWAY_S

    def read(self) -> bytes:
        """What the client sent. A client that went makes room for one that waits for a moment:
        who connects again may be quicker than the news that the old connection is gone."""
        data = self.client.read() if self.client else b""
        self._make_room()
        return data

    def converse(self, hear: Callable[[bytes, bool], bytes]) -> None:
        """Answers what the client sent: ``hear(data, last)``."""
        if self.client is not None:
            data = self.client.read()
            answer = hear(data, self.client.gone)
            (self.client.answer_gone if self.client.gone else self.client.write)(answer)
        self._make_room()

    def _make_room(self) -> None:
        if self.client is not None and self.client.gone:
            self._drop()
        if self._waiting is not None:
            self._admit()

    def _admit(self) -> None:
        assert self._waiting is not None
        if self.client is None:
            self.client = _Client(self._waiting)
            self._selector.register(self._waiting, selectors.EVENT_READ, _nothing)
        elif time.monotonic() > self._turn_away_s:
            _hang_up(self._waiting, self.turn_away)
        else:
            return
        self._waiting = None

    def write(self, data: bytes) -> None:
        """To the client; without one the bytes are lost, as on a radio."""
        if self.client is not None:
            self.client.write(data)

    def _drop(self) -> None:
        if self.client is not None:
            self._selector.unregister(self.client.connection)
            self.client.connection.close()
            self.client = None

    def close(self) -> None:
        """Gives port and client up."""
        self._drop()
        if self._waiting is not None:
            self._waiting.close()
        self._selector.unregister(self._listener)
        self._listener.close()


def _hang_up(connection: socket.socket, last: bytes) -> None:
    """With last words. What came is read first: a connection closed with bytes unread is torn down
    at once, and some systems then throw the words away."""
    with contextlib.suppress(OSError):
        connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            connection.recv(_CHUNK_BYTES)
        connection.send(last)
        connection.shutdown(socket.SHUT_WR)
    connection.close()


class _Pty:
    """USB serial on a pseudo-terminal, held open so that clients may come and go."""

    def __init__(self, selector: selectors.BaseSelector) -> None:
        ends = open_pty()
        if ends is None:
            raise InputError("this system has no ptys.", "Use the TCP port.")
        self._selector = selector
        self._master, self._slave, self.path = ends
        selector.register(self._master, selectors.EVENT_READ, _nothing)

    def read(self) -> bytes:
        try:
            return os.read(self._master, _CHUNK_BYTES)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Bytes nobody reads are lost, as on a cable."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        self._selector.unregister(self._master)
        os.close(self._master)
        os.close(self._slave)


@dataclass(frozen=True)
class Addresses:
    """Where the simulator can be reached. ``listen``: Bluetooth; ``console`` and ``pty``: USB
    serial; ``world``: the fault-injection port."""

    listen: str
    camera: str
    console: str
    pty: str | None
    world: str


class SimServer:
    """Serves one board. ``speed``: simulated seconds per second; a board that cannot keep up runs
    as fast as it can, and ``on_slow`` is called once with the pace it reaches."""

    def __init__(
        self,
        board: SimulatedBoard,
        listen: str = DEFAULT_LISTEN,
        pty: bool = False,
        speed: float = 1.0,
        on_slow: Callable[[float], None] = lambda pace: None,
        wall_s: Callable[[], float] = time.monotonic,
    ) -> None:
        if not 0 < speed < 1e6:
            raise InputError(f"a speed of {speed:g} makes no sense.", "Give it like --speed 10.")
        host, port = parse_listen(listen)
        self._board = board
        self._speed = speed
        self._selector = selectors.DefaultSelector()
        self._radio, self._camera, self._console, self._world = _ports(self._selector, host, port)
        self._radio.turn_away = taken_line(self._console.number)
        self._console.turn_away = taken_line(None)
        config = {"plant": board.plant, "seed": board.seed, "simulator": board.config}
        self._lines = CommandLines(board.world, config)
        self._pty = _Pty(self._selector) if pty else None
        self._wall_s = wall_s
        self._on_slow: Callable[[float], None] | None = on_slow
        self._start_s = wall_s()
        self._origin_s = board.time_s
        self._span_s = self._start_s, board.time_s
        self._heard_s = self._start_s

    @property
    def addresses(self) -> Addresses:
        """Where to connect."""
        return Addresses(
            self._radio.address,
            self._camera.address,
            self._console.address,
            self._pty.path if self._pty else None,
            self._world.address,
        )

    def serve(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Runs until ``stop()`` says so."""
        while not stop():
            self.step()

    def step(self) -> None:
        """Waits a moment for bytes, moves them, and lets the board's time catch up."""
        quiet = self._wall_s() - self._heard_s > _QUIET_AFTER_S
        quiet_s = max(_STEP_S, min(_QUIET_STEP_S, _QUIET_STEP_S / self._speed))
        if ready := self._selector.select(quiet_s if quiet else _STEP_S):
            self._heard_s = self._wall_s()
        for key, _ in ready:
            key.data()
        self._board.write(self._radio.read(), RADIO)
        self._board.write(self._console.read(), CONSOLE)
        if self._pty is not None:
            self._board.write(self._pty.read(), CONSOLE)
        self._world.converse(self._lines.hear)
        self._advance()
        self._deliver()
        self._camera.read()

    def _advance(self) -> None:
        wall_s = self._wall_s()
        done_s = self._board.time_s - self._origin_s
        due_s = (wall_s - self._start_s) * self._speed - done_s
        limit_s = _CATCH_UP_MAX_S * self._speed
        if due_s > limit_s:
            self._start_s, self._origin_s = wall_s, self._board.time_s + limit_s
            due_s = limit_s
        while due_s >= 0.001 and self._wall_s() - wall_s < _STEP_MAX_S:
            before_s = self._board.time_s
            self._board.run(min(due_s, _PIECE_S))
            due_s -= self._board.time_s - before_s
        self._judge_pace(wall_s)

    def _judge_pace(self, wall_s: float) -> None:
        begin_s, begin_time_s = self._span_s
        if self._on_slow is None or wall_s - begin_s < _PACE_SPAN_S:
            return
        pace = (self._board.time_s - begin_time_s) / (wall_s - begin_s)
        self._span_s = wall_s, self._board.time_s
        if pace < _PACE_MIN * self._speed:
            self._on_slow(pace)
            self._on_slow = None

    def _deliver(self) -> None:
        if data := self._board.read(RADIO):
            self._radio.write(data)
        if console := self._board.read(CONSOLE):
            self._console.write(console)
            if self._pty is not None:
                self._pty.write(console)
        frames = self._board.camera_frames()
        board_s = self._board.board_time_s
        if board_s > 0 and self._camera.client:  # before that its clock does not run
            boot_s = self._board.time_s - board_s
            lines = (_picture_line(f, boot_s) for f in frames if f.time_s >= boot_s)
            self._camera.write("".join(lines).encode())

    def close(self) -> None:
        """Gives the ports up."""
        for port in (self._radio, self._camera, self._console, self._world):
            port.close()
        if self._pty is not None:
            self._pty.close()
        self._selector.close()


def _picture_line(frame: CameraFrame, boot_s: float) -> str:
    values = asdict(frame)
    return json.dumps({"t_board_s": values.pop("time_s") - boot_s, **values}) + "\n"


def parse_listen(listen: str) -> tuple[str, int]:
    """``tcp:HOST:PORT`` to (host, port); port 0 = any that is free."""
    kind, _, rest = listen.partition(":")
    host, _, port = rest.rpartition(":")
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else _PORT_MAX + 1
    if kind != "tcp" or not host or number > _PORT_MAX:
        raise InputError(f"'{listen}' is no place to listen.", f"Write it like {DEFAULT_LISTEN}.")
    return host.strip("[]"), number


def _ports(selector: selectors.BaseSelector, host: str, port: int) -> list[_Port]:
    """Bluetooth on ``port``; camera, USB serial and fault-injection port on the next ones; with
    port 0 any free neighbours."""
    for _ in range(50):
        ports: list[_Port] = []
        try:
            for number in range(_PORTS):
                ports.append(_Port(selector, host, ports[0].number + number if ports else port))
        except (ConnectError, OverflowError):
            for opened in ports:
                opened.close()
            if port != 0:
                raise
        else:
            return ports
    raise ConnectError("no free ports in a row.", "Name one: --listen tcp:127.0.0.1:5760")


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        taken = error.errno == errno.EADDRINUSE
        raise ConnectError(
            f"cannot listen on tcp:{host}:{port} ({error.strerror}).",
            "Another simulator may run there; choose another port with --listen."
            if taken
            else "Check the host name.",
        ) from error
    listener.listen(1)
    listener.setblocking(False)
    return listener


def _nothing() -> None:
    """Readable clients are read in every step anyway."""
