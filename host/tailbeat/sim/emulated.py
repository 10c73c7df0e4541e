"""The flash image on an emulated board, with the simulated fish around it.

The board is tools/vboard: its processor executes the very image that is flashed. Its wires end in
the simulator's world: servo pulses move the fish, the camera sees the LED, the battery is on its
divider, and board and IMU understand each other when both ends of their line run at the same speed.
Camera, noise and trials are those of the simulated board: the same pulses give the same true
speeds, bit for bit.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.extras import checkout, remedy
from tailbeat.core.image import default_image, image_remedy
from tailbeat.sim.board import CONSOLE, RADIO, SimulatedBoard
from tailbeat.sim.config import DEFAULT_SEED, board_number
from tailbeat.sim.world import FRAME_US, BoardControls, Wires, World

if TYPE_CHECKING:
    from vboard.board import Board
    from vboard.core.clock import Event
    from vboard.wires.serial_line import SerialLine

ID_PREFIX = b"tailbeat"  # of the unique id; by it the firmware knows that it runs here
BAUD = 115200

# As in docs/how-to/wiring.md.
_LINES = {"USART1": RADIO, "UART": CONSOLE}
_IMU_PORT = "USART0"
_SERVO_CHANNEL = 4
_SERVO_PIN = ("PIOC", 21, "B")
_LED_PIN = ("PIOB", 27)
_BATTERY_CHANNEL = 7
_BATTERY_DIVIDER = 3
_TIME_BASE = "TC0_0"  # counts half the master clock from the start of the firmware's time on
_TIME_BASE_DIVIDER = 2
_COUNTER_WRAP = 1 << 32

_TICKS_PER_US = 84
_BITS_PER_BYTE = 10
_MIN_STEP_US = 1000
_LOOK_US = 4000  # the host looks at its end of a line this often, and waits this long for more
_IMU_LOOK_US = 2000  # while the board talks to the IMU; else once in a frame of the servo
_IMU_SYNC = 0xFA
_IMU_TALK_US = 500_000  # it goes on for so long after the last word
_IDLE_FRAME_LATE_US = 1  # a frame of the servo that is due at the same time comes first


class EmulationError(TailbeatError):
    """The image did what no correct image does, or the emulator is wrong."""


class EmulatedBoard(SimulatedBoard):
    """A SimulatedBoard that runs a flash image. ``image``: .elf or .bin; None = the one of this
    clone or of the installed package.

    Keyword overrides are the fields of sim_config_t; the links run at 115200 baud, whatever it
    says. ``seed``: None = disturbances as with 1, but a unique id of its own. ``imu_frames_sent``:
    binary frames that the IMU has put on its line so far. ``board``: the emulated board itself.
    """

    def __init__(
        self,
        image: Path | None = None,
        plant: str = "tank",
        /,
        seed: float | None = None,
        **overrides: float,
    ) -> None:
        self.image = find_image(image)
        self._wires = Wires(plant, DEFAULT_SEED if seed is None else seed, **overrides)
        self._unique_id = ID_PREFIX + board_number(seed).to_bytes(8, "little")
        super().__init__(f"vboard:{self.image}", plant, seed, self._wires.config)
        self.world = World(
            self._wires.handle,
            BoardControls(self._now_us, self._power_cycle, self._set_radio, self._plan_imu_message),
        )
        self._origin_us = round(self.config["boot_s"] * 1e6)
        self._wires.rest(self._origin_us)
        self._time_base_start: int | None = None
        self._idle_frame: Event | None = None
        self._imu_message: Event | None = None
        self._imu_look: Event | None = None
        self._imu_talk_end = 0
        self._led_on = False
        self.imu_frames_sent = 0
        self.board = self._new_board()
        self._clock = self.board.clock
        self._lines = {port: self._new_line(name, BAUD) for name, port in _LINES.items()}
        self._imu = self._new_line(_IMU_PORT, self._wires.imu_baud())
        self._received = {port: bytearray() for port in self._lines}
        self.board.wire(self._connect)
        self._plan_idle_frame()
        self._power_imu()

    # Time.

    @property
    def time_s(self) -> float:
        """Simulated time; the board gets its power at ``boot_s``."""
        return self._origin_us * 1e-6 + self._clock.now / _TICKS_PER_US * 1e-6

    @property
    def board_time_s(self) -> float:
        """The firmware's clock, from the counter it takes its time from; 0 until that runs."""
        self._follow_time_base()
        if self._time_base_start is None:
            return 0.0
        return (self._clock.now - self._time_base_start) / _TICKS_PER_US * 1e-6

    def run(self, duration_s: float, port: int = -1, camera: bool = False) -> float:
        """Lets time pass; the time left (s) when bytes on ``port`` or a picture ended it early.

        Raises EmulationError.
        """
        end = self._clock.now + max(_MIN_STEP_US, round(duration_s * 1e6)) * _TICKS_PER_US
        with _interrupt_afterwards() as pressed:
            self._run_to(end, port, camera, pressed)
        self._follow_time_base()
        return max(0, end - self._clock.now) / _TICKS_PER_US * 1e-6

    def _run_to(self, end: int, port: int, camera: bool, pressed: list[int]) -> None:
        heard_at: int | None = None
        while self._clock.now < end and not pressed:
            self._run_until(self._next_look(end, port, camera))
            if camera and self._take_pictures():
                break
            if port in self._lines and self._collect(port):
                heard_at = self._clock.now if heard_at is None else heard_at
                waited = self._clock.now - heard_at >= _LOOK_US * _TICKS_PER_US
                if waited or self._lines[port].message_due() is None:
                    break

    def _next_look(self, end: int, port: int, camera: bool) -> int:
        if port not in self._lines and not camera:
            return end
        now = self._clock.now
        look = min(end, now + _LOOK_US * _TICKS_PER_US)
        if port in self._lines and (due := self._lines[port].message_due()) is not None:
            look = min(look, max(due, now + 1))
        if camera and (due_us := self._wires.camera_due_us()) is not None:
            look = min(look, max(self._ticks(due_us), now + 1))
        return look

    def _run_until(self, tick: int) -> None:
        from vboard.core.bus import BusViolation
        from vboard.core.exceptions import Lockup

        try:
            self.board.run_until(tick)
        except (BusViolation, Lockup) as error:
            raise EmulationError(
                f"the image failed on the emulated board: {error}",
                "If it is an image of tailbeat, report a defect of the firmware or the emulator.",
            ) from error

    def _follow_time_base(self) -> None:
        """Learns from the counter when the firmware's time began; again after every reset."""
        board = self.board
        count = board.periph[_TIME_BASE].read_cv() if board.powered else 0
        if count == 0:
            self._time_base_start = None
            return
        unit = _TIME_BASE_DIVIDER * board.chip.mck_ticks()
        if self._time_base_start is not None:
            expected = (self._clock.now - self._time_base_start) // unit
            if (expected - count + 1) % _COUNTER_WRAP <= 2:
                return
        self._time_base_start = self._clock.now - count * unit

    # Links.

    def write(self, data: bytes, port: int = RADIO) -> int:
        """Bytes towards the board, at the speed of the line."""
        self._lines[port].send(data)
        return len(data)

    def read(self, port: int = RADIO) -> bytes:
        """Bytes from the board."""
        self._collect(port)
        data = bytes(self._received[port])
        self._received[port].clear()
        return data

    def _collect(self, port: int) -> bool:
        self._received[port] += self._lines[port].take()
        return bool(self._received[port])

    # The world.

    def _take_pictures(self) -> bool:
        taken = self._wires.camera_read(self._now_us())
        self._pictures += taken
        return bool(taken)

    def _power_cycle(self) -> None:
        self.board.power_cut()
        self._wires.imu_power(on=False, now_us=self._now_us())
        self.board.power_on()
        self._power_imu()

    def _set_radio(self, connected: bool) -> None:
        line = self._lines[RADIO]
        (line.plug if connected else line.cut)()

    def _storage(self) -> bytes:
        return self.board.bank1

    def _set_storage(self, image: bytes) -> None:
        self.board.bank1 = image

    # Wires.

    def _new_board(self) -> Board:
        try:
            from vboard.board import Board
            from vboard.image import ImageError
        except ImportError as error:
            raise InputError(
                f"The emulated board needs the emulator, which is not installed ({error})",
                remedy("vboard"),
            ) from error
        try:
            return Board(self.image, unique_id=self._unique_id, seed=self.seed)
        except (ImageError, OSError) as error:
            raise InputError(f"cannot boot this image: {error}", image_remedy()) from error

    def _new_line(self, name: str, baud: int) -> SerialLine:
        from vboard.wires.serial_line import SerialLine

        return SerialLine(self._clock, baud, name)

    def _connect(self) -> None:
        """Solders the wires to the chip; it is new after each power-on."""
        periph = self.board.periph
        self.board.chip.divide_traps = False  # each division would cost 20 us
        for name, port in _LINES.items():
            periph[name].connect(self._lines[port])
        periph[_IMU_PORT].connect(self._imu)
        periph["PWM"].on_period.append(self._servo_frame)
        periph[_LED_PIN[0]].on_change.append(self._show_led)
        periph["ADC"].volts[_BATTERY_CHANNEL] = self._divided_v

    def _divided_v(self) -> float:
        return self._wires.battery_v() / _BATTERY_DIVIDER

    def _show_led(self) -> None:
        """It lights at a driven pin only: a pull-up is too weak for it."""
        name, bit = _LED_PIN
        on = self.board.periph[name].drives_high(bit)
        if on != self._led_on:
            self._led_on = on
            self._wires.led(self._now_us(), on)

    def _servo_frame(self, channel: int, start: int, period: int, high: int) -> None:
        """A period of the PWM begins; its pulse is ``high`` thirds of a microsecond long."""
        del period
        if channel != _SERVO_CHANNEL:
            return
        name, bit, owner = _SERVO_PIN
        wired = self.board.periph[name].owner(bit) == owner
        self._wires.frame(self._us(start), high if wired else 0)
        self._plan_idle_frame()
        self._look_at_imu()

    def _plan_idle_frame(self) -> None:
        """Without a PWM that runs the fish goes on all the same."""
        self._clock.cancel(self._idle_frame)
        due_us = self._wires.time_us + FRAME_US + _IDLE_FRAME_LATE_US
        self._idle_frame = self._clock.at(self._ticks(due_us), self._rest)

    def _rest(self) -> None:
        self._wires.frame(self._wires.time_us + FRAME_US, 0)
        self._plan_idle_frame()
        self._look_at_imu()

    def _power_imu(self) -> None:
        self._wires.imu_power(on=True, now_us=self._now_us())
        self._plan_imu_message()

    def _plan_imu_message(self) -> None:
        """What the IMU says next, at its own speed; the line's end is set to that."""
        self._imu.set_baud(self._wires.imu_baud())
        self._clock.cancel(self._imu_message)
        due_us = self._wires.imu_due_us()
        if due_us is not None:
            self._imu_message = self._clock.at(self._ticks(due_us), self._send_imu_message)

    def _send_imu_message(self) -> None:
        if data := self._wires.imu_read():
            self._imu.send(data)
            self.imu_frames_sent += data[0] == _IMU_SYNC
        self._plan_imu_message()

    def _look_at_imu(self) -> None:
        """Hands over what the board has said to the IMU, and looks again when it has said all."""
        self._clock.cancel(self._imu_look)
        now = self._clock.now
        if chunks := self._imu.take_timed():
            for chunk in chunks:
                baud = round(_BITS_PER_BYTE * _TICKS_PER_US * 1_000_000 / chunk.char_ticks)
                self._wires.imu_write(self._now_us(), chunk.data, baud)
            self._imu_talk_end = now + _IMU_TALK_US * _TICKS_PER_US
            self._plan_imu_message()
        due = self._imu.message_due()
        if due is None and now < self._imu_talk_end:
            due = now + _IMU_LOOK_US * _TICKS_PER_US
        if due is not None:
            self._imu_look = self._clock.at(max(due, now + 1), self._look_at_imu)

    # The board's ticks count from its power-on, the world's microseconds from before that.

    def _us(self, tick: int) -> int:
        return self._origin_us + tick // _TICKS_PER_US

    def _ticks(self, time_us: int) -> int:
        return (time_us - self._origin_us) * _TICKS_PER_US

    def _now_us(self) -> int:
        return self._us(self._clock.now)


@contextmanager
def _interrupt_afterwards() -> Iterator[list[int]]:
    """Ctrl-C comes at the end: raised in a call that the emulator makes from C, it would be lost
    there, and leave a board that stopped between two instructions. The list then is not empty."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield []
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if pressed:
        raise KeyboardInterrupt


def find_image(image: Path | None) -> Path:
    """``image``, or the one there is. Raises InputError when there is none."""
    path = image or default_image(".elf" if checkout() else ".bin")
    if path.suffix not in (".elf", ".bin"):
        raise InputError(f"{path} is no flash image", "Give the .elf or the .bin that was built.")
    if not path.is_file():
        raise InputError(f"there is no flash image {path}", image_remedy())
    return path
