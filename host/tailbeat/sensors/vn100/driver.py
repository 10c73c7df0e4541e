"""Sets a VN-100 up with the fish's own driver (firmware/imu/driver.h). Nothing is saved in it."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.core.errors import InputError
from tailbeat.core.faults import ImuProblem, problem_info
from tailbeat.core.native import ffi, lib
from tailbeat.sensors.vn100.decode import Binary, Message

VERDICT_S = 5.0
DEFAULT_RATE_HZ = 100
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
class Setting:
    """A register that was written, with its values as the sensor got them."""

    register: int
    name: str
    values: str


@dataclass(frozen=True)
class Setup:
    """A sensor that streams as wanted."""

    model: str
    firmware: str
    port: int
    baud: int
    found_baud: int
    rate_hz: int
    registers: tuple[Setting, ...]
    problem: ImuProblem


class Driver:
    """Tell it what comes in, then do what poll() says until it says nothing more."""

    def __init__(self, baud: int, rate_hz: int, now_s: float) -> None:
        config = ffi.new("imu_driver_config_t *")
        config.baud, config.rate_hz, config.heading = baud, rate_hz, _AS_IT_IS
        if not lib.imu_driver_config_valid(config):
            raise _senseless(baud, rate_hz)
        self.settings: dict[str, Setting] = {}
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
        """Why it does not stream as wanted."""
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
            self.settings[register] = Setting(int(register), name, values)


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
