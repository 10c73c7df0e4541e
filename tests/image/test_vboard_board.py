"""Memory, flash, resets and power of the emulated board."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from vboard.board import Board
from vboard.core.bench import (
    RAM,
    RAM_BYTES,
    finish,
    only_probe,
    run_program,
)
from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_S
from vboard.core.exceptions import Lockup
from vboard.image import ImageError, load

pytestmark = pytest.mark.usefixtures("both_models")

Build = Callable[[str], Path]


def test_sram0_shows_in_its_mirrors_and_below_sram1(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            REG(0x20070100u) = 0x11;
            MARK = REG(0x20000100u);
            REG(0x20050104u) = 0x22;
            MARK = REG(0x20070104u);
            REG(0x2007FFFCu) = 0x33;
            MARK = REG(0x2000FFFCu);
            REG(0x20080000u) = 0x44;
            MARK = REG(0x20000000u) != 0x44;
            MARK = REG(0x00000004u) == REG(0x00080004u);
        }""")
    )
    assert probe.values_marked() == [0x11, 0x22, 0x33, 1, 1]


def test_bus_masters_reach_memory_only(build: Build) -> None:
    board = Board(build("void program(void) { }"), peripherals=only_probe)
    chip = board.chip
    chip.write_memory(0x2007FFFE, b"abcd")
    assert chip.read_memory(0x2007FFFE, 4) == b"abcd"
    assert chip.read_memory(0x2000FFFE, 2) == b"ab"
    assert chip.read_memory(0x80000, 4) == board.bank0[:4]
    for action in (
        lambda: chip.write_memory(0x80000, b"x"),
        lambda: chip.write_memory(RAM + RAM_BYTES - 1, b"xy"),
        lambda: chip.read_memory(0x30000000, 1),
        lambda: chip.read_memory(0x4000C000, 4),
    ):
        with pytest.raises(BusViolation):
            action()


FLASH = """
#define EFC1(offset) REG(0x400E0C00u + (offset))
#define GPBR(n) REG(0x400E1A90u + 4 * (n))
#define COMMAND(code, argument) (0x5A000000u | (argument) << 8 | (code))
static void no_watchdog(void) { REG(0x400E1A54u) = 0x8000u; }
static void fill(uint32_t page, uint32_t value) {
    for (uint32_t i = 0; i < 64; i++) { REG(0x000C0000u + page * 256 + i * 4) = value + i; }
}
static void wait(void) { while ((EFC1(8) & 1) == 0) { } }
static void finished(void) { GPBR(7) = 1; for (;;) { __asm volatile("wfi"); } }
"""


def flashing(build: Build, body: str) -> Board:
    return Board(build(f"{FLASH}void program(void) {{ no_watchdog(); {body} finished(); }}"))


def finish_flashing(board: Board) -> None:
    gpbr = board.periph["GPBR"]
    assert board.run_for(1.0, lambda: gpbr.values["GPBR7"] == 1), f"stuck at {board.where()}"


def test_stores_to_flash_fill_the_latch_and_the_command_writes(build: Build) -> None:
    board = flashing(
        build,
        """EFC1(0) = 0x600; fill(3, 0x100);
        GPBR(0) = REG(0x000C0300u);
        EFC1(4) = COMMAND(3, 3); wait();
        GPBR(1) = REG(0x000C0300u); GPBR(2) = REG(0x000C03FCu);""",
    )
    finish_flashing(board)
    values = board.periph["GPBR"].values
    assert [values[f"GPBR{n}"] for n in range(3)] == [0xFFFFFFFF, 0x100, 0x13F]
    page = b"".join((0x100 + i).to_bytes(4, "little") for i in range(64))
    assert board.bank1 == b"\xff" * 0x300 + page + b"\xff" * (0x40000 - 0x400)


@pytest.mark.usefixtures("both_models")
def test_polls_in_a_row_see_once_what_reading_clears(build: Build) -> None:
    """A wrong command to the flash, and a crystal that failed."""
    board = flashing(
        build,
        """EFC1(4) = COMMAND(3, 0x800);
        uint32_t a = EFC1(8), b = EFC1(8), c = EFC1(8);
        uint32_t d = REG(0x400E0668u), e = REG(0x400E0668u), f = REG(0x400E0668u);
        GPBR(0) = a << 8 | b << 4 | c; GPBR(1) = (d ^ e) | (e ^ f) << 1;""",
    )
    board.periph["PMC"]._status |= 1 << 18
    finish_flashing(board)
    values = board.periph["GPBR"].values
    assert (values["GPBR0"], values["GPBR1"]) == (0x311, 1 << 18)


