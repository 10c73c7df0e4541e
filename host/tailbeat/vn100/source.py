"""Where live bytes of a VN-100 come from: a serial port, or a bridge to one behind TCP."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Protocol

import serial

from tailbeat.errors import LinkLostError, reason
from tailbeat.transport.find import tcp_address
from tailbeat.transport.serialport import SerialTransport
from tailbeat.transport.tcp import TcpTransport

DEFAULT_BAUD = 115200
# Likeliest first.
BAUDS = (115200, 460800, 230400, 921600, 57600, 38400, 19200, 9600, 128000)


class Source(Protocol):
    """A byte stream and the clock its waits are measured with, like Transport. ``has_baud``: its
    speed can be set from here."""

    name: str
    has_baud: bool

    def read(self) -> bytes:
        """What has arrived; never blocks. Raises LinkLostError when the other end is gone."""

    def write(self, data: bytes) -> None:
        """Queues bytes for sending; never blocks."""

    def wait(self, timeout_s: float) -> None:
        """Returns after ``timeout_s``, or earlier when there may be bytes to read."""

    def now_s(self) -> float:
        """The clock. Monotonic, any origin."""

    def set_baud(self, baud: int) -> None:
        """The line's speed from now on, where it can be set."""

    def close(self) -> None:
        """Gives it up; may be called twice."""


class SerialSource(SerialTransport):
    """A serial port of this machine."""

    has_baud = True

    def set_baud(self, baud: int) -> None:
        """Changes the speed of the open port."""
        self._baud = baud
        try:
            self._open_port().baudrate = baud
        except (OSError, ValueError, serial.SerialException) as error:
            raise LinkLostError(
                f"{self.name} does not run at {baud} baud ({reason(error)})",
                "Use another adapter, or another --baud.",
            ) from error


class TcpSource(TcpTransport):
    """A bridge; the speed of the line behind it is set there."""

    has_baud = False

    def set_baud(self, baud: int) -> None:
        """Not ours to set."""
        del baud


def is_port(what: str) -> bool:
    """Whether this means a live source rather than a file."""
    if what.startswith("tcp:"):
        return True
    if sys.platform == "win32":
        return what.upper().removeprefix("\\\\.\\").startswith("COM")
    return Path(what).is_char_device()


def open_source(what: str, baud: int = DEFAULT_BAUD) -> Source:
    """The source that ``what`` means. Raises ConnectError, InputError."""
    if what.startswith("tcp:"):
        return TcpSource(*tcp_address(what))
    return SerialSource(what, baud)
