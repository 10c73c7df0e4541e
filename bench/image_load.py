"""How busy the fish's processor is: the flash image on the emulated chip, in simulated time.

The emulator counts instructions and the time slept in WFI; how long an instruction takes it does
not know and assumes (flash wait states and the pipeline make it 1 to 3 cycles on the chip). So the
share of time is an estimate, the numbers of instructions are not.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import TailbeatError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Message
from tailbeat.sensors.camera.tracking.live import BeatFit
from tailbeat.session.trial_camera import default_camera, vision_message
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.chip import CYCLES_PER_INSTRUCTION
from vboard.core.clock import TICKS_PER_S

TICK_EXCEPTION = 16 + 36  # of the PWM
LAST_TRIAL = "/trials/0001.ulg"


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    measured_s: float
    ticks: int
    beats: int
    imu_rates: tuple[tuple[int, int], ...]  # Hz, baud


FULL = Load(
    measured_s=4.0, ticks=25, beats=12, imu_rates=((100, 115200), (200, 230400), (400, 460800))
)
TINY = Load(measured_s=0.1, ticks=1, beats=3, imu_rates=((100, 115200),))


@dataclass(frozen=True)
class Busy:
    """What was measured of ``simulated_s`` seconds."""

    simulated_s: float
    busy_share: float
    instructions: int
    tick_instructions: list[int]
    cpu_s: float


def new_fish(imu_rate_hz: int, imu_baud: int, beats: int) -> Fish:
    """A board whose IMU streams, with a reference."""
    board = EmulatedBoard()
    transport = SimTransport(board)
    hear_board(transport)
    fish = Fish(transport)
    fish.clock.sync()
    fish.params.set("IMU_BAUD", imu_baud)
    fish.params.set("IMU_RATE_HZ", imu_rate_hz)
    imu = fish.imu_verdict()
    if not imu.problem.well:
        raise TailbeatError(imu.problem.meaning, imu.problem.remedy)
    fish.upload_reference(records.encode_reference(1.0, [0.04] * beats))
    return fish


def board_of(fish: Fish) -> EmulatedBoard:
    assert isinstance(fish.sim, EmulatedBoard)
    return fish.sim


def send_speeds(fish: Fish) -> None:
    """From now on the camera's speeds go to the board whenever something comes from it."""
    camera = default_camera(fish)
    assert camera is not None
    fit = BeatFit(1.0, camera.fps)

    def send(_: Message) -> None:
        for picture in camera.frames():
            if (sample := fit.add(picture.t_s, picture.x_m)) is not None:
                at_s = fish.clock.board_s(sample.t_s)
                fish.link.send(vision_message(at_s, sample))

    fish.link.subscribe(send)


def start(fish: Fish) -> None:
    fish.arm()
    fish.link.run(0.5)
    number = float(fish.status().next_trial)
    fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_START, number, fish.clock.now_s())
    fish.link.run(1.5)


def rest(fish: Fish, seconds: float) -> None:
    fish.link.run(seconds)


def pull(fish: Fish, seconds: float) -> None:
    end_s = fish.transport.now_s() + seconds
    while fish.transport.now_s() < end_s:
        fish.ftp.read(LAST_TRIAL)


def measure(fish: Fish, work: Callable[[Fish, float], None], load: Load) -> Busy:
    board = board_of(fish).board
    begin, begin_cpu_s = board.clock.now, time.process_time()
    busy, instructions = board.busy_ticks, board.instructions
    work(fish, load.measured_s)
    cpu_s = time.process_time() - begin_cpu_s
    span = board.clock.now - begin
    return Busy(
        span / TICKS_PER_S,
        (board.busy_ticks - busy) / span,
        board.instructions - instructions,
        [tick_instructions(board_of(fish)) for _ in range(load.ticks)],
        cpu_s,
    )


def tick_instructions(emulated: EmulatedBoard) -> int:
    """Instructions that the next 20 ms interrupt takes, without those of others within it."""
    board = emulated.board
    starts: list[int] = []
    hooks = board.periph["PWM"].on_period
    hooks.append(lambda *_: starts.append(board.clock.now))
    while not starts:
        board.run_until(board.clock.now + TICKS_PER_S // 10_000)
    hooks.pop()
    board.run_until(starts[0] + TICKS_PER_S // 50)
    counted, entered = 0, False
    while board.cpu.exception_number() != 0 or not entered:
        in_tick = board.cpu.exception_number() == TICK_EXCEPTION
        entered = entered or in_tick
        before = board.instructions
        board.run_until(board.clock.now + 1)
        counted += in_tick * (board.instructions - before)
    return counted


def finish(fish: Fish) -> None:
    while fish.status().state != "IDLE":
        fish.link.run(0.5)
    fish.discard()


def measure_all(load: Load) -> dict[str, Busy]:
    measured = {}
    for imu_rate_hz, imu_baud in load.imu_rates:
        with new_fish(imu_rate_hz, imu_baud, load.beats) as fish:
            measured[f"idle, IMU {imu_rate_hz} Hz"] = measure(fish, rest, load)
            send_speeds(fish)
            start(fish)
            measured[f"swimming, IMU {imu_rate_hz} Hz"] = measure(fish, rest, load)
            if imu_rate_hz == load.imu_rates[-1][0]:
                finish(fish)
                start(fish)
                measured["... and a trial is pulled"] = measure(fish, pull, load)
    return measured


def show(measured: dict[str, Busy]) -> None:
    print(
        "load of the fish's processor (84 MHz), if an instruction takes"
        f" {CYCLES_PER_INSTRUCTION} cycles (assumed):"
    )
    print(f"  {'':26} {'busy':>6} {'instructions/s':>15} {'in a tick':>10} {'emulated at':>14}")
    for name, busy in measured.items():
        per_s = busy.instructions / busy.simulated_s
        in_tick = statistics.median(busy.tick_instructions)
        # Less than a tick of the clock of CPU time: too short to tell.
        speed = busy.simulated_s / busy.cpu_s if busy.cpu_s else math.inf
        print(
            f"  {name:26} {busy.busy_share:6.1%} {per_s / 1e6:13.2f} M {in_tick:10.0f}"
            f" {speed:8.1f} x real time"
        )
    longest = max(max(busy.tick_instructions) for busy in measured.values())
    us = longest * CYCLES_PER_INSTRUCTION / 84
    print(f"  longest tick: {longest} instructions, about {us:.0f} us of its 20000")


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    try:
        show(measure_all(load))
    except TailbeatError as error:
        raise SystemExit(f"image_load: {error}") from error
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
