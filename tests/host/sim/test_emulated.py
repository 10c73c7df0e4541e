"""The wires between an emulated board and the simulated world, at a board without a processor. What
a real image does with them is in tests/system/test_vboard.py."""

from __future__ import annotations

import math
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tailbeat.board import connect as find
from tailbeat.core import image as images
from tailbeat.core.errors import InputError
from tailbeat.sim import emulated as emulated_board
from tailbeat.sim.board import CONSOLE, RADIO, SimBoard
from tailbeat.sim.emulated import ID_PREFIX, EmulatedBoard, EmulationError
from tailbeat.sim.world import FRAME_US, Wires, World
from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_S, TICKS_PER_US, Clock
from vboard.wires.serial_line import SerialLine

BYTE_US = 1e7 / 115200
PERIOD = FRAME_US * TICKS_PER_US


class Port:
    """A serial port that says what the test wants."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.line: Any = None
        self.set_baud(115200)
        self._said: list[tuple[int, bytes]] = []

    def connect(self, line: SerialLine) -> None:
        self.line = line
        line.connect(self)

    def set_baud(self, baud: int) -> None:
        self._char = round(10 * TICKS_PER_S / baud)

    def say(self, data: bytes) -> None:
        begin = self._said[-1][0] if self._said else self.clock.now
        self._said.append((begin + len(data) * self._char, data))

    def sync(self) -> None:
        while self._said and self._said[0][0] <= self.clock.now:
            end, data = self._said.pop(0)
            self.line.deliver(end - (len(data) - 1) * self._char, self._char, data)

    def replan(self) -> None:
        self.sync()

    def next_sent(self) -> int | None:
        self.sync()
        return self._said[0][0] if self._said else None

    def all_sent(self) -> int | None:
        self.sync()
        return self._said[-1][0] if self._said else None


class Timer:
    """A counter of half the master clock in 32 bits."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.start: int | None = None

    def read_cv(self) -> int:
        return 0 if self.start is None else (self.clock.now - self.start) // 2 % (1 << 32)


