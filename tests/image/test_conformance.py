"""The conformance suite on the simulated and the emulated board, sound and with planted faults."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection
from contextlib import closing, suppress
from pathlib import Path

import pytest

from conformance import faults
from conformance.boards import Board
from conformance.checks import GROUPS, run
from conformance.emulated_board import EmulatedBoard
from conformance.results import ABSENT, FAILED, OK, Result
from conformance.simulated_board import SimulatedBoard

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
RUNNER = ROOT / "tests" / "conformance" / "run.py"
PROGRAM = BUILD / "unit" / "conformance" / "simulated_conformance"
FAULTY_PROGRAM = PROGRAM.with_name("simulated_conformance_faulty")
IMAGE = BUILD / "firmware" / "conformance" / "sam3x8e_conformance.elf"
FAULTY_IMAGE = IMAGE.with_name("sam3x8e_conformance_faulty.elf")
SLOW_PAGE_US = 10_500.0

STANDS_STILL = {"lock_keeps_tick_out", "lock_delays_tick", "lock_loses_no_tick"}
NOT_SIMULATED = STANDS_STILL | {*GROUPS["watchdog"][1], *GROUPS["crash"][1]}

# Fault, group of checks, and those of them that fail.
ON_BOTH = [
    (faults.FLASH_LOSES_BIT, "flash", {"flash_reads_back"}),
    (faults.FLASH_READS_OUTSIDE, "flash", {"flash_reads_outside"}),
    (
        faults.FLASH_WRITES_MISALIGNED,
        "flash",
        {"flash_writes_outside", "flash_refused_writes_nothing"},
    ),
    (faults.OVERRUNS_NOT_COUNTED, "serial", {"serial_overrun_counted", "serial_overrun_lost"}),
    (faults.SERIAL_LOSES_BYTE, "serial", {"serial_loopback", "serial_overrun_counted"}),
    (
        faults.SERIAL_WRITES_PART,
        "serial",
        {"serial_write_whole_or_none", "serial_full_ring", "serial_refused_sends_nothing"},
    ),
    (faults.CLOCK_SLOW, "clock", {"tick_period", "clock_rate"}),
    (faults.RESET_CAUSE_WRONG, "restart", {"reset_cause_software"}),
]
ON_SIMULATED = [
    # On the fish's board the timer that waits for the tick ends them.
    (faults.PULSES_GO_ON, "servo", {"servo0_stops"}),
    (faults.BAUD_ACCEPTED, "serial", {"serial_baud_impossible"}),
    (faults.SERIAL_SENDS_REFUSED, "serial", {"serial_refused_sends_nothing"}),
    (faults.CLOCK_GOES_BACK, "clock", {"clock_monotonic"}),
    (faults.BATTERY_UNSTEADY, "board", {"battery_steady"}),
    (faults.ID_CHANGES, "restart", {"unique_id"}),
]
ON_EMULATED = [
    (faults.WATCHDOG_NEVER_BITES, "watchdog", {"watchdog_bites"}),
    (faults.CRASH_RECORD_LOST, "crash", {"crash_record_there", "crash_record_place"}),
    (
        faults.CRASH_RECORD_STAYS,
        "crash",
        {"crash_record_forgotten", "crash_record_stays_forgotten"},
    ),
    (faults.LOCK_OPEN, "clock", {"lock_keeps_tick_out", "lock_delays_tick"}),
    (faults.TICK_DOUBLED, "clock", {"tick_period", "tick_jitter"}),
    (faults.TICK_FAST, "clock", {"tick_period"}),
]


def built(path: Path) -> Path:
    assert path.is_file(), f"there is no {path}: make conformance_programs"
    return path


def failed_on(board: Board, groups: Collection[str]) -> set[str]:
    with closing(board):
        results = list(run(board, groups))
    print(*(result.row() for result in results), sep="\n")
    return {result.name for result in results if result.verdict == FAILED}


def all_results(board: Board) -> dict[str, Result]:
    with closing(board):
        return {result.name: result for result in run(board)}


def named(faults_found: list[tuple[int, str, set[str]]]) -> list[str]:
    """The faults' names, for those of the tests."""
    names = {number: name for name, number in vars(faults).items() if name.isupper()}
    return [names[number] for number, _, _ in faults_found]


BOARDS: list[Callable[[], Board]] = [
    lambda: SimulatedBoard(built(PROGRAM)),
    lambda: EmulatedBoard(built(IMAGE)),
]


@pytest.mark.parametrize(
    ("board", "absent"),
    [(BOARDS[0], NOT_SIMULATED), (BOARDS[1], set[str]())],
    ids=["simulated", "emulated"],
)
def test_a_board_fulfils_the_interface(board: Callable[[], Board], absent: set[str]) -> None:
    results = all_results(board())
    print(*(result.row() for result in results.values()), sep="\n")
    others = {r.name: r.verdict for r in results.values() if r.verdict != OK}
    assert others == dict.fromkeys(absent, ABSENT)
    assert {name for _, names in GROUPS.values() for name in names} <= results.keys()


@pytest.mark.parametrize(
    ("fault", "group", "expected"), ON_BOTH + ON_SIMULATED, ids=named(ON_BOTH + ON_SIMULATED)
)
def test_a_fault_of_the_simulated_board_is_found(
    fault: int, group: str, expected: set[str]
) -> None:
    assert failed_on(SimulatedBoard(built(FAULTY_PROGRAM), fault), [group]) == expected


@pytest.mark.parametrize(
    ("fault", "group", "expected"), ON_BOTH + ON_EMULATED, ids=named(ON_BOTH + ON_EMULATED)
)
def test_a_fault_of_the_emulated_board_is_found(fault: int, group: str, expected: set[str]) -> None:
    assert failed_on(EmulatedBoard(built(FAULTY_IMAGE), fault), [group]) == expected


def test_a_slow_flash_is_found() -> None:
    board = EmulatedBoard(built(IMAGE), page_us=SLOW_PAGE_US)
    assert failed_on(board, ["flash"]) == {"flash_time_min", "flash_time_mean", "flash_time_max"}


def test_two_runs_are_the_same() -> None:
    first, second = (all_results(SimulatedBoard(built(PROGRAM))) for _ in range(2))
    assert first == second


def in_real_time(board: SimulatedBoard, end: int, stop: threading.Event) -> None:
    """Joins the board's console to a file descriptor, until ``stop``."""
    behind_s = time.monotonic() - board.now_s()
    os.set_blocking(end, False)
    while not stop.is_set():
        stop.wait(0.005)
        with suppress(BlockingIOError):  # nothing has come
            board.write(os.read(end, 4096))
        until_s = time.monotonic() - behind_s
        while (late_s := until_s - board.now_s()) > 0:
            os.write(end, board.read(late_s))


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudoterminals")
def test_the_runner_reaches_a_board_on_a_serial_port() -> None:
    import pty
    import tty

    near, far = pty.openpty()
    tty.setraw(far)
    stop = threading.Event()
    with closing(SimulatedBoard(built(PROGRAM))) as board:
        pump = threading.Thread(target=in_real_time, args=(board, near, stop))
        pump.start()
        command = [sys.executable, RUNNER, os.ttyname(far), "--only=board"]
        run = subprocess.run(command, capture_output=True, text=True, timeout=600)
        stop.set()
        pump.join()
    os.close(near)
    os.close(far)
    print(run.stdout, run.stderr)
    assert run.returncode == 0
    assert "3 ok, 0 failed, 2 not measured" in run.stdout
