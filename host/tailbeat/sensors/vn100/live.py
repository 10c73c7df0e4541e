"""A connected VN-100: its byte source, its set-up by the fish's own driver, and listening to it.

The driver is firmware/imu/driver.h; nothing is saved in the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import serial

from tailbeat.board.connect import tcp_address
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError, reason
from tailbeat.core.faults import (
    IMU_NEEDS_SAVE,
    IMU_NONE,
    IMU_SILENT,
    IMU_STARTING,
    ImuProblem,
    problem_info,
)
from tailbeat.core.imu_fields import error_words
from tailbeat.core.native import ffi, lib
from tailbeat.core.platform.ports import is_serial_port
from tailbeat.link.serial import SerialTransport
from tailbeat.link.sockets import TcpTransport
from tailbeat.link.transport import Transport
from tailbeat.sensors.vn100.decode import Binary, Message, Reader

VERDICT_S = 5.0
STATES = ("searching", "configuring", "waiting", "streaming")

_WRITE = "VNWRG,"
_AS_IT_IS = -1
_REGISTERS = {
    "05": "baud rate",
    "06": "ASCII output",
    "26": "mounting",
    "30": "protocol",
    "35": "heading filter",
    "75": "binary output 1",
    "76": "binary output 2",
    "77": "binary output 3",
    "85": "averaging",
}


@dataclass(frozen=True)
class Action:
    """What the line needs: bytes to send, or a speed to change to."""

    send: bytes = b""
    baud: int = 0


@dataclass(frozen=True)
class RegisterSetting:
    """A register that was written, with its values as the sensor got them."""

    register: int
    name: str
    values: str


@dataclass(frozen=True)
class Setup:
    """A sensor that streams as configured."""

    model: str
    firmware: str
    port: int
    baud: int
    found_baud: int
    rate_hz: int
    registers: tuple[RegisterSetting, ...]
    problem: ImuProblem


class Driver:
    """Tell it what comes in, then do what poll() says until it says nothing more."""

    def __init__(self, baud: int, rate_hz: int, now_s: float) -> None:
        config = ffi.new("imu_driver_config_t *")
        config.baud, config.rate_hz, config.heading = baud, rate_hz, _AS_IT_IS
        if not lib.imu_driver_config_valid(config):
            raise _senseless(baud, rate_hz)
        self.settings: dict[str, RegisterSetting] = {}
        self._found_baud = 0
        self._config = config
        self._driver = ffi.new("imu_driver_t *")
        self._sequence = ffi.new("imu_sequence_t *")
        self._frame = ffi.new("imu_frame_t *")
        self._header = bytes(ffi.buffer(lib.imu_frame_header))
        lib.imu_driver_init(self._driver, config, _us(now_s))
        lib.imu_sequence_init(self._sequence, 1_000_000_000 // rate_hz)

    @property
    def state(self) -> str:
        """searching, configuring, waiting or streaming."""
        return STATES[self._driver.state]

    @property
    def problem(self) -> ImuProblem:
        """Why it does not stream as configured."""
        return problem_info(int(self._driver.problem))

    @property
    def error(self) -> int:
        """The sensor's last error code; 0 = none."""
        return int(self._driver.error_code)

    def setup(self) -> Setup:
        """What was found and set."""
        driver = self._driver
        return Setup(
            model=ffi.string(driver.model).decode("ascii", "replace"),
            firmware=ffi.string(driver.firmware).decode("ascii", "replace"),
            port=int(driver.found_port),
            baud=int(self._config.baud),
            found_baud=self._found_baud,
            rate_hz=int(self._config.rate_hz),
            registers=tuple(self.settings.values()),
            problem=self.problem,
        )

    def received(self, count: int) -> None:
        """So many bytes came, whatever they are."""
        lib.imu_driver_bytes(self._driver, count)

    def take(self, message: Message, now_s: float) -> None:
        """A message came."""
        if self._is_frame(message):
            dt_s = ffi.new("float *")
            step = lib.imu_sequence_next(self._sequence, self._frame.time_startup_ns, dt_s)
            lib.imu_driver_frame(self._driver, step == lib.IMU_STEP_RESTART, _us(now_s))
            return
        buffer = ffi.from_buffer("uint8_t[]", message.data)
        kind = lib.IMU_BINARY if isinstance(message, Binary) else lib.IMU_LINE
        given = ffi.new(
            "imu_message_t *", {"kind": kind, "length": len(message.data), "bytes": buffer}
        )
        lib.imu_driver_message(self._driver, given, _us(now_s))

    def poll(self, now_s: float) -> Action | None:
        """What to do now."""
        action = lib.imu_driver_poll(self._driver, _us(now_s))
        self._found_baud = self._found_baud or int(self._driver.found_baud)
        if action.what == lib.IMU_DO_SET_BAUD:
            return Action(baud=int(action.baud))
        if action.what == lib.IMU_DO_SEND:
            data = bytes(ffi.buffer(action.bytes, action.length))
            self._note(data)
            return Action(send=data)
        return None

    def _is_frame(self, message: Message) -> bool:
        return (
            isinstance(message, Binary)
            and message.data.startswith(self._header)
            and lib.imu_frame_decode(ffi.from_buffer("uint8_t[]", message.data), self._frame)
        )

    def _note(self, command: bytes) -> None:
        """Keeps the last values written to each register; those that were refused end in an error
        of the whole set-up."""
        body = command.decode("ascii").strip().lstrip("$").partition("*")[0]
        if body.startswith(_WRITE):
            register, _, values = body.removeprefix(_WRITE).partition(",")
            name = _REGISTERS.get(register, "")
            self.settings[register] = RegisterSetting(int(register), name, values)


