"""A real board on a serial port."""

from __future__ import annotations

import time

import serial

from conformance.boards import Battery, Unmeasured

BAUD = 115200


class SerialBoard(Unmeasured):
    """The board whose console is the serial port ``port``."""

    def __init__(self, port: str, battery: Battery | None = None, baud: int = BAUD) -> None:
        super().__init__(battery=battery)
        self.name = port
        self._port = serial.Serial(port, baud, timeout=0)

    def now_s(self) -> float:
        """The host's clock."""
        return time.monotonic()

    def write(self, data: bytes) -> None:
        """Bytes for the console."""
        self._port.write(data)

    def read(self, most_s: float) -> bytes:
        """Bytes of the console."""
        self._port.timeout = most_s
        first: bytes = self._port.read(1)
        self._port.timeout = 0
        rest: bytes = self._port.read(4096) if first else b""
        return first + rest

    def close(self) -> None:
        """Closes the port."""
        self._port.close()
