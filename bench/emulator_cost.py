"""What the emulated board costs beyond the instructions themselves.

The limit is Unicorn with its counting of instructions and nothing else: it runs on from places
where the busy board was seen, with the same registers and memory, again and again. Both are
measured in turns, by processor time, so that other load of the machine does not matter. The board
is all that EmulatedBoard.run() does: processor, peripherals, wires, the simulated fish. The speed
in real time counts the host's end of the link, too.
"""

from __future__ import annotations

import ctypes
import mmap
import random
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from image_load import board_of, finish, new_fish, pull, rest, send_speeds, start
from unicorn import UC_ARCH_ARM, UC_MODE_THUMB, UC_PROT_ALL
from unicorn import arm_const as arm

from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from vboard.board import Board
from vboard.core.clock import TICKS_PER_S
from vboard.core.counter import COUNTER_OFFSET, engine_address
from vboard.core.engine import Uc, library
from vboard.core.memory import BANK_SIZE, FLASH_SIZE, FLASH_START, RAM_SIZE, RAM_START

STATE_NAMES = ("XPSR", "CONTROL", "MSP", "PSP", "SP", "LR", "PRIMASK", "BASEPRI", "FAULTMASK")
STATE = [getattr(arm, f"UC_ARM_REG_{name}") for name in STATE_NAMES]
STATE += [getattr(arm, f"UC_ARM_REG_R{number}") for number in range(13)]
IO_SPACES = ((0x40000000, 0x200000), (0xE0000000, 0x100000))
NEVER = 0xFFFFFFFE
HALF = 0.5  # of its instructions a place must reach
LOOK_TICKS = TICKS_PER_S // 20_000


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    places: int
    place_instructions: int
    repeats: int
    rounds: int
    round_s: float
    beats: int


FULL = Load(places=96, place_instructions=4000, repeats=20, rounds=9, round_s=0.5, beats=40)


@dataclass(frozen=True)
class Place:
    """Where the processor was."""

    pc: int
    registers: list[int]
    ram: bytes


@dataclass(frozen=True)
class Cost:
    """Nanoseconds of processor time per instruction; ``speed``: in real time."""

    board_ns: float
    bare_ns: float
    ratio: float
    speed: float


class Bare:
    """Unicorn and memory as it is mapped by default; peripherals are memory too, of zeros. Code may
    be anywhere, for which each store looks; on the board only where code has run."""

    def __init__(self, board: Board) -> None:
        engine = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
        engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
        flash = bytes(board.flash.memory)
        engine.mem_map(0, BANK_SIZE)
        engine.mem_write(0, flash[:BANK_SIZE])
        engine.mem_map(FLASH_START, FLASH_SIZE)
        engine.mem_write(FLASH_START, flash)
        self._ram = mmap.mmap(-1, RAM_SIZE)
        self._host = ctypes.c_char.from_buffer(self._ram)
        engine.mem_map_ptr(RAM_START, RAM_SIZE, UC_PROT_ALL, ctypes.addressof(self._host))
        for address, size in IO_SPACES:
            engine.mem_map(address, size)
        self._engine = engine
        self._begun = ctypes.c_uint64.from_address(engine_address(engine) + COUNTER_OFFSET)

    def run(self, place: Place, instructions: int, repeats: int) -> tuple[float, int]:
        """Seconds and instructions of the same run many times; the first one is not counted. Fewer
        instructions run where the processor sleeps or meets what needs more than Unicorn."""
        self._ram[:] = place.ram
        self._go(place, instructions)
        runs = [self._go(place, instructions) for _ in range(repeats)]
        return sum(seconds for seconds, _ in runs), sum(count for _, count in runs)

    def _go(self, place: Place, instructions: int) -> tuple[float, int]:
        for name, value in zip(STATE, place.registers, strict=True):
            self._engine.reg_write(name, value)
        self._engine.reg_write(arm.UC_ARM_REG_APSR_NZCV, place.registers[0] & 0xF0000000)
        begin_s = time.process_time()
        library.uc_emu_start(self._engine._uch, place.pc | 1, NEVER, 0, instructions)
        return time.process_time() - begin_s, int(self._begun.value)


def place_of(board: Board) -> Place:
    engine = board.cpu._engine
    registers = [engine.reg_read(name) for name in STATE]
    return Place(board.cpu.pc, registers, board.read(RAM_START, RAM_SIZE))


