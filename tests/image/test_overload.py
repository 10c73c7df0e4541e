"""Everything at once while the tail swims: the IMU, the log, a pulled trial, a busy console."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise

import pytest
from littlefs import LittleFS, UserContext

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Link
from tailbeat.sensors.camera.tracking.live import BeatFit
from tailbeat.session.trial_camera import default_camera, vision_message
from tailbeat.sim.board import CONSOLE, FLASH_BYTES, SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_US
from vboard.periph.pins import PinTrace

BEATS, SETTLE_S = 6, 2.0  # the log is synced at 0, 5 s and at the end
FRAMES_PER_BEAT, FRAME_TICKS = 50, 20_000 * TICKS_PER_US
SERVO_PIN, SERVO_CHANNEL = 21, 4  # of port C, PWML4
IMU_TROUBLES = (
    "imu_crc_failed", "imu_implausible", "imu_skipped_bytes", "imu_header_rejects",
    "imu_checksum_failed", "serial_overruns",
)  # fmt: skip
IMU, RADIO_LINE, CONSOLE_LINE = "USART0", "USART1", "UART"

PAUSE_MAX_US = 100_000
TYPICAL_PAGE_US, SLOWEST_PAGE_US = 4600, 10_000

BLOCK_BYTES = 2048
LOGS, LOG_BYTES = 13, 16_000  # all that there is room for, of the thesis's profile
SMALL_LOGS, SMALL_LOG_BYTES = 52, 2230  # the same, of one beat
PULLED = 7
LONG_BEATS = 300

NewBoard = Callable[..., EmulatedBoard]
Connect = Callable[[EmulatedBoard], Fish]


def log_content(number: int, length: int) -> bytes:
    return random.Random(number).randbytes(length)


def flash_with_logs(count: int, length: int) -> bytes:
    """What the storage flash of a board holds that has swum ``count`` trials."""
    disk = UserContext(FLASH_BYTES)
    fs = LittleFS(
        context=disk, block_size=BLOCK_BYTES, block_count=FLASH_BYTES // BLOCK_BYTES,
        read_size=16, prog_size=256, cache_size=256,
    )  # fmt: skip
    for folder in ("/trials", "/in"):
        fs.mkdir(folder)
    for number in range(1, count + 1):
        with fs.open(f"/trials/{number:04d}.ulg", "wb") as file:
            file.write(log_content(number, length))
    return bytes(disk.buffer)


@dataclass
class Hosts:
    """Both hosts of a swimming board: the one on the radio sends the camera's speeds and pulls a
    trial, over and over; the one on the console reads all parameters, over and over."""

    fish: Fish
    console: Link
    pulls: int = 0
    parameters: int = 0

    def __post_init__(self) -> None:
        camera = default_camera(self.fish)
        assert camera is not None
        self.camera, self.fit = camera, BeatFit(1.0, camera.fps)
        self.fish.link.subscribe(lambda _: self.work())  # something comes every few milliseconds
        self.console.subscribe(self.hear_console)
        self.ask_for_parameters()

    def work(self) -> None:
        """What is due, without waiting."""
        self.console.pump()
        for picture in self.camera.frames():
            sample = self.fit.add(picture.t_s, picture.x_m)
            if sample is not None:
                at_s = self.fish.clock.board_s(sample.t_s)
                self.fish.link.send(vision_message(at_s, sample))

    def ask_for_parameters(self) -> None:
        self.console.send(mavlink.MAVLink_param_request_list_message(BOARD_SYSTEM, BOARD_COMPONENT))

    def hear_console(self, message: mavlink.MAVLink_message) -> None:
        if message.get_type() == "PARAM_VALUE":
            self.parameters += 1
            if message.param_index == message.param_count - 1:
                self.ask_for_parameters()

    def pull_while_it_swims(self) -> None:
        """Swims the next trial; back when it is stored."""
        fish, wanted = self.fish, log_content(PULLED, LOG_BYTES)
        fish.arm()
        fish.link.run(0.3)
        number = float(fish.status().next_trial)
        fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_START, number, fish.clock.now_s())
        while fish.status().state != "IDLE":
            assert fish.ftp.read(f"/trials/{PULLED:04d}.ulg") == wanted
            self.pulls += 1


def prepared(board: EmulatedBoard, connect: Connect, imu_rate_hz: int, imu_baud: int) -> Fish:
    """A board that has booted with such an IMU and has set it up; a reference is there."""
    fish = connect(board)
    fish.params.set("IMU_BAUD", imu_baud)
    fish.params.set("IMU_RATE_HZ", imu_rate_hz)
    fish.params.set("SETTLE_S", SETTLE_S)
    fish.params.save()
    fish.upload_reference(records.encode_reference(1.0, [0.04] * BEATS))
    board.world.power_cycle()
    board.imu_frames_sent = 0
    fish = connect(board)
    imu = fish.imu_verdict()
    assert (imu.state, imu.problem.name) == ("streaming", "NONE")
    assert (imu.baud, imu.rate_hz) == (imu_baud, imu_rate_hz)
    return fish


@pytest.mark.parametrize(
    ("imu_rate_hz", "imu_baud", "page_us"),
    [pytest.param(100, 115200, TYPICAL_PAGE_US, marks=pytest.mark.soak),
     pytest.param(400, 460800, TYPICAL_PAGE_US, marks=pytest.mark.soak),
     (400, 460800, SLOWEST_PAGE_US)],
)  # fmt: skip
def test_nothing_is_lost_and_nothing_is_late(
    new_board: NewBoard, connect: Connect, imu_rate_hz: int, imu_baud: int, page_us: int
) -> None:
    board = new_board()
    board.flash = flash_with_logs(LOGS, LOG_BYTES)
    fish = prepared(board, connect, imu_rate_hz, imu_baud)
    chip = board.board.periph
    lines = [chip[name].line for name in (IMU, RADIO_LINE, CONSOLE_LINE)]
    before = fish.health()  # while the IMU is found, bytes come at the wrong speed
    chip["EEFC1"].timing.erase_write_us = page_us
    lost_before = [asdict(line.lost) for line in lines]
    trace = PinTrace(board.board.clock, SERVO_PIN, SERVO_CHANNEL)
    trace.connect(chip["PIOC"], chip["PWM"])
    hosts = Hosts(fish, Link(SimTransport(board, CONSOLE)))

    hosts.pull_while_it_swims()
    status = fish.status()
    board.world.set_imu(False)
    board.run(0.1)
    health = fish.health()
    print(
        f"IMU {imu_rate_hz} Hz at {imu_baud} baud, {page_us / 1000:.1f} ms a page: longest pause"
        f" {health['longest_pause_us'] / 1000:.0f} ms; {health['imu_frames']} IMU frames,"
        f" {hosts.pulls} pulls, {hosts.parameters} parameters"
    )

    assert (status.pending_trial, status.beat) == (LOGS + 1, BEATS)
    assert status.fault.name == "NONE"
    assert health["vision_accepted"] > 25 * (BEATS - 2)
    assert hosts.pulls >= 3
    assert hosts.parameters > 1000

    assert health["imu_frames"] == board.imu_frames_sent
    assert board.imu_frames_sent > imu_rate_hz * BEATS
    for name in IMU_TROUBLES:
        assert health[name] == before[name], name
    assert (health["imu_lost"], health["imu_restarts"]) == (0, 0)
    assert [asdict(line.lost) for line in lines] == lost_before
    bad_frames = fish.link.framer.bad_frames + hosts.console.framer.bad_frames
    assert (health["link_bad_frames"], bad_frames) == (0, 0)

    assert (health["late_ticks"], health["store_failures"]) == (0, 0)
    starts = [pulse.start for pulse in trace.pulses()]
    assert len(starts) >= BEATS * FRAMES_PER_BEAT
    assert {later - earlier for earlier, later in pairwise(starts)} == {FRAME_TICKS}
    assert int(health["longest_pause_us"]) <= PAUSE_MAX_US


@pytest.fixture
def crowded(new_board: NewBoard, connect: Connect) -> Fish:
    """A board full of small logs."""
    board = new_board()
    board.flash = flash_with_logs(SMALL_LOGS, SMALL_LOG_BYTES)
    return connect(board)


def test_many_logs_do_not_keep_it_from_booting(crowded: Fish) -> None:
    fish = crowded
    assert [trial.number for trial in fish.trials()] == [*range(1, SMALL_LOGS + 1)]
    assert fish.status().next_trial == SMALL_LOGS + 1
    health = fish.health()
    assert health["reset_cause"] == "power"
    assert int(health["longest_pause_us"]) <= PAUSE_MAX_US


def test_room_for_a_long_trial_among_many_logs(crowded: Fish) -> None:
    fish = crowded
    fish.upload_reference(records.encode_reference(1.0, [0.001] * LONG_BEATS))
    fish.arm()
    number = float(fish.status().next_trial)
    fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_START, number, fish.clock.now_s())
    status, health = fish.status(), fish.health()
    assert status.state == "RUNNING"
    assert health["reset_cause"] == "power"
    assert (health["late_ticks"], health["store_failures"]) == (0, 0)
    assert SMALL_LOGS - len(fish.trials()) > 20  # it took a while to remove them