class Pwm:
    """Channel 4 with pulses out of a list; ``wired``: the pin is handed over."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.on_period: list[Callable[[int, int, int, int], None]] = []
        self.pulses: list[int] = []
        self.wired = True
        self._event: Any = None

    def start(self) -> None:
        for call in self.on_period:
            call(3, self.clock.now, 60000, 4711)
            call(4, self.clock.now, 60000, self.pulses.pop(0) if self.pulses else 0)
        self._event = self.clock.after(PERIOD, self.start)

    def stop(self) -> None:
        self.clock.cancel(self._event)

    def owner(self, bit: int) -> str | None:
        return "B" if self.wired and bit == 21 else None


class Pio:
    """A port whose pin 27 somebody drives."""

    def __init__(self) -> None:
        self.on_change: list[Callable[[], None]] = []
        self.high = False

    def drive(self, high: bool) -> None:
        self.high = high
        for call in self.on_change:
            call()

    def drives_high(self, bit: int) -> bool:
        return self.high and bit == 27


class Adc:
    def __init__(self) -> None:
        self.volts: dict[int, Callable[[], float]] = {}


class Board:
    """As much of vboard.board.Board as an EmulatedBoard touches."""

    def __init__(self, image: Path, *, unique_id: bytes, seed: int) -> None:
        assert unique_id.startswith(ID_PREFIX) and len(unique_id) == 16
        self.image, self.seed = image, seed
        self.clock = Clock()
        self.bank1 = b"\xff" * 262144
        self.violation: str | None = None
        self.during_run: Callable[[], object] = lambda: None
        self._wires: list[Callable[[], None]] = []
        self.power_on()

    @property
    def chip(self) -> Board:
        return self

    def mck_ticks(self) -> int:
        return 1

    def wire(self, connect: Callable[[], None]) -> None:
        self._wires.append(connect)
        connect()

    def power_on(self) -> None:
        self.powered = True
        pwm = Pwm(self.clock)
        ports = {name: Port(self.clock) for name in ("USART0", "USART1", "UART")}
        timer = {"TC0_0": Timer(self.clock)}
        self.periph: dict[str, Any] = {"PWM": pwm, "PIOB": Pio(), "PIOC": pwm, "ADC": Adc()}
        self.periph |= timer | ports
        for connect in self._wires:
            connect()

    def power_cut(self) -> None:
        self.powered = False
        self.periph["PWM"].stop()
        self.periph["PIOB"].drive(False)

    def run_until(self, tick: int) -> None:
        if self.violation:
            raise BusViolation(self.violation)
        self.during_run()
        self.clock.advance(tick)


@pytest.fixture
def image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("vboard.board.Board", Board)
    path = tmp_path / "tailbeat.elf"
    path.write_bytes(b"any")
    return path


@pytest.fixture
def emulated(image: Path) -> EmulatedBoard:
    return EmulatedBoard(image)


def sine(frames: int, amplitude_rad: float = 0.6) -> list[int]:
    angle = (amplitude_rad * math.sin(2 * math.pi * i / 50) for i in range(frames))
    return [round(3 * (1500 + 572.9578 * a)) for a in angle]


def test_pulses_move_the_fish_as_they_do_in_the_simulator(emulated: EmulatedBoard) -> None:
    pulses = sine(250)
    world = Wires("tank", 1)
    fish = World(world.handle, None)  # type: ignore[arg-type]
    world.rest(2_000_000)
    for pulse in [*pulses, 0]:
        world.frame(world.time_us + FRAME_US, pulse)

    emulated.run(0.0123457)  # the PWM starts at any instant, not at a whole frame
    pwm = emulated.board.periph["PWM"]
    pwm.pulses = [0] * 20 + pulses
    pwm.start()
    emulated.run(2.0)
    assert emulated.world.truth().swimming
    assert emulated.world.truth().pulse_ticks in pulses
    emulated.run(5.0)
    assert not emulated.world.truth().swimming
    assert emulated.world.truth().swims == 1
    assert len(emulated.world.true_beats()) == 5
    assert emulated.world.true_beats().tobytes() == fish.true_beats().tobytes()
    assert emulated.world.true_speeds_25hz().tobytes() == fish.true_speeds_25hz().tobytes()


def test_without_a_pwm_that_runs_the_fish_drifts_on(emulated: EmulatedBoard) -> None:
    emulated.run(1.0)
    assert emulated.time_s - emulated.world.truth().time_s == pytest.approx(0, abs=0.0201)
    pwm = emulated.board.periph["PWM"]
    pwm.pulses = sine(1000)
    pwm.start()
    emulated.run(2.0)
    assert emulated.world.truth().swimming
    pwm.stop()
    emulated.run(1.0)
    assert not emulated.world.truth().swimming
    assert len(emulated.world.true_speeds_25hz()) == 51
    assert emulated.time_s - emulated.world.truth().time_s == pytest.approx(0, abs=0.0201)


def test_a_pulse_that_does_not_reach_the_pin_is_none(emulated: EmulatedBoard) -> None:
    pwm = emulated.board.periph["PWM"]
    pwm.wired, pwm.pulses = False, sine(100)
    pwm.start()
    emulated.run(1.0)
    assert emulated.world.truth().swims == 0


def arrived(emulated: EmulatedBoard) -> list[Any]:
    """What has reached the IMU's port of the chip since the last time."""
    port = emulated.board.periph["USART0"]
    return list(port.line.fetch(emulated.board.clock.now))


def answer(emulated: EmulatedBoard, command: bytes) -> bytes:
    """The line that comes back within 30 ms, measurements left out."""
    port = emulated.board.periph["USART0"]
    arrived(emulated)
    port.say(command + b"*XX\r\n")
    emulated.run(0.03)
    lines = b"".join(piece.data for piece in arrived(emulated)).split(b"\r\n")
    return b"".join(line for line in lines if line[:6] not in (b"$VNYMR", b""))


def test_imu_bytes_come_at_the_speed_of_their_line(emulated: EmulatedBoard) -> None:
    emulated.run(0.5)
    pieces = arrived(emulated)
    first = pieces[0]
    assert (first.data[:7], len(first.data)) == (b"$VNYMR,", 122)
    assert first.baud == 115200
    assert first.first / TICKS_PER_US == pytest.approx(260_998 + BYTE_US, abs=0.1)
    assert first.last / TICKS_PER_US == pytest.approx(260_998 + 122 * BYTE_US, abs=0.1)
    assert pieces[1].first - first.first == pytest.approx(25_000 * TICKS_PER_US, abs=100)
    emulated.world.set_imu(False)
    emulated.run(1.0)
    arrived(emulated)
    emulated.run(1.0)
    assert arrived(emulated) == []
    emulated.world.set_imu(True)
    emulated.run(0.25)
    assert len(arrived(emulated)) == 2


