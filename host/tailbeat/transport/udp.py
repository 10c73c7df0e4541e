"""A board behind UDP: ``udp:PORT`` listens for it, ``udp:HOST:PORT`` talks to it."""

from __future__ import annotations

import select
import socket
import time

from tailbeat.errors import ConnectError, LinkLostError, reason

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