def _senseless(baud: int, rate_hz: int) -> InputError:
    if rate_hz <= 0 or 800 % rate_hz:
        return InputError(
            f"the VN-100 cannot send {rate_hz} frames per second",
            "800 / rate must be whole: 1, 2, 4, 5, 8, 10, 20, 25, 40, 50, 100, 200, 400, 800.",
        )
    if rate_hz * int(lib.NATIVE_IMU_FRAME_BYTES) * 10 > baud:
        return InputError(
            f"{baud} baud are too slow for {rate_hz} frames per second",
            "Raise --baud or lower --rate.",
        )
    return InputError(f"the VN-100 does not know {baud} baud", "Use 115200 or 460800.")


def _us(time_s: float) -> int:
    return int(time_s * 1e6)


DEFAULT_BAUD = 115200
# Likeliest first.
BAUDS = (115200, 460800, 230400, 921600, 57600, 38400, 19200, 9600, 128000)


class Source(Transport, Protocol):
    """A byte stream and the clock its waits are measured with. ``has_baud``: its speed can be set
    from here."""

    has_baud: bool

    def set_baud(self, baud: int) -> None:
        """The line's speed from now on, where it can be set."""


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
    return what.startswith("tcp:") or is_serial_port(what)


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
    "Check that the sensor has power, and shares the ground with the adapter. Its TX"
    " goes to the adapter's RX. On a Rugged, pins 8 (TX) and 9 (RX) are port 2 with 3 V logic"
    " levels. Pins 2 and 3 are port 1 with RS-232 levels; neither suits the other's adapter."
    " An output may be off, or set to the other port (first number of register 75). --config"
    " sets one up."
)


class SensorError(TailbeatError):
    """The sensor does not stream."""


@dataclass(frozen=True)
class Arrival:
    """A message and when it came, by the source's clock."""

    time_s: float
    message: Message


class LiveSensor:
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


def configure(live: LiveSensor) -> Setup:
    """Sets the sensor up; returns once it streams. Raises SensorError with the driver's problem."""
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


def find_baud(live: LiveSensor, only: int | None = None) -> int:
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
        "Check the ground and the levels: an RS-232 port needs an RS-232 adapter, a TTL"
        " port a 3.3 V one. Is the baud rate right, and is it a VN-100 at all?",
    )


def _listen(live: LiveSensor) -> list[Arrival]:
    """Until the first messages, or until it is clear that none will come."""
    end_s = live.source.now_s() + _LISTEN_S
    while live.source.now_s() < end_s and live.reader.bytes < _ENOUGH_BYTES:
        found = live.step(end_s - live.source.now_s())
        if found:
            return found
    return live.end()