def test_the_board_talks_to_the_imu(emulated: EmulatedBoard) -> None:
    emulated.run(0.5)
    assert answer(emulated, b"$VNRRG,07") == b"$VNRRG,07,40*5C"
    answer(emulated, b"$VNWRG,06,0")
    arrived(emulated)
    port = emulated.board.periph["USART0"]
    begin = emulated.board.clock.now
    port.say(b"$VNRRG,07*74\r\n")
    emulated.run(0.02)
    (reply,) = arrived(emulated)
    after_us = (reply.first - begin) / TICKS_PER_US
    assert after_us == pytest.approx((14 + 1) * BYTE_US + 1000, abs=20)
    assert answer(emulated, b"$VNWRG,75,2,8,11,0129,0040").startswith(b"$VNWRG,75")
    before = emulated.imu_frames_sent
    emulated.run(1.0)
    frames = arrived(emulated)
    assert len(frames) in (99, 100, 101)
    assert abs(emulated.imu_frames_sent - before - len(frames)) <= 1
    assert {piece.data[:6] for piece in frames} == {bytes.fromhex("FA1129014000")}


def test_both_ends_must_have_the_same_speed(emulated: EmulatedBoard) -> None:
    emulated.run(0.5)
    port = emulated.board.periph["USART0"]
    answer(emulated, b"$VNWRG,06,0")
    assert answer(emulated, b"$VNWRG,05,460800").startswith(b"$VNWRG,05,460800")
    assert answer(emulated, b"$VNRRG,07") == b""
    port.set_baud(460800)
    assert answer(emulated, b"$VNRRG,07") == b"$VNRRG,07,40*5C"
    port.say(b"$VNRRG,07*74\r\n")
    emulated.run(0.02)
    assert [piece.baud for piece in arrived(emulated)] == [460800]
    emulated.world.reboot_imu()
    assert answer(emulated, b"$VNRRG,07") == b""
    emulated.run(0.5)
    assert {piece.baud for piece in arrived(emulated)} == {115200}
    emulated.world.wedge_imu()
    emulated.run(0.1)
    arrived(emulated)
    emulated.run(1.0)
    assert arrived(emulated) == []
    emulated.world.power_cycle()
    emulated.run(0.5)
    assert len(arrived(emulated)) == 10


def test_a_message_ends_the_wait_with_what_follows_it(emulated: EmulatedBoard) -> None:
    port = emulated.board.periph["USART1"]
    emulated.run(0.1)
    begin = emulated.time_s
    port.say(b"hello ")
    port.say(b"fish")
    assert emulated.run(1.0, RADIO) == pytest.approx(1.0 - 10 * BYTE_US * 1e-6, abs=1e-6)
    assert emulated.read(RADIO) == b"hello fish"
    assert emulated.time_s - begin == pytest.approx(10 * BYTE_US * 1e-6, abs=1e-6)
    port.say(bytes(200))  # 17 ms
    port.say(b"x")
    emulated.run(1.0, RADIO)
    assert len(emulated.read(RADIO)) == 201
    port.say(b"late")
    assert emulated.run(0.5, CONSOLE) == 0
    assert emulated.run(0.5, RADIO) == pytest.approx(0.5, abs=0.005)


def test_a_stream_ends_the_wait_after_4_ms(emulated: EmulatedBoard) -> None:
    port = emulated.board.periph["UART"]
    for _ in range(100):
        port.say(bytes(10))
    left = emulated.run(1.0, CONSOLE)
    assert 1.0 - left == pytest.approx(0.008, abs=0.0011)
    assert 80 <= len(emulated.read(CONSOLE)) <= 110


def test_bytes_reach_the_board_unless_the_radio_is_cut(emulated: EmulatedBoard) -> None:
    port = emulated.board.periph["USART1"]
    assert emulated.write(b"hello", RADIO) == 5
    emulated.run(0.01)
    assert [piece.data for piece in port.line.fetch(emulated.board.clock.now)] == [b"hello"]
    emulated.world.set_radio(False)
    emulated.write(b"lost", RADIO)
    emulated.run(0.01)
    assert list(port.line.fetch(emulated.board.clock.now)) == []
    emulated.world.set_radio(True)
    emulated.write(b"back", RADIO)
    emulated.run(0.01)
    assert [piece.data for piece in port.line.fetch(emulated.board.clock.now)] == [b"back"]


