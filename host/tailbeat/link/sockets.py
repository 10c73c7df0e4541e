"""A board behind a TCP port: a simulated or emulated one, or a serial-to-network bridge.

A board behind UDP: ``udp:PORT`` listens for it, ``udp:HOST:PORT`` talks to it.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time

from tailbeat.core.errors import ConnectError, LinkLostError, TailbeatError, reason

_CHUNK_BYTES = 65536
_QUEUE_MAX_BYTES = 1 << 20
_HEAD_MAX_BYTES = 80
_TAKEN = b"tailbeat: another program is connected here"
_TAKEN_LINE = re.compile(re.escape(_TAKEN) + rb"(?:; USB serial on port (\d+))?\n")


def taken_line(console: int | None) -> bytes:
    """What a simulator says to a second client before it hangs up. ``console``: the port that
    reaches the same board."""
    there = "" if console is None else f"; USB serial on port {console}"
    return _TAKEN + there.encode() + b"\n"


class TcpTransport:
    """Client end of ``tcp:HOST:PORT``."""

    def __init__(self, host: str, port: int, connect_timeout_s: float = 3.0) -> None:
        self.name = f"tcp:{host}:{port}"
        self.host = host
        self.port = port
        self._connect_timeout_s = connect_timeout_s
        self._out = bytearray()
        self._head = b""  # the first bytes that came
        self._socket: socket.socket | None = None
        self.reopen()

    def reopen(self) -> None:
        """Connects anew; what was queued is dropped."""
        self.close()
        try:
            new = socket.create_connection((self.host, self.port), self._connect_timeout_s)
        except (OSError, UnicodeError) as error:  # the latter from a name that cannot be one
            raise ConnectError(
                f"nothing answers at {self.name} ({reason(error)})",
                "Start a board there, for example: tailbeat sim",
            ) from error
        new.setblocking(False)
        new.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket, self._head = new, b""

    def read(self) -> bytes:
        """All that has arrived. Raises ConnectError when another program has the port."""
        pieces: list[bytes] = []
        while True:
            try:
                piece = self._open_socket().recv(_CHUNK_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                raise self._lost() from error
            if not piece:
                if pieces:
                    break
                raise self._lost()
            pieces.append(piece)
            if len(piece) < _CHUNK_BYTES:
                break
        data = b"".join(pieces)
        if (taken := self._taken(data)) is not None:
            raise taken
        return data

    def write(self, data: bytes) -> None:
        """Sends what the socket takes; the rest goes out in later waits."""
        self._out += data
        if len(self._out) > _QUEUE_MAX_BYTES:
            raise self._lost()
        self._flush()

    def wait(self, timeout_s: float) -> None:
        """Until bytes arrive or the time is over."""
        wanted = self._open_socket()
        writers = [wanted] if self._out else []
        _, writable, _ = select.select([wanted], writers, [], max(0.0, timeout_s))
        if writable:
            self._flush()

    def now_s(self) -> float:
        """The machine's monotonic clock."""
        return time.monotonic()

    def close(self) -> None:
        """Closes the socket."""
        self._out.clear()
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket = None

    def _flush(self) -> None:
        try:
            sent = self._open_socket().send(self._out)
        except BlockingIOError:
            return
        except OSError as error:
            raise self._lost() from error
        del self._out[:sent]

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise self._lost()
        return self._socket

    def _taken(self, data: bytes) -> ConnectError | None:
        """The error when ``data`` ends a line by which the other end turns us away."""
        if len(self._head) >= _HEAD_MAX_BYTES:
            return None
        self._head = (self._head + data)[:_HEAD_MAX_BYTES]
        if (line := _TAKEN_LINE.fullmatch(self._head)) is None:
            return None
        remedy = "Go on in that program; any key there stops a trial"
        if line[1] is not None:
            console = f"tcp:{self.host}:{int(line[1])}"
            remedy += f", and so does: tailbeat stop --connect {console}"
        return ConnectError(f"another program is connected to {self.name}", remedy + ".")

    def _lost(self) -> TailbeatError:
        if self._socket is not None:  # it may have said why before it hung up
            with contextlib.suppress(OSError):
                if (taken := self._taken(self._socket.recv(_HEAD_MAX_BYTES))) is not None:
                    return taken
        if self._socket is not None and not self._head:
            return LinkLostError(
                f"{self.name} closed the connection at once",
                "It may serve one program at a time: end the other one. If the board has ended,"
                " start it and connect again.",
            )
        return LinkLostError(
            f"the connection to {self.name} broke", "See that the board still runs; connect again."
        )


_DATAGRAM_BYTES = 65536


class UdpTransport:
    """One peer. When listening, the peer is whoever spoke last."""

    def __init__(self, host: str | None, port: int) -> None:
        self.name = f"udp:{host}:{port}" if host else f"udp:{port}"
        self._host = host
        self._port = port
        self._peer: tuple[str, int] | None = None
        self._socket: socket.socket | None = None
        self.reopen()

    def reopen(self) -> None:
        """Makes the socket anew."""
        self.close()
        new = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if self._host is None:
                new.bind(("", self._port))
            else:
                self._peer = (socket.gethostbyname(self._host), self._port)
        except (OSError, UnicodeError) as error:
            new.close()
            raise ConnectError(
                f"cannot use {self.name} ({reason(error)})",
                "Check the address, and that no other program holds the port.",
            ) from error
        new.setblocking(False)
        self._socket = new

    def read(self) -> bytes:
        """All that has arrived."""
        pieces = []
        while True:
            try:
                piece, sender = self._open_socket().recvfrom(_DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:
                continue
            except OSError as error:
                raise self._lost() from error
            pieces.append(piece)
            if self._host is None:
                self._peer = (sender[0], sender[1])
        return b"".join(pieces)

    def write(self, data: bytes) -> None:
        """Datagrams nobody takes are lost, as on any radio."""
        if self._peer is None:
            return
        try:
            self._open_socket().sendto(data, self._peer)
        except (BlockingIOError, ConnectionError):
            return
        except OSError as error:
            raise self._lost() from error

    def wait(self, timeout_s: float) -> None:
        """Until a datagram arrives or the time is over."""
        select.select([self._open_socket()], [], [], max(0.0, timeout_s))

    def now_s(self) -> float:
        """The machine's monotonic clock."""
        return time.monotonic()

    def close(self) -> None:
        """Closes the socket."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise self._lost()
        return self._socket

    def _lost(self) -> LinkLostError:
        return LinkLostError(f"{self.name} cannot be used any more", "Connect again.")
