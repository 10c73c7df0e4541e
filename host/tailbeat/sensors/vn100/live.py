"""Where live bytes of a VN-100 come from: a serial port, or a bridge to one behind TCP.

Listening to a VN-100 that is connected to this machine, and setting it up.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial

from tailbeat.board.connect import tcp_address
from tailbeat.core.errors import LinkLostError, TailbeatError, reason
from tailbeat.core.faults import IMU_NEEDS_SAVE, IMU_NONE, IMU_SILENT, IMU_STARTING
from tailbeat.core.imu_fields import error_words
from tailbeat.link.serial import SerialTransport
from tailbeat.link.sockets import TcpTransport
from tailbeat.sensors.vn100.decode import Message, Reader
from tailbeat.sensors.vn100.driver import VERDICT_S, Driver, Setup

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


# No message has a gap like this in it, however a USB adapter gathers its bytes.
_SILENCE_S = 0.1
_LISTEN_S = 1.2  # the slowest output comes once per second
_ENOUGH_BYTES = 4 * 600  # without one message among them: the wrong speed
_STEP_S = 0.01

WIRING = (
    "Check, in this order: the sensor has power and shares the ground with the adapter; its TX"
    " goes to the adapter's RX. On a Rugged, pins 8 (TX) and 9 (RX) are port 2 with 3 V logic"
    " levels, pins 2 and 3 are port 1 with RS-232 levels, and neither suits the other's adapter."
    " An output may be off, or set to the other port (the first number of register 75): --config"
    " sets one up."
)


class SensorError(TailbeatError):
    """The sensor does not stream."""


@dataclass(frozen=True)
class Arrival:
    """A message and when it came, by the source's clock."""

    time_s: float
    message: Message


class Live:
    """One live source. With a driver the sensor is kept set up, otherwise only listened to."""

    def __init__(self, source: Source, driver: Driver | None = None) -> None:
        self.source = source
        self.driver = driver
        self.reader = Reader()
        self.pending: list[Arrival] = []
        self._last_bytes_s = source.now_s()
        self._holding = False

    def step(self, timeout_s: float) -> list[Arrival]:
        """Waits once, at most ``timeout_s``; what came, and what the driver wants, is done."""
        self._drive()
        self.source.wait(timeout_s)
        data = self.source.read()
        now_s = self.source.now_s()
        messages = self._read(data, now_s)
        if self.driver is not None:
            self.driver.received(len(data))
            for message in messages:
                self.driver.take(message, now_s)
        return [Arrival(now_s, message) for message in messages]

    def batches(self, seconds: float | None = None) -> Iterator[list[Arrival]]:
        """What comes, as it comes, for so long or for ever; an empty list now and then when
        nothing does."""
        yield self.pending
        self.pending = []
        end_s = None if seconds is None else self.source.now_s() + seconds
        while end_s is None or self.source.now_s() < end_s:
            left_s = _SILENCE_S if end_s is None else end_s - self.source.now_s()
            yield self.step(min(left_s, _STEP_S if self.driver else _SILENCE_S))

    def end(self) -> list[Arrival]:
        """Nothing more will come: messages in what was held back."""
        now_s = self.source.now_s()
        return [Arrival(now_s, message) for message in self.reader.end()]

    def _read(self, data: bytes, now_s: float) -> list[Message]:
        if data:
            self._last_bytes_s = now_s
            self._holding = True
            return self.reader.push(data)
        if self._holding and now_s - self._last_bytes_s > _SILENCE_S:
            self._holding = False
            return self.reader.end()
        return []

    def _drive(self) -> None:
        driver = self.driver
        while driver and (action := driver.poll(self.source.now_s())):
            if action.baud:
                self.source.set_baud(action.baud)
                self.source.read()
                self.reader = Reader()
            else:
                self.source.write(action.send)


def configure(live: Live) -> Setup:
    """Sets the sensor up; returns once it streams. Raises SensorError with the driver's verdict."""
    driver = live.driver
    assert driver is not None
    end_s = live.source.now_s() + VERDICT_S + 1.0
    while driver.state != "streaming" and live.source.now_s() < end_s:
        live.step(_STEP_S)
        if driver.problem.number not in (IMU_NONE, IMU_STARTING, IMU_NEEDS_SAVE):
            break
    if driver.state != "streaming":
        problem = driver.problem
        said = f" (it said: {error_words(driver.error)})" if driver.error else ""
        remedy = WIRING if problem.number == IMU_SILENT else problem.remedy
        raise SensorError(f"{live.source.name}: {problem.meaning}{said}", remedy)
    live.reader.count_anew()
    return driver.setup()


def find_baud(live: Live, only: int | None = None) -> int:
    """Listens at one speed after the other, or at ``only`` one, until messages come; returns the
    speed and leaves the source at it. Raises SensorError with hints."""
    searches = only is None and live.source.has_baud
    heard_bytes = 0
    for number, baud in enumerate(BAUDS if searches else (only or DEFAULT_BAUD,)):
        live.source.set_baud(baud)
        live.source.read()
        live.reader = Reader()
        live.pending = _listen(live)
        if live.pending:
            return baud
        heard_bytes += live.reader.bytes
        if not heard_bytes and number > 0:
            break  # a sensor that sends is heard at any speed, if only as garbage
    raise _unheard(live.source, heard_bytes, searches, only)


def _unheard(source: Source, heard_bytes: int, searched: bool, only: int | None) -> SensorError:
    if not heard_bytes:
        return SensorError(f"nothing comes from {source.name}", WIRING)
    tried = f" at {only} baud" if only else ""
    if searched:
        tried = " at any baud rate it knows"
    return SensorError(
        f"{heard_bytes} bytes came from {source.name} but no message of a VN-100{tried}",
        "Check the ground, and that the levels fit: an RS-232 port wants an RS-232 adapter, a TTL"
        " port a 3.3 V one. Is the baud rate right, and is it a VN-100 at all?",
    )


def _listen(live: Live) -> list[Arrival]:
    """Until the first messages, or until it is clear that none will come."""
    end_s = live.source.now_s() + _LISTEN_S
    while live.source.now_s() < end_s and live.reader.bytes < _ENOUGH_BYTES:
        found = live.step(end_s - live.source.now_s())
        if found:
            return found
    return live.end()