def test_the_latch_takes_words_stored_several_at_once(build: Build) -> None:
    board = flashing(
        build,
        """EFC1(0) = 0x600;
        __asm volatile("mov r0, %0\\n movs r3, #16\\n movs r4, #1\\n movs r5, #2\\n movs r6, #3\\n"
                       "movs r7, #4\\n 1: stmia r0!, {r4-r7}\\n adds r4, #4\\n subs r3, #1\\n"
                       "bne 1b" :: "r"(0x000C0000u) : "r0", "r3", "r4", "r5", "r6", "r7", "cc");
        EFC1(4) = COMMAND(3, 0); wait();""",
    )
    finish_flashing(board)
    assert board.bank1[:20] == bytes.fromhex("01000000 02000000 03000000 04000000 05000000")


def test_flash_stays_protected_after_a_command(build: Build) -> None:
    """A page of bank 1 is closed to loads by the MPU; the controller opens the bank only so far."""
    board = Board(
        build(
            FLASH
            + """void on_mem(void) { GPBR(0) = REG(0xE000ED34u); GPBR(7) = 1; for (;;) { } }
            void program(void) {
                no_watchdog();
                REG(0xE000ED9Cu) = 0x000C1000u | 1 << 4;
                REG(0xE000EDA0u) = 1u << 28 | 11u << 1 | 1;
                REG(0xE000ED94u) = 5;
                REG(0xE000ED24u) = 0x70000;
                EFC1(0) = 0x600; fill(0, 1); EFC1(4) = COMMAND(3, 0); wait();
                GPBR(1) = REG(0x000C0004u);
                GPBR(2) = REG(0x000C1004u);
            }"""
        )
    )
    finish_flashing(board)
    values = board.periph["GPBR"].values
    assert (values["GPBR0"], values["GPBR1"], values["GPBR2"]) == (0x000C1004, 2, 0)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("fill(0, 0);", "FWS 0"),
        ("EFC1(0) = 0x600; BYTE(0x000C0000u) = 1;", "8 bits"),
        ("EFC1(0) = 0x600; fill(0, 1); EFC1(4) = COMMAND(3, 0); GPBR(0) = REG(0x000C1000u);",
         "0x000c1000 while EEFC1 is busy"),
        ("REG(0x400E0A04u) = COMMAND(0x0B, 1); GPBR(0) = 1;", "code runs from a flash bank"),
    ],
)  # fmt: skip
def test_flash_rules_are_watched(build: Build, body: str, words: str) -> None:
    board = flashing(build, body)
    with pytest.raises(BusViolation, match=words):
        board.run_for(1.0)


def test_power_cut_loses_all_but_flash(build: Build) -> None:
    board = flashing(
        build,
        """EFC1(0) = 0x600; fill(0, 1); EFC1(4) = COMMAND(3, 0); wait();
        GPBR(0) = 0x55; REG(0x20070200u) = 0x12345678u;
        fill(1, 1); EFC1(4) = COMMAND(3, 1); GPBR(7) = 1; for (;;) { }""",
    )
    finish_flashing(board)
    old_chip = board.chip
    board.run_for(0.0035)
    board.power_cut()
    assert not board.powered
    with pytest.raises(RuntimeError, match="power_on"):
        _ = board.cpu
    assert board.flash.torn == [(1, 1)]
    whole, torn = board.bank1[:256], board.bank1[256:512]
    assert whole == b"".join(i.to_bytes(4, "little") for i in range(1, 65))
    assert torn not in (whole, b"\xff" * 256)
    board.run_for(20.0)
    board.power_on()
    assert board.chip is not old_chip
    assert board.word(0x20070200) != 0x12345678
    assert board.periph["GPBR"].values["GPBR0"] == 0
    assert board.bank1[:256] == whole


