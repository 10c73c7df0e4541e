"""The USB ports of the board: which one it is, whether it is free, and the touch that erases."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import serial

from tailbeat.errors import ConnectError, reason
from tailbeat.transport.portaccess import holders
from tailbeat.transport.serialport import BAUD, ERASE_BAUD


class PortKind(Enum):
    """What is at the other end, by vendor and product id."""

    PROGRAMMING = (0x2341, 0x003D)  # the ATmega16U2 beside the chip; it stays when the chip resets
    NATIVE = (0x2341, 0x003E)  # the chip's own USB, served by an Arduino sketch
    SAM_BA = (0x03EB, 0x6124)  # the chip's own USB, served by the boot loader in its ROM


class ListedPort(Protocol):
    """What pyserial's list_ports tells of a port, as far as it matters here."""

    device: str
    vid: int | None
    pid: int | None


Enumerate = Callable[[], Iterable[ListedPort]]


@dataclass(frozen=True)
class BoardPort:
    """A port that a board is flashed by."""

    device: str
    kind: PortKind

    @property
    def by_usb(self) -> bool:
        """Whether the boot loader is reached by the chip's own USB rather than by its UART."""
        return self.kind is not PortKind.PROGRAMMING


def system_ports() -> Iterable[ListedPort]:
    """The serial ports of this computer."""
    from serial.tools import list_ports

    return list_ports.comports()


def board_ports(enumerate_ports: Enumerate) -> list[BoardPort]:
    """Every port whose VID:PID is a board's, by name."""
    kinds = {kind.value: kind for kind in PortKind}
    found = [
        BoardPort(port.device, kinds[port.vid, port.pid])
        for port in enumerate_ports()
        if port.vid is not None and port.pid is not None and (port.vid, port.pid) in kinds
    ]
    return sorted(found, key=lambda port: port.device)


def find_port(wanted: str | None, enumerate_ports: Enumerate) -> BoardPort:
    """The port called ``wanted``, or the only one there is. Raises ConnectError.

    A port of another make is refused even when it is named: touching it might erase something else.
    """
    found = board_ports(enumerate_ports)
    if wanted:
        for port in found:
            if _same_device(port.device, wanted):
                return port
        raise ConnectError(
            f"{wanted} is not a port of the board{_listing(found)}",
            "Plug the USB cable into the board's programming port; ports are told by their USB ids"
            " (2341:003d, 2341:003e, 03eb:6124).",
        )
    if not found:
        raise ConnectError(
            "no board is plugged in: no USB port has the ids 2341:003d, 2341:003e or 03eb:6124",
            "Plug a USB cable (one that carries data) into the board's programming port, the one"
            " next to the power socket.",
        )
    if len(found) > 1:
        names = ", ".join(port.device for port in found)
        raise ConnectError(
            f"several ports could be the board's: {names}",
            f"Say which one, for example --port {found[0].device}; the programming port is best.",
        )
    return found[0]


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
    line = serial.Serial(baudrate=ERASE_BAUD, exclusive=True)
    line.port = port.device
    try:
        line.open()
        line.dtr = False
        line.rts = False
        if port.kind is PortKind.PROGRAMMING:
            line.baudrate = BAUD
    except (OSError, serial.SerialException) as error:
        raise ConnectError(
            f"cannot touch {port.device} at 1200 baud ({reason(error)})",
            "Check the cable, and that no other program holds the port.",
        ) from error
    finally:
        with contextlib.suppress(OSError, serial.SerialException):
            line.close()


def _same_device(a: str, b: str) -> bool:
    return a.upper() == b.upper() if os.name == "nt" else os.path.realpath(a) == os.path.realpath(b)


def _listing(found: list[BoardPort]) -> str:
    return f" (those are: {', '.join(port.device for port in found)})" if found else ""