@contextmanager
def looked_at(board: Board, count: int) -> Iterator[list[Place]]:
    """Up to ``count`` places where the processor is awake, from all over the next second or so."""
    places: list[Place] = []
    chance = random.Random(1)
    run_until = board.run_until

    def run_and_look(tick: int, stop: Callable[[], bool] | None = None) -> bool:
        while board.clock.now < tick:
            if run_until(min(tick, board.clock.now + LOOK_TICKS), stop):
                return True
            if not board.chip.asleep and len(places) < count and chance.random() < 0.1:
                places.append(place_of(board))
        return False

    board.run_until = run_and_look  # type: ignore[method-assign]
    try:
        yield places
    finally:
        board.run_until = run_until  # type: ignore[method-assign]


class Meter:
    """Processor time within EmulatedBoard.run()."""

    def __init__(self, fish: Fish) -> None:
        self.board_s = 0.0
        board = board_of(fish)
        run = board.run

        def timed(*arguments: float, **options: bool) -> float:
            begin_s = time.process_time()
            try:
                return run(*arguments, **options)  # type: ignore[arg-type]
            finally:
                self.board_s += time.process_time() - begin_s

        board.run = timed  # type: ignore[assignment,method-assign]


def measure(fish: Fish, work: Callable[[Fish, float], None], load: Load) -> Cost:
    """``work`` lets time pass, in turns with bare runs from places found in it."""
    board = board_of(fish).board
    bare, meter = Bare(board), Meter(fish)
    places: list[Place] = []
    while len(places) < load.places:
        with looked_at(board, load.places) as found:
            work(fish, load.round_s)
        places += [place for place in found if goes_on(bare, place, load)]
    rounds = [one_round(fish, work, load, bare, meter, places) for _ in range(load.rounds)]
    board_ns, bare_ns, speed = (statistics.median(column) for column in zip(*rounds, strict=True))
    ratio = statistics.median(on_board / alone for on_board, alone, _ in rounds)
    return Cost(board_ns, bare_ns, ratio, speed)


def goes_on(bare: Bare, place: Place, load: Load) -> bool:
    """Whether much can be run from there, each time."""
    wanted = HALF * load.place_instructions * load.repeats
    return bare.run(place, load.place_instructions, load.repeats)[1] > wanted


def one_round(
    fish: Fish,
    work: Callable[[Fish, float], None],
    load: Load,
    bare: Bare,
    meter: Meter,
    places: list[Place],
) -> tuple[float, float, float]:
    """(ns per instruction on the board, alone; seconds per second of processor time)."""
    board = board_of(fish).board
    meter.board_s, begin_s = 0.0, time.process_time()
    instructions, begin = board.instructions, board.clock.now
    work(fish, load.round_s)
    tick_s = time.get_clock_info("process_time").resolution
    cpu_s = max(time.process_time() - begin_s, tick_s)  # a timer makes the clock tick slowly
    board_ns = meter.board_s / (board.instructions - instructions) * 1e9
    runs = [bare.run(place, load.place_instructions, load.repeats) for place in places]
    seconds, count = map(sum, zip(*runs, strict=True))
    speed = (board.clock.now - begin) / TICKS_PER_S / cpu_s
    return board_ns, max(seconds, tick_s) / count * 1e9, speed


def measure_all(load: Load) -> dict[str, tuple[Cost, float]]:
    """Costs and their goals."""
    measured = {}
    with new_fish(200, 230400, load.beats) as fish:
        measured["idle, IMU 200 Hz"] = measure(fish, rest, load), 2.0
        send_speeds(fish)
        start(fish)
        measured["swimming, IMU 200 Hz"] = measure(fish, rest, load), 2.0
    with new_fish(400, 460800, load.beats) as fish:
        send_speeds(fish)
        start(fish)
        finish(fish)
        start(fish)
        measured["... 400 Hz and a pull"] = measure(fish, pull, load), 3.0
    return measured


def show(measured: dict[str, tuple[Cost, float]]) -> None:
    print("emulated board, processor time per instruction over that of Unicorn alone:")
    for name, (cost, goal) in measured.items():
        print(
            f"  {name:22} {cost.board_ns:6.1f} ns, alone {cost.bare_ns:5.1f} ns:"
            f" {cost.ratio:5.2f} x (goal {goal:.0f}, limit 1); {cost.speed:5.1f} x real time"
        )


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    try:
        show(measure_all(load))
    except TailbeatError as error:
        raise SystemExit(f"emulator_cost: {error}") from error
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
