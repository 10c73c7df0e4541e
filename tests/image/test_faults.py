"""What the image does when it is broken on purpose, while the tail swims."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import Refused
from tailbeat.link import _dialect as mavlink
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_US
from vboard.periph.flash import BANK_BYTES, FLASH_BASE
from vboard.periph.pins import PinTrace

LONGEST_PULSE_US = 2100
WATCHDOG_S = 1.01  # 256 ticks of the slow clock at its nominal 32 kHz
HANGS_US = 1e9
DEAD_TICK_S = 0.06  # two frames, one of them begun when the tick stops
BATTERY_CHANNEL = 7
IMU_BACK_S = 5.0
FREE_FLASH = BANK_BYTES - 1024  # the image does not reach so far

NewBoard = Callable[..., EmulatedBoard]
Connect = Callable[[EmulatedBoard], Fish]

LOOP = "fee7"  # b .
CRASHES = {
    "bus fault": ("4ff0c0400068", "no such address"),  # r0 = 0x60000000; ldr r0, [r0]
    "undefined instruction": ("00de", "undefined instruction"),
    "division by zero": ("002090fbf0f0", "division by zero"),  # sdiv r0, r0, r0
    # r0 = sp, its lowest 6 bits cleared, - 24; sp = r0; push {r0-r12, lr}; push {r0, r1}; b .-6
    # so that what an exception stores still has room where the big push has none
    "endless push": ("68466ff30500183885462de9ff5f03b4fbe7", "stack guard"),
    "huge frame": ("adf5005d0090", "stack guard"),  # sub sp, #8192; str r0, [sp]
}
KINDS = {
    "bus fault": "bus fault",
    "undefined instruction": "usage fault",
    "division by zero": "usage fault",
    "endless push": "memory fault",
    "huge frame": "memory fault",
}


def swimming(board: EmulatedBoard, fish: Fish, beats: int = 5) -> PinTrace:
    """Starts a trial and lets it swim 1.2 s; a scope on the servo pin."""
    fish.upload_reference(records.encode_reference(1.0, [0.04] * beats))
    trace = PinTrace(board.board.clock, 21, 4)
    board.board.wire(lambda: trace.connect(board.board.periph["PIOC"], board.board.periph["PWM"]))
    fish.arm()
    number = float(fish.status().next_trial)
    fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_START, number, fish.clock.now_s())
    board.run(1.2)
    assert board.world.truth().swimming
    return trace


def inject(board: EmulatedBoard, code: str) -> None:
    """Makes the main loop run ``code`` (Thumb, hex), then nothing for ever."""
    board.board.flash.set(0, FREE_FLASH, bytes.fromhex(code + LOOP))
    board.board.chip.divert(FLASH_BASE + FREE_FLASH)


def call(board: EmulatedBoard, function: str, text: str) -> None:
    """Makes the main loop call ``function(text)``."""
    board.board.flash.set(0, FREE_FLASH + 64, text.encode() + b"\0")
    at = FLASH_BASE + FREE_FLASH
    # ldr r0, [pc, #4]; ldr r1, [pc, #8]; blx r1; b .
    code = struct.pack(
        "<4H2I", 0x4801, 0x4902, 0x4788, 0xE7FE, at + 64, board.board.symbol(function) | 1
    )
    inject(board, code.hex())


def expect_stopped(board: EmulatedBoard, fish: Fish, trace: PinTrace, fault: str) -> None:
    assert not board.world.truth().swimming
    assert trace.longest_high() <= LONGEST_PULSE_US * TICKS_PER_US
    status = fish.status()
    assert (status.state, status.fault.name) == ("FAULT", fault)


@pytest.mark.parametrize("what", CRASHES)
def test_a_crash_stops_the_tail_and_leaves_a_record(
    new_board: NewBoard, connect: Connect, what: str
) -> None:
    code, reason = CRASHES[what]
    board = new_board()
    board.board.chip.divide_traps = what == "division by zero"  # each division takes its time
    trace = swimming(board, connect(board))
    inject(board, code)
    crashed = board.board.clock.now
    board.run(0.3)
    assert board.board.periph["RSTC"].cause == 3
    last = trace.pulses()[-2]
    assert last.start + last.ticks - crashed < 100 * TICKS_PER_US
    fish = connect(board)
    expect_stopped(board, fish, trace, "CRASH")
    report = fish.crash_report()
    assert report is not None
    assert report.kind == KINDS[what]
    assert any(reason in text for text in report.reasons)
    assert report.build_id == fish.info().build_id
    at = FLASH_BASE + FREE_FLASH
    if what != "huge frame":  # whose registers could not be pushed
        assert at <= report.registers["pc"] <= at + 10
    assert fish.health()["reset_cause"] == "software"


def test_a_failed_assertion_names_its_place(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    trace = swimming(board, connect(board))
    call(board, "panic", "gait/gait.c:42")
    board.run(0.3)
    fish = connect(board)
    expect_stopped(board, fish, trace, "CRASH")
    report = fish.crash_report()
    assert report is not None
    assert (report.kind, report.where) == ("assertion", "gait/gait.c:42")
    fish.clear()
    assert fish.status().state == "IDLE"


@pytest.mark.parametrize(
    "code",
    [
        pytest.param("", id="the tick goes on"),
        pytest.param("72b6", id="interrupts are off", marks=pytest.mark.soak),  # cpsid i
    ],
)
def test_a_stuck_main_loop_ends_in_a_watchdog_reset(
    new_board: NewBoard, connect: Connect, code: str
) -> None:
    board = new_board()
    trace = swimming(board, connect(board))
    stuck_s = board.board.now_s
    inject(board, code)
    while board.board.periph["RSTC"].cause != 2 and board.board.now_s < stuck_s + 3:
        board.run(0.01)
    took_s = board.board.now_s - stuck_s
    print(f"watchdog reset after {took_s * 1000:.0f} ms")
    assert took_s < WATCHDOG_S
    board.run(0.3)
    fish = connect(board)
    expect_stopped(board, fish, trace, "WATCHDOG")
    assert fish.health()["reset_cause"] == "watchdog"


def test_a_dead_tick_ends_in_a_restart(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    trace = swimming(board, connect(board))
    board.board.periph["PWM"].write_idr1(1 << 4)
    dead = board.board.clock.now
    board.run(0.3)
    last = trace.pulses()[-2]
    assert last.start + last.ticks - dead < DEAD_TICK_S * 1e6 * TICKS_PER_US
    fish = connect(board)
    expect_stopped(board, fish, trace, "CRASH")
    report = fish.crash_report()
    assert report is not None and report.kind == "unexpected interrupt"


def test_an_unplugged_imu_stops_the_trial(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    fish = connect(board)
    fish.params.set("IMU_TIMEOUT_S", 0.5)
    assert fish.imu_verdict().problem.number == 0
    trace = swimming(board, fish)
    board.world.set_imu(False)
    board.run(1.5)
    status = fish.status()
    assert (status.state, status.fault.name) == ("ABORTED", "IMU_STALE")
    assert not board.world.truth().swimming
    assert trace.longest_high() <= LONGEST_PULSE_US * TICKS_PER_US
    assert fish.imu_verdict().problem.name == "SILENT"
    board.world.set_imu(True)
    plugged_s = board.time_s
    while fish.imu_info().state != "streaming":
        fish.link.run(0.1)
        assert board.time_s - plugged_s < IMU_BACK_S
    print(f"set up again {board.time_s - plugged_s:.1f} s after it was plugged in")
    frames = fish.health()["imu_frames"]
    board.run(1.0)
    assert fish.health()["imu_frames"] >= frames + 99
    assert fish.health()["imu_crc_failed"] <= 1


def test_a_silent_host_stops_the_trial(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    fish = connect(board)
    fish.params.set("LINK_TIMEOUT_S", 2.0)
    trace = swimming(board, fish)
    board.run(1.5)
    status = fish.status()
    assert (status.state, status.fault.name) == ("ABORTED", "LINK_LOST")
    assert not board.world.truth().swimming
    assert trace.longest_high() <= LONGEST_PULSE_US * TICKS_PER_US


@pytest.mark.parametrize("at_boot", [True, False])
def test_a_flash_that_never_finishes_is_told(
    new_board: NewBoard, connect: Connect, at_boot: bool
) -> None:
    """At boot nobody wakes the processor: the tick does not run yet, no IMU sends."""
    board = new_board()
    board.world.set_imu(False)
    if not at_boot:
        connect(board)
    board.board.periph["EEFC1"].timing.erase_write_us = HANGS_US
    fish = connect(board)
    if not at_boot:
        fish.params.set("ILC_GAIN", 3.0)
        with pytest.raises(Refused):
            fish.params.save()
    board.run(2.0)
    assert fish.status().fault.name == "STORAGE"
    assert fish.health()["reset_cause"] == "power"


def test_a_dead_converter_counts_as_an_empty_battery(new_board: NewBoard, connect: Connect) -> None:
    board = new_board()
    fish = connect(board)
    swimming(board, fish)
    converter = board.board.periph["ADC"]
    converter.write_cher(1 << BATTERY_CHANNEL + 1)
    converter.write_chdr(1 << BATTERY_CHANNEL)
    board.run(1.5)
    status = fish.status()
    assert (status.state, status.fault.name) == ("FAULT", "BATTERY_CRITICAL")


def test_a_bare_board_boots_and_serves_files_whatever_its_open_pin_reads(
    new_board: NewBoard, connect: Connect
) -> None:
    board = new_board()
    board.board.periph["ADC"].volts[BATTERY_CHANNEL] = 3.3
    fish = connect(board)
    fish.upload_reference(records.encode_reference(1.0, [0.04] * 5))
    status = fish.status()
    assert (status.state, status.battery_at_limit) == ("IDLE", True)
    with pytest.raises(Refused, match="voltage unknown"):
        fish.arm()
    fish.params.set("BATT_LOW_V", 0)
    fish.params.set("BATT_CRIT_V", 0)
    fish.params.save()
    swimming(board, fish)
    board.run(2.0)
    assert fish.status().state == "RUNNING"


def test_a_supply_that_dips_during_a_write_harms_nothing(
    new_board: NewBoard, connect: Connect
) -> None:
    board = new_board()
    fish = connect(board)
    fish.params.set("ILC_GAIN", 3.0)
    fish.params.save()
    rail, controller = board.board.periph["SUPC"].rail, board.board.periph["EEFC1"]
    dips = 0

    def dip(busy: bool) -> None:
        nonlocal dips
        if busy and dips < 3:
            dips += 1
            board.board.clock.after(1000 * TICKS_PER_US, lambda: rail.set(2.5))
            board.board.clock.after(6000 * TICKS_PER_US, lambda: rail.set(3.3))

    controller.on_busy.append(dip)
    for gain in (4.0, 5.0, 6.0):
        fish.params.set("ILC_GAIN", gain)
        try:
            fish.params.save()
        except Refused as error:
            print("save:", error)
            assert error.name == "STORAGE"
            fish.clear()
    assert dips == 3
    stored = board.flash
    board.world.power_cycle()
    fish = connect(board)
    print(
        fish.params.get("ILC_GAIN").value, fish.status().fault.name, fish.health()["store_failures"]
    )
    assert fish.params.get("ILC_GAIN").value in (3.0, 4.0, 5.0, 6.0)
    assert fish.status().fault.name == "NONE"
    assert stored