@pytest.mark.parametrize(("code", "sleeps"), [("", True), ("for (;;) { VALUE = 1; }", False)])
def test_power_may_go_and_come_while_it_runs(build: Build, code: str, sleeps: bool) -> None:
    """By events, as a test at random instants does it."""
    board = Board(build(f"void program(void) {{ {code} }}"), peripherals=only_probe)
    ms = TICKS_PER_S // 1000
    powered: list[bool] = []
    board.clock.at(3 * ms, board.power_cut)
    board.clock.at(4 * ms, lambda: powered.append(board.powered))
    board.clock.at(7 * ms, board.power_on)
    assert not board.run_until(10 * ms)
    assert powered == [False] and board.powered
    assert board.clock.now == 10 * ms
    assert board.idle_ticks + board.busy_ticks == 6 * ms
    assert (board.idle_ticks > 5 * ms) == sleeps


def test_stop_is_asked_after_each_event_of_a_sleep(build: Build) -> None:
    board = Board(build("void program(void) { }"), peripherals=only_probe)
    seen: list[int] = []
    for due in (1000, 2000, 3000):
        board.clock.at(due, lambda due=due: seen.append(due))
    assert board.run_for(1.0, lambda: len(seen) == 2)
    assert board.clock.now == 2000
    board.power_cut()
    board.clock.at(4000, lambda: seen.append(4000))
    assert board.run_for(1.0, lambda: 4000 in seen)
    assert board.clock.now == 4000


def test_resets_keep_ram_and_tell_their_cause(build: Build) -> None:
    image = build(
        FLASH
        + """void program(void) {
            uint32_t cause = REG(0x400E1A04u) >> 8 & 7;
            uint32_t n = cause == 0 ? 0 : REG(0x20070300u) + 1;
            REG(0x20070300u) = n;
            GPBR(n) = cause | REG(0x20070304u) << 8;
            REG(0x20070304u) = 0xAB;
            if (n == 0) { REG(0xE000ED0Cu) = 0x05FA0004u; }
            if (n == 1) { REG(0x400E1A54u) = 0x1FFF2010u; for (;;) { } }
            REG(0x400E1A54u) = 0x8000u;
            if (n == 2) { for (;;) { __asm volatile("wfi"); } }
            finished();
        }"""
    )
    board = Board(image)
    board.run_for(0.5)
    board.reset_pin()
    finish_flashing(board)
    values = [board.periph["GPBR"].values[f"GPBR{n}"] for n in range(4)]
    assert [value & 0xFF for value in values] == [0, 3, 2, 4]
    assert [value >> 8 for value in values[1:]] == [0xAB] * 3


def test_seed_decides_what_ram_holds(build: Build) -> None:
    image = build("void program(void) { }")
    boards = [Board(image, peripherals=only_probe, seed=seed) for seed in (1, 1, 2)]
    first, again, other = [board.read(RAM, RAM_BYTES) for board in boards]
    assert first == again != other


def test_raw_image_and_bank_1(build: Build, tmp_path: Path) -> None:
    image = build("void program(void) { MARK = 5; }")
    raw = tmp_path / "program.bin"
    raw.write_bytes(load(image).flash)
    board = Board(raw, bank1=b"old data", peripherals=only_probe)
    assert finish(board).values_marked() == [5]
    assert board.bank1[:9] == b"old data\xff"
    assert board.bank0.startswith(raw.read_bytes())
    named = Board(image, peripherals=only_probe)
    assert named.symbol("program") & 1
    assert "program" in named.image.where(named.symbol("program") + 1)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"")
    with pytest.raises(ImageError, match="0 bytes are no image"):
        load(empty)
    blank = tmp_path / "blank.bin"
    blank.write_bytes(b"\xff" * 64)
    with pytest.raises(Lockup, match="no image"):
        Board(blank)


def test_wires_are_soldered_again_after_each_power_on(build: Build) -> None:
    board = Board(build("void program(void) { }"), peripherals=only_probe)
    seen: list[object] = []
    board.wire(lambda: seen.append(board.chip))
    board.power_cut()
    board.power_on()
    assert len(seen) == 2 and seen[0] is not seen[1]


def test_flash_can_be_set_while_the_power_is_off(build: Build) -> None:
    board = Board(build("void program(void) { MARK = REG(0x000C0000u); }"), peripherals=only_probe)
    board.power_cut()
    board.bank1 = b"\x78\x56\x34\x12"
    board.power_on()
    assert finish(board).values_marked() == [0x12345678]