def test_pictures_end_a_wait_and_stop_with_the_camera(emulated: EmulatedBoard) -> None:
    emulated.camera_frames()
    begin = emulated.time_s
    assert emulated.run(1.0, RADIO, camera=True) > 0.9
    assert emulated.run(1.0, RADIO, camera=True) > 0.9
    frames = emulated.camera_frames()
    assert len(frames) == 2
    assert frames[1].time_s - frames[0].time_s == pytest.approx(0.04)
    assert emulated.time_s - frames[1].time_s == pytest.approx(0.08, abs=1e-6)
    assert emulated.time_s - begin < 0.081
    emulated.world.set_camera(False)
    emulated.run(0.5)
    emulated.camera_frames()
    assert emulated.run(0.5, RADIO, camera=True) == 0


def test_led_is_in_the_pictures_to_the_microsecond(emulated: EmulatedBoard) -> None:
    def drive(high: bool) -> None:
        emulated.board.periph["PIOB"].drive(high)

    emulated.run(0.099)  # 1.799; mid-exposures at 1.8132, 1.8532, 1.8932, each 10 ms long
    for wait_s, high in ((0.0122, True), (0.001, True), (0.002, False), (0.038, True)):
        emulated.run(wait_s)
        drive(high)
    emulated.run(0.2)
    led = {round(frame.time_s, 4): frame.led for frame in emulated.camera_frames()}
    assert (led[1.7732], led[1.8132], led[1.8532]) == pytest.approx((0.0, 0.3, 0.6))
    assert led[1.8932] == 1.0


def test_led_is_out_without_power(emulated: EmulatedBoard) -> None:
    emulated.board.periph["PIOB"].drive(True)
    emulated.run(0.05)
    emulated.world.power_cycle()
    emulated.run(0.2)
    assert [frame.led for frame in emulated.camera_frames()[-2:]] == [0.0, 0.0]


def test_board_time_is_that_of_the_firmwares_counter(emulated: EmulatedBoard) -> None:
    emulated.run(0.01)
    assert emulated.board_time_s == 0
    emulated.board.periph["TC0_0"].start = emulated.board.clock.now - 8400
    for _ in range(250):  # the counter wraps after 102 s
        emulated.run(1.0)
    assert emulated.board_time_s == pytest.approx(250.0001, abs=1e-7)
    assert emulated.time_s == pytest.approx(1.7 + 250.01, abs=1e-7)
    emulated.board.periph["TC0_0"].start = emulated.board.clock.now
    emulated.run(2.0)
    assert emulated.board_time_s == pytest.approx(2.0, abs=1e-7)


def test_power_cycle_starts_everything_anew_but_the_flash(emulated: EmulatedBoard) -> None:
    emulated.flash = bytes(1000) + b"\xff" * 261144
    old = emulated.board.periph["USART0"]
    emulated.board.periph["TC0_0"].start = 0
    emulated.run(3.0)
    emulated.world.power_cycle()
    assert emulated.board.periph["USART0"] is not old
    assert emulated.board_time_s == 0
    begin = emulated.board.clock.now
    list(old.line.fetch(begin))
    emulated.run(0.5)
    arrivals = list(emulated.board.periph["USART0"].line.fetch(emulated.board.clock.now))
    assert (arrivals[0].first - begin) / TICKS_PER_US == pytest.approx(260_998 + BYTE_US, abs=2)
    assert emulated.flash[:1001] == bytes(1000) + b"\xff"


def test_battery_is_on_its_divider(image: Path) -> None:
    emulated = EmulatedBoard(image, battery_sag_v_per_trial=0.3)
    volts = emulated.board.periph["ADC"].volts[7]
    assert volts() == pytest.approx(8.2 / 3)
    emulated.board.periph["PWM"].pulses = sine(50)
    emulated.board.periph["PWM"].start()
    emulated.run(0.5)
    assert volts() == pytest.approx(7.9 / 3)
    emulated.world.set_battery_v(6.3)
    assert volts() == pytest.approx(6.0 / 3)


def test_a_fish_is_handled_as_the_simulated_one(image: Path) -> None:
    simulated, emulated = SimBoard("tank"), EmulatedBoard(image)
    for board in (simulated, emulated):
        board.world.place(0.1, 0.2, 0.3)
        board.world.stir(0.02)
        board.run(1.5)
        board.world.hold(1.0)
        board.run(2.0)
        board.world.push(-0.05)
        board.run(1.0)
    one, other = simulated.world.truth(), emulated.world.truth()
    assert one.x_m < 0.1 < 0.18 < one.y_m < 0.2
    assert one.v_m_s < -0.02
    for name in ("x_m", "y_m", "heading_rad", "v_m_s"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), abs=2e-3)


