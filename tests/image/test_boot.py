"""From reset to the first heartbeat: what the image writes, in which order; bad hardware."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import Refused
from tailbeat.link.transport import Hearing
from tailbeat.sim.board import CONSOLE, RADIO, SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_US

# Watchdog of 1 s first, flash wait states before speed, then crystal, its detector, the switch to
# it, PLL 12 MHz * 14, halved, and the core onto it (datasheet, "Programming Sequence" of the PMC).
CLOCK_WRITES = [
    ("WDT", "MR", 0x1FFF2100),
    ("EEFC0", "FMR", 0x400),
    ("EEFC1", "FMR", 0x400),
    ("PMC", "CKGR_MOR", 0x00370028),
    ("PMC", "CKGR_MOR", 0x00374029),
    ("PMC", "CKGR_MOR", 0x02374029),
    ("PMC", "CKGR_MOR", 0x03374029),
    ("PMC", "CKGR_PLLAR", 0x200D3F01),
    ("PMC", "PMC_MCKR", 0x11),
    ("PMC", "PMC_MCKR", 0x12),
]
FIRST_BYTE_S = 0.1
SLOWEST_PAGE_US = 10_000.0
HANGS_US = 1e9
POWER_UP = 0

NewBoard = Callable[..., EmulatedBoard]
Connect = Callable[[EmulatedBoard], Fish]


def clock_writes(board: EmulatedBoard) -> list[tuple[str, str, int]]:
    names = {(peripheral, register) for peripheral, register, _ in CLOCK_WRITES}
    trace = board.board.bus.trace or []
    writes = [(a.peripheral, a.register, a.value) for a in trace if a.write]
    return [write for write in writes if write[:2] in names]


# How a program may leave the chip that jumps to the image without a reset: on the crystal, or on
# the PLL behind it. The time (us) is what each step takes.
ON_CRYSTAL = [("write_ckgr_mor", 0x00374009, 20_000), ("write_ckgr_mor", 0x01374009, 10)]
ON_PLL = [
    *ON_CRYSTAL,
    ("write_ckgr_pllar", 0x200D3F01, 4_000),
    ("write_pmc_mckr", 0x11, 10),
    ("write_pmc_mckr", 0x12, 10),
]


@pytest.mark.parametrize("steps", [ON_CRYSTAL, ON_PLL], ids=["crystal", "PLL"])
def test_a_start_without_a_reset_leaves_the_clock_it_finds(
    new_board: NewBoard, steps: list[tuple[str, int, int]]
) -> None:
    board = new_board()
    periph, clock = board.board.periph, board.board.clock
    for bank in ("EEFC0", "EEFC1"):
        periph[bank].values["FMR"] = 0x400
    for name, value, wait_us in steps:
        getattr(periph["PMC"], name)(value)
        clock.advance(clock.now + wait_us * TICKS_PER_US)
    board.board.bus.trace = []
    assert hear_board(SimTransport(board), 2.0) is not None
    writes = [write for write in clock_writes(board) if write[0] == "PMC"]
    print([f"{register} {value:#x}" for _, register, value in writes])
    on_rc = next(i for i, write in enumerate(writes) if write == CLOCK_WRITES[3])
    assert all(register != "CKGR_PLLAR" for _, register, _ in writes[:on_rc])
    assert writes[on_rc : on_rc + 7] == CLOCK_WRITES[3:]
    assert board.board.chip.mck_hz() == 84_000_000


@pytest.mark.parametrize("port", [RADIO, CONSOLE])
def test_from_reset_to_the_first_heartbeat(new_board: NewBoard, port: int) -> None:
    board = new_board()
    board.board.bus.trace = []
    heartbeat = hear_board(SimTransport(board, port), 2.0)
    assert heartbeat is not None
    assert clock_writes(board)[: len(CLOCK_WRITES)] == CLOCK_WRITES
    assert [w for w in clock_writes(board) if w[0] == "WDT"] == CLOCK_WRITES[:1]
    assert board.board.chip.mck_hz() == 84_000_000


def test_the_first_bytes_come_soon(new_board: NewBoard) -> None:
    board = new_board()
    for _ in range(100):
        board.run(0.001)
        if board.read(RADIO):
            break
    first_s = board.board.now_s
    print(f"first bytes {first_s * 1000:.0f} ms after reset, on an empty flash")
    assert first_s < FIRST_BYTE_S


@pytest.mark.parametrize("page_us", [SLOWEST_PAGE_US, HANGS_US], ids=["slow flash", "it hangs"])
def test_the_console_tells_the_start_whatever_comes_after(
    new_board: NewBoard, page_us: float
) -> None:
    """By this line `tailbeat board flash` knows firmware that hangs from a new board."""
    board = new_board()
    board.board.periph["EEFC1"].timing.erase_write_us = page_us
    board.run(FIRST_BYTE_S)
    heard = Hearing("console")
    heard.add(board.read(CONSOLE), 0.0)
    assert heard.kind == "hung"


def test_the_servo_pin_is_driven_low_at_once(new_board: NewBoard) -> None:
    board = new_board()
    board.board.bus.trace = []
    board.run(0.001)
    first = [a for a in board.board.bus.trace or [] if a.peripheral == "PIOC" and a.write]
    assert [(a.register, a.value) for a in first[:4]] == [
        ("CODR", 1 << 21), ("OER", 1 << 21), ("PER", 1 << 21), ("PUDR", 1 << 21),
    ]  # fmt: skip
    assert first[3].time < 50 * TICKS_PER_US


@pytest.mark.parametrize("slow_rc_hz", [20_000, 44_000])
def test_the_slowest_flash_is_formatted_before_the_watchdog_bites(
    new_board: NewBoard, slow_rc_hz: int
) -> None:
    board = new_board()
    watchdog = board.board.periph["WDT"]
    watchdog.slow.rc_hz = slow_rc_hz
    board.board.periph["EEFC1"].timing.erase_write_us = SLOWEST_PAGE_US
    assert hear_board(SimTransport(board), 2.0) is not None
    board.run(1.0)
    assert board.board.periph["RSTC"].cause == POWER_UP
    print(f"slow clock {slow_rc_hz} Hz: {watchdog.shortest_left_s:.2f} s left to the watchdog")
    assert watchdog.shortest_left_s > 0.5


@pytest.mark.parametrize("by_time", [False, True], ids=["never ready", "ready by time"])
def test_a_dead_crystal_answers_and_does_not_arm(
    new_board: NewBoard, connect: Connect, by_time: bool
) -> None:
    board = new_board()
    board.board.periph["PMC"].crystal = False
    board.board.periph["PMC"].moscxts_by_time = by_time
    fish = connect(board)
    assert fish.status().fault.name == "CLOCK"
    assert fish.params.get("ILC_GAIN").value == 4.0
    with pytest.raises(Refused):
        fish.arm()
    fish.clear()
    fish.upload_reference(reference.thesis().record())
    with pytest.raises(Refused, match="crystal"):
        fish.arm()
    board.run(1.0)
    assert board.board.chip.mck_hz() == 84_000_000
    assert not board.world.truth().swimming
    assert board.board.periph["PIOC"].owner(21) == "PIO"


def test_a_crystal_that_dies_later_ends_in_the_same_state(
    new_board: NewBoard, connect: Connect
) -> None:
    board = new_board()
    fish = connect(board)
    board.board.periph["PMC"].fail_crystal()
    board.run(1.0)
    fish = connect(board)
    assert fish.status().fault.name == "CRASH"
    report = fish.crash_report()
    assert report is not None
    assert report.kind == "unexpected interrupt"
    fish.clear()
    fish.upload_reference(reference.thesis().record())
    with pytest.raises(Refused, match="crystal"):
        fish.arm()


def test_who_it_is(new_board: NewBoard, connect: Connect) -> None:
    fish = connect(new_board())
    info = fish.info()
    assert info.board == "emulated"
    assert info.simulated
    assert bytes.fromhex(info.unique_id)[:8] == b"tailbeat"
    assert info.status.battery_v == pytest.approx(8.2, abs=0.02)
    assert fish.health()["reset_cause"] == "power"


def test_a_pressed_reset_pin_is_told(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    connect(board)
    board.board.reset_pin()
    board.run(0.5)
    fish = connect(board)
    assert fish.health()["reset_cause"] == "reset pin"
    assert fish.status().state == "IDLE"
