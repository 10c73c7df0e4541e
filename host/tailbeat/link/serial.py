"""USB ids of the ports by which a board is reached.

Why a serial port cannot be opened: it is not there, is somebody else's, or in use.

A board on a serial port: the radio, the programming cable, or a pty.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.core.errors import ConnectError, InputError, LinkLostError, reason
from tailbeat.core.extras import lazy
from tailbeat.core.platform.ports import port_permission_remedy, wait_for_bytes

if TYPE_CHECKING:
    import serial
else:  # not of boards that are reached by other ways
    serial = lazy("serial")
list_ports = lazy("serial.tools.list_ports")


class PortKind(Enum):
    """What is at the other end of a port."""

    PROGRAMMING = "programming port"  # an ATmega16U2 beside the chip; it stays when the chip resets
    NATIVE = "native port"  # the chip's own USB, served by an Arduino sketch
    SAM_BA = "boot loader"  # the chip's own USB, served by the boot loader in its ROM
    OTHER = "other port"  # named by the user: a clone, a custom board


# Arduino sold the Due under both vendor ids.
_DUE_VENDORS = (0x2341, 0x2A03)
_DUE_PRODUCTS = {0x003D: PortKind.PROGRAMMING, 0x003E: PortKind.NATIVE}
USB_IDS = {
    (vendor, product): kind for vendor in _DUE_VENDORS for product, kind in _DUE_PRODUCTS.items()
} | {(0x03EB, 0x6124): PortKind.SAM_BA}

# Makers of USB serial converters (CH340, FTDI, CP210x, PL2303): none of theirs is an ATmega16U2.
_CONVERTER_VENDORS = (0x1A86, 0x0403, 0x10C4, 0x067B)


def kind_of(vendor: int | None, product: int | None) -> PortKind | None:
    """What a port with these ids is; None for a port of another make."""
    if vendor is None or product is None:
        return None
    return USB_IDS.get((vendor, product))


def may_be_16u2(vendor: int | None) -> bool:
    """Whether an ATmega16U2 with other ids than the Due's may be at the other end."""
    return vendor is not None and vendor not in _CONVERTER_VENDORS


def ids_text() -> str:
    """All ids of boards, for messages."""
    return ", ".join(f"{vendor:04x}:{product:04x}" for vendor, product in USB_IDS)


CLOSE_IT = "Close that program: bytes it takes from the port are missing here."
_BUSY = (errno.EBUSY, errno.EAGAIN)
_NO_RADIO = (errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ECONNREFUSED, errno.ETIMEDOUT)