def test_another_pack_is_a_new_start(image: Path) -> None:
    emulated = EmulatedBoard(image, battery_v=6.5)
    emulated.run(1.0)
    emulated.flash = bytes(1000) + emulated.flash[1000:]
    before = emulated.board.periph["PWM"]
    emulated.world.swap_battery(8.3, 0.97, 0.02)
    assert emulated.board.periph["PWM"] is not before
    assert emulated.board.periph["ADC"].volts[7]() == pytest.approx(8.3 / 3)
    assert emulated.flash[:1000] == bytes(1000)
    with pytest.raises(InputError):
        emulated.world.swap_battery(800.0)


def test_address_with_values(image: Path) -> None:
    url = f"vboard:{image}?plant=thesis&seed=9&mass=0.5&imu_baud=460800&imu_port=1"
    emulated = find.open_transport(url, camera_fps=50.0).board
    assert (emulated.plant, emulated.seed) == ("thesis", 9)
    assert (emulated.config["mass_kg"], emulated.config["camera_fps"]) == (0.5, 50.0)
    assert (emulated.config["imu_baud"], emulated.config["imu_port"]) == (460800, 1)
    assert emulated.board.seed == 9
    emulated.run(1.261)
    pieces = arrived(emulated)
    assert {piece.baud for piece in pieces} == {460800}
    assert len(b"".join(piece.data for piece in pieces)) == 40 * 122


@pytest.mark.parametrize(
    "query",
    ["plant=pond", "seed=x", "nonsense=1", "imu_rate_hz=200", "kappa=-1", "seed=-1", "image=1",
     "self=1", "imu_baud=nan", "imu_baud=100000", "imu_port=3", "imu_firmware=1"],
)  # fmt: skip
def test_senseless_values(image: Path, query: str) -> None:
    with pytest.raises(InputError) as bad:
        find.open_transport(f"vboard:{image}?{query}")
    assert "\n" not in str(bad.value)
    assert bad.value.remedy


def test_the_image_is_that_of_the_clone_or_of_the_package(
    image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(images, "checkout", lambda: tmp_path)
    monkeypatch.setattr(emulated_board, "checkout", lambda: tmp_path)
    with pytest.raises(InputError, match=r"build/firmware/tailbeat\.elf.*make firmware"):
        find.open_transport("vboard")
    built = tmp_path / "build" / "firmware" / "tailbeat.elf"
    built.parent.mkdir(parents=True)
    image.rename(built)
    assert find.open_transport("vboard").board.image == built
    monkeypatch.setattr(images, "checkout", lambda: None)
    monkeypatch.setattr(emulated_board, "checkout", lambda: None)
    monkeypatch.setattr(images, "PACKAGED", tmp_path / "tailbeat.bin")
    with pytest.raises(InputError, match=r"tailbeat\.bin.*Reinstall tailbeat from a wheel"):
        find.open_transport("vboard")


def test_what_is_no_image(tmp_path: Path) -> None:
    page, text = tmp_path / "page.html", tmp_path / "text.elf"
    page.write_text("hello")
    text.write_text("hello")
    with pytest.raises(InputError, match="is no flash image"):
        EmulatedBoard(page)
    with pytest.raises(InputError, match="cannot boot this image"):
        EmulatedBoard(text)


def test_emulator_that_is_not_installed(image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "vboard.board", None)
    with pytest.raises(InputError, match="tools/bootstrap vboard"):
        EmulatedBoard(image)


def test_what_no_correct_image_does_is_an_error(emulated: EmulatedBoard) -> None:
    emulated.board.violation = "store to unknown register"
    with pytest.raises(EmulationError, match="store to unknown register"):
        emulated.run(1.0)


def test_ctrl_c_lets_the_emulator_finish_its_step(emulated: EmulatedBoard) -> None:
    emulated.board.during_run = lambda: signal.raise_signal(signal.SIGINT)
    before = emulated.board.clock.now
    with pytest.raises(KeyboardInterrupt):
        emulated.run(0.001)
    assert emulated.board.clock.now == before + TICKS_PER_S // 1000
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_is_left_to_who_asked_for_it(emulated: EmulatedBoard) -> None:
    pressed: list[int] = []
    old = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        emulated.board.during_run = lambda: signal.raise_signal(signal.SIGINT)
        emulated.run(0.001)
    finally:
        signal.signal(signal.SIGINT, old)
    assert pressed == [signal.SIGINT]


def test_time_passes_for_sure(emulated: EmulatedBoard) -> None:
    before = emulated.board.clock.now
    assert emulated.run(0.0) == 0
    assert emulated.board.clock.now == before + TICKS_PER_S // 1000
