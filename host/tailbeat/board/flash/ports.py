"""The USB ports of the board: which one it is, whether it is free, and the touch that erases."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import serial

from tailbeat.core.errors import ConnectError, reason
from tailbeat.core.platform.ports import is_unlisted_port, same_port
from tailbeat.link.serial import (
    BAUD,
    ERASE_BAUD,
    PortKind,
    cannot_open,
    holders,
    ids_text,
    kind_of,
    may_be_16u2,
)

_RESTART_S = 2.5  # the watchdog restarts a board that hangs once a second
_RESTART_BYTES = 4096


class ListedPort(Protocol):
    """What pyserial's list_ports reports of a port, as far as it matters here."""

    device: str
    vid: int | None
    pid: int | None


Enumerate = Callable[[], Iterable[ListedPort]]


@dataclass(frozen=True)
class BoardPort:
    """A port that a board is flashed by. ``ids``: USB vendor and product, if it has them."""

    device: str
    kind: PortKind
    ids: tuple[int, int] | None = field(default=None, compare=False)

    @property
    def by_usb(self) -> bool:
        """Whether the boot loader is reached by the chip's own USB rather than by its UART."""
        return self.kind in (PortKind.NATIVE, PortKind.SAM_BA)

    @property
    def talks(self) -> bool:
        """Whether the firmware can be spoken to on it: it does not serve the chip's own USB."""
        return not self.by_usb

    @property
    def may_be_touched(self) -> bool:
        """Whether opening it at 1200 baud may erase the board. Of a port of another make the user
        is asked first."""
        return self.kind is not PortKind.OTHER or may_be_16u2(self.ids[0] if self.ids else None)


def system_ports() -> Iterable[ListedPort]:
    """The serial ports of this computer."""
    from serial.tools import list_ports

    return list_ports.comports()


def board_ports(enumerate_ports: Enumerate) -> list[BoardPort]:
    """Every port whose VID:PID is a board's, by name."""
    found = [_port(port) for port in enumerate_ports()]
    return sorted(
        (port for port in found if port.kind is not PortKind.OTHER), key=lambda port: port.device
    )


def find_port(name: str | None, enumerate_ports: Enumerate) -> BoardPort:
    """The port called ``name``, of whatever make, or the only port of a board there is. Raises
    ConnectError."""
    if name:
        return _named(name, enumerate_ports)
    found = board_ports(enumerate_ports)
    if not found:
        raise ConnectError(
            f"no board is plugged in: no USB port has the ids of one ({ids_text()})",
            "Plug a USB cable (one that carries data) into the board's programming port, the one"
            " next to the power socket. Name the port of a clone: --port PORT.",
        )
    if len(found) > 1:
        names = ", ".join(port.device for port in found)
        raise ConnectError(
            f"several ports could be the board's: {names}",
            f"Say which one, for example --port {found[0].device}; the programming port is best.",
        )
    return found[0]


def _named(name: str, enumerate_ports: Enumerate) -> BoardPort:
    for port in enumerate_ports():
        if same_port(port.device, name):
            return _port(port)
    if is_unlisted_port(name):
        return BoardPort(name, PortKind.OTHER)
    found = board_ports(enumerate_ports)
    raise ConnectError(
        f"there is no port {name}{_listing(found)}",
        "Check the cable (it must carry data) and the name.",
    )


def _port(port: ListedPort) -> BoardPort:
    ids = None if port.vid is None or port.pid is None else (port.vid, port.pid)
    return BoardPort(port.device, kind_of(port.vid, port.pid) or PortKind.OTHER, ids)


def require_free(device: str) -> None:
    """Raises ConnectError when another program has ``device`` open (as far as the system tells)."""
    users = holders(device)
    if users:
        raise ConnectError(
            f"{device} is in use by {', '.join(users)}",
            "Close that program: bytes it takes from the port are missing here.",
        )


def touch(port: BoardPort) -> None:
    """Erases the board: opens at 1200 baud and lets DTR fall. The only place that may do so.

    The ATmega16U2 then pulses ERASE for 0.5 s and RESET for 0.2 s, without further bytes. Speed and
    lines are left so that the next program to open the port does not start that again: the system
    keeps a port's speed, and at 1200 baud every change of a line erases.
    """
    try:
        with _line(port, ERASE_BAUD) as line:
            line.open()
            line.dtr = False
            line.rts = False
            if port.talks:
                line.baudrate = BAUD
    except (OSError, serial.SerialException) as error:
        raise ConnectError(
            f"cannot touch {port.device} at 1200 baud ({reason(error)})",
            "Check the cable, and that no other program holds the port.",
        ) from error


def restart(port: BoardPort) -> bytes:
    """Resets the board by a rise of DTR, and returns what it sends in the seconds after that."""
    try:
        with _line(port, BAUD) as line:
            line.timeout = _RESTART_S
            line.dtr = False
            line.open()
            line.dtr = True
            return bytes(line.read(_RESTART_BYTES))
    except (OSError, serial.SerialException) as error:
        raise cannot_open(port.device, error) from error


@contextlib.contextmanager
def _line(port: BoardPort, baud: int) -> Iterator[serial.Serial]:
    """The port, not open yet; a failure to close it is of no interest."""
    line = serial.Serial(baudrate=baud, exclusive=True)
    line.port = port.device
    try:
        yield line
    finally:
        with contextlib.suppress(OSError, serial.SerialException):
            line.close()


def _listing(found: list[BoardPort]) -> str:
    return f" (ports of boards: {', '.join(port.device for port in found)})" if found else ""