def cannot_open(path: str, error: Exception) -> ConnectError:
    """The error for a port that ``error`` kept from being opened."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return ConnectError(
            f"cannot open {path}: there is no such port{_listing()}",
            "Check the cable (it must carry data); bind a paired Bluetooth module with:"
            " sudo rfcomm bind 0 ADDRESS",
        )
    if number in (errno.EACCES, errno.EPERM):
        return ConnectError(f"cannot open {path}: you may not use it", port_permission_remedy(path))
    if number in _BUSY:
        users = ", ".join(holders(path)) or "another program"
        return ConnectError(f"cannot open {path}: it is in use by {users}", CLOSE_IT)
    if number in _NO_RADIO:
        return ConnectError(
            f"cannot open {path}: the Bluetooth module does not answer",
            "Switch the fish on, keep the antenna out of the water; if it stays, pair it again.",
        )
    return ConnectError(
        f"cannot open {path} ({reason(error)})",
        "Check the cable, that no other program holds the port, and that you may use it"
        " (on Linux: group dialout).",
    )


def _listing() -> str:
    names = sorted(port.device for port in list_ports.comports())
    return f" (there is: {', '.join(names)})" if names else " (there is none at all)"


def holders(device: str, proc: Path = Path("/proc")) -> list[str]:
    """Other programs that have ``device`` open, as "name (pid)". Linux; empty elsewhere."""
    target = os.path.realpath(device)
    found = []
    for process in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if int(process.name) == os.getpid() or not _has_open(process, target):
            continue
        name = process.name
        with contextlib.suppress(OSError):
            name = (process / "comm").read_text(errors="replace").strip()
        found.append(f"{name} ({process.name})")
    return found


def _has_open(process: Path, target: str) -> bool:
    with contextlib.suppress(OSError):  # it ended, or belongs to somebody else
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if str(descriptor.readlink()) == target:
                    return True
    return False


BAUD = 115200
ERASE_BAUD = 1200
_QUEUE_MAX_BYTES = 1 << 16


class SerialTransport:
    """8N1 without flow control, for this program alone. 1200 baud is refused: at that speed the
    programming port erases the board."""

    def __init__(self, path: str, baud: int = BAUD) -> None:
        _refuse_erasing(baud)
        self.name = path
        self._path = path
        self._baud = baud
        self._out = bytearray()
        self._port: serial.Serial | None = None
        self.reopen()

    def reopen(self) -> None:
        """Opens the port, DTR low. The system raises DTR for a moment all the same, at which the
        programming port resets the board: who opens it waits for a heartbeat."""
        self.close()
        port = serial.Serial(baudrate=self._baud, timeout=0, write_timeout=0, exclusive=True)
        port.port = self._path
        port.dtr = False
        port.rts = False
        try:
            port.open()
        except (OSError, serial.SerialException) as error:
            raise cannot_open(self._path, error) from error
        self._port = port

    def set_baud(self, baud: int) -> None:
        """Another speed from now on; what has come in is dropped. 1200 baud is refused."""
        _refuse_erasing(baud)
        self._baud = baud
        try:
            self._open_port().baudrate = baud
            self._open_port().reset_input_buffer()
        except (OSError, ValueError, serial.SerialException) as error:
            raise self._lost() from error

    def read(self) -> bytes:
        """All that has arrived."""
        port = self._open_port()
        try:
            waiting = port.in_waiting
            return bytes(port.read(waiting)) if waiting else b""
        except (OSError, TypeError, serial.SerialException) as error:
            raise self._lost() from error

    def write(self, data: bytes) -> None:
        """Sends what the driver takes; the rest goes out in later waits."""
        self._out += data
        if len(self._out) > _QUEUE_MAX_BYTES:
            del self._out[:-_QUEUE_MAX_BYTES]
        self._flush()

    def wait(self, timeout_s: float) -> None:
        """Until bytes arrive or the time is over."""
        port = self._open_port()
        timeout_s = max(0.0, timeout_s)
        if self._out:
            self._flush()
            timeout_s = min(timeout_s, 0.005)
        try:
            wait_for_bytes(port, timeout_s)
        except (OSError, ValueError, serial.SerialException) as error:
            raise self._lost() from error

    def now_s(self) -> float:
        """The machine's monotonic clock."""
        return time.monotonic()

    def close(self) -> None:
        """Closes the port."""
        self._out.clear()
        if self._port is not None:
            with contextlib.suppress(OSError, serial.SerialException):
                self._port.close()
        self._port = None

    def _flush(self) -> None:
        try:
            sent = self._open_port().write(bytes(self._out))
        except (BlockingIOError, serial.SerialTimeoutException):
            return
        except (OSError, serial.SerialException) as error:
            raise self._lost() from error
        del self._out[: sent or 0]

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise self._lost()
        return self._port

    def _lost(self) -> LinkLostError:
        return LinkLostError(
            f"the serial port {self.name} is gone", "Check cable and Bluetooth; connect again."
        )


def _refuse_erasing(baud: int) -> None:
    if baud == ERASE_BAUD:
        raise InputError("1200 baud would erase the board", f"Use {BAUD}.")


def likely_ports() -> Iterator[str]:
    """Serial ports that look like a fish: the board's own USB ids, or its radio."""
    for port in list_ports.comports():
        text = f"{port.device} {port.description} {port.name}"
        kind = kind_of(port.vid, port.pid)
        if kind in (PortKind.PROGRAMMING, PortKind.NATIVE) or is_radio(text):
            yield port.device


def is_radio(text: str) -> bool:
    """Whether a port's name or description is that of a Bluetooth radio."""
    return any(word in text.lower() for word in ("rfcomm", "hc-05", "hc-06"))
