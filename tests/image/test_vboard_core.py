"""The emulated processor: time, sleep and interrupts, with small programs."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from vboard.board import Board
from vboard.chip import CYCLES_PER_INSTRUCTION, MASKED_SLICE
from vboard.core.bench import (
    PROBE,
    RAM,
    RAM_BYTES,
    finish,
    only_probe,
    run_program,
)
from vboard.core.clock import TICKS_PER_S
from vboard.core.exceptions import CHAIN_CYCLES

pytestmark = pytest.mark.usefixtures("both_models")

Build = Callable[[str], Path]


def test_time_is_instructions_at_the_master_clock(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            __asm volatile("str r0, [%0]\\n" REPEAT16("nop\\n") "str r0, [%0]\\n"
                           "movs r1, #3\\n 1: subs r1, #1\\n bne 1b\\n str r0, [%0]"
                           :: "r"(0x4000C000u) : "r1", "cc", "memory");
        }""")
    )
    first, second, third = probe.times()
    assert second - first == 17 * CYCLES_PER_INSTRUCTION
    assert third - second == (1 + 1 + 3 * 2) * CYCLES_PER_INSTRUCTION


def test_time_starts_with_the_first_instruction(tmp_path: Path) -> None:
    """Vectors, then ldr r0, =PROBE; str r0, [r0]; nop; str r0, [r0]; b ."""
    image = tmp_path / "program.bin"
    code = bytes.fromhex("0248 0060 00bf 0060 fee7 00bf".replace(" ", ""))
    vectors = struct.pack("<2I", RAM + RAM_BYTES, 0x80009)
    image.write_bytes(vectors + code + struct.pack("<I", PROBE))
    board = Board(image, peripherals=only_probe)
    board.run_until(100)
    assert board.periph["PROBE"].times() == [
        1 * CYCLES_PER_INSTRUCTION,
        3 * CYCLES_PER_INSTRUCTION,
    ]


def test_events_in_between_change_no_time(build: Build) -> None:
    image = build(
        """void program(void) {
            for (uint32_t i = 0; i < 3; i++) { MARK = i; }
            __asm volatile("movw r1, #5000\\n 1: subs r1, #1\\n bne 1b" ::: "r1", "cc");
            MARK = 9;
        }"""
    )
    alone = run_program(image).marks
    board = Board(image, peripherals=only_probe)
    for tick in range(0, 40_000, 7):
        board.clock.at(tick, lambda: None)
    assert finish(board).marks == alone


def test_slow_clock_makes_instructions_long(build: Build) -> None:
    """Out of reset the master clock is 4 MHz: 21 ticks a cycle."""
    board = Board(
        build(
            """void program(void) {
                __asm volatile("str r0, [%0]\\n" REPEAT4("nop\\n") "str r0, [%0, #4]\\n b ."
                               :: "r"(0x400E1A90u) : "memory");
            }"""
        ),
        trace=True,
    )
    board.run_for(0.001)
    assert board.bus.trace is not None
    first, second = [a.time for a in board.bus.trace if a.peripheral == "GPBR"]
    assert second - first == 5 * CYCLES_PER_INSTRUCTION * 21


def test_each_access_to_a_peripheral_happens_once(build: Build) -> None:
    """Also where it ends a slice: those of several words, with writeback, in IT blocks."""
    probe = run_program(
        build("""void program(void) {
            ISER = PROBE_BIT;
            __asm volatile("mov r4, %0\\n movs r0, #1\\n movs r1, #0\\n"
                           "stmia r4, {r0, r1}\\n"
                           "strd r0, r1, [r4]\\n"
                           "str r0, [r4], #4\\n str r1, [r4, #-4]!\\n"
                           "cmp r0, #1\\n ittt eq\\n streq r0, [r4]\\n streq r1, [r4, #4]\\n"
                           "streq r0, [r4]\\n"
                           "str r0, [r4, #16]\\n ldr r2, [r4, #16]!\\n str r2, [r4, #-16]"
                           :: "r"(0x4000C000u) : "r0", "r1", "r2", "r4", "cc", "memory");
        }""")
    )
    assert probe.values_marked() == [1, 1, 1, 0, 1, 1, 1]


def test_wfi_sleeps_to_the_very_event(build: Build) -> None:
    board = Board(
        build(
            """void on_irq(void) { MARK = 2; LINE = 0; }
            void program(void) {
                ISER = PROBE_BIT;
                ALARM = 1000000;
                MARK = 1;
                __asm volatile("wfi");
                MARK = 3;
            }"""
        ),
        peripherals=only_probe,
    )
    probe = finish(board)
    (begun, _), (taken, _), _ = probe.marks
    assert probe.values_marked() == [1, 2, 3]
    assert 1_000_000 <= taken - begun < 1_000_000 + 40
    assert 999_960 < board.idle_ticks < 1_000_000
    assert board.busy_ticks == board.clock.now - board.idle_ticks
    assert board.busy_ticks < 200


def test_sleep_without_an_end_reaches_the_end_of_the_run(build: Build) -> None:
    board = Board(build("void program(void) { }"), peripherals=only_probe)
    board.run_for(40.0)
    assert board.clock.now == 40 * TICKS_PER_S
    assert board.instructions < 30
    assert board.idle_ticks > 0.999 * board.clock.now


def test_wfi_ends_for_what_primask_holds_back(build: Build) -> None:
    probe = run_program(
        build("""void on_irq(void) { MARK = 3; LINE = 0; }
        void program(void) {
            ISER = PROBE_BIT;
            __asm volatile("cpsid i");
            ALARM = 5000;
            MARK = 1;
            __asm volatile("wfi");
            MARK = 2;
            __asm volatile("cpsie i\\n isb");
            MARK = 4;
        }""")
    )
    assert probe.values_marked() == [1, 2, 3, 4]
    assert probe.times()[1] - probe.times()[0] >= 4900


def test_wfi_sleeps_on_for_what_basepri_holds_back(build: Build) -> None:
    image = build(
        """void on_irq(void) { LINE = 0; MARK = 3; }
        void program(void) {
            BYTE(0xE000E400u + 30) = 0x80;
            ISER = PROBE_BIT;
            __asm volatile("msr basepri, %0" :: "r"(0x80));
            ALARM = 500;
            __asm volatile("wfi");
            MARK = 2;
        }"""
    )
    board = Board(image, peripherals=only_probe)
    assert not board.run_for(0.001, lambda: board.periph["PROBE"].done)
    assert board.periph["PROBE"].marks == []


def test_sleep_on_exit(build: Build) -> None:
    image = build(
        """static uint32_t times;
        void on_irq(void) {
            LINE = 0;
            if (++times == 3) { REG(0xE000ED10u) = 0; } else { ALARM = 1000; }
        }
        void program(void) {
            ISER = PROBE_BIT;
            times = 0;
            REG(0xE000ED10u) = 2;
            ALARM = 1000;
            __asm volatile("wfi");
            MARK = times;
        }"""
    )
    assert run_program(image).values_marked() == [3]


def test_hints_are_no_faults(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            __asm volatile("wfe\\n yield\\n sev\\n nop\\n wfe\\n yield");
            MARK = 1;
        }""")
    )
    assert probe.values_marked() == [1]


def test_stop_is_seen_while_the_image_runs(build: Build) -> None:
    board = Board(build("void program(void) { for (;;) { VALUE += 1; } }"), peripherals=only_probe)
    assert board.run_for(10, lambda: board.periph["PROBE"].values["VALUE"] > 100)
    assert board.now_s < 0.002
    assert not board.run_until(board.clock.now + 100)
    assert board.clock.now < 0.002 * TICKS_PER_S


def test_a_line_that_stays_high_comes_again(build: Build) -> None:
    probe = run_program(
        build("""static uint32_t times;
        void on_irq(void) { if (++times == 3) { LINE = 0; } MARK = times; }
        void program(void) { times = 0; ISER = PROBE_BIT; LINE = 1; __asm volatile("dsb"); }""")
    )
    assert probe.values_marked() == [1, 2, 3]


def test_a_line_that_fell_before_still_pends(build: Build) -> None:
    probe = run_program(
        build("""void on_irq(void) { MARK = 5; LINE = 0; }
        void program(void) {
            LINE = 1;
            LINE = 0;
            MARK = REG(0xE000E200u) >> 30;
            ISER = PROBE_BIT;
            __asm volatile("isb");
            LINE = 1;
            __asm volatile("isb");
        }""")
    )
    assert probe.values_marked() == [1, 5, 5]


def test_clearing_pending_under_a_high_line_is_in_vain(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            LINE = 1;
            REG(0xE000E280u) = PROBE_BIT;
            MARK = REG(0xE000E200u) >> 30;
            LINE = 0;
            REG(0xE000E280u) = PROBE_BIT;
            MARK = REG(0xE000E200u) >> 30;
        }""")
    )
    assert probe.values_marked() == [1, 0]


def test_interrupts_come_between_any_two_instructions(build: Build) -> None:
    """Alarms at every distance: the sum does not suffer, and each is taken within a few cycles."""
    probe = run_program(
        build("""static volatile uint32_t taken;
        void on_irq(void) { LINE = 0; taken++; }
        static uint32_t sum(void) {
            uint32_t a = 1, b = 0;
            for (uint32_t i = 0; i < 12; i++) {
                __asm volatile("tst %0, #1\\n ite ne\\n addne %1, %0\\n eoreq %1, %0\\n"
                               "add %0, %0, %1, lsl #1" : "+r"(a), "+r"(b) :: "cc");
            }
            return a ^ b;
        }
        void program(void) {
            taken = 0;
            ISER = PROBE_BIT;
            uint32_t quiet = sum();
            for (uint32_t ticks = 1; ticks < 150; ticks++) {
                ALARM = ticks;
                if (sum() != quiet) { MARK = ticks; }
            }
            for (uint32_t i = 0; i < 100; i++) { __asm volatile("nop"); }
            MARK = taken;
        }""")
    )
    assert probe.values_marked() == [149]


def test_code_in_ram_may_be_written_again(build: Build) -> None:
    """Also after data beside it, and after the MPU changed what the processor knows of pages. Only
    SRAM1: Unicorn takes code in SRAM0 for that of a mirror once a page was restricted."""
    probe = run_program(
        build("""static uint16_t *const code = (uint16_t *)0x20083000;
        static uint32_t run(uint32_t at) {
            return ((uint32_t (*)(void))((uint32_t)(code + at) | 1))();
        }
        void program(void) {
            code[1] = code[3] = 0x4770;
            for (uint32_t i = 0; i < 4; i++) {
                REG(0xE000ED9Cu) = 0x20081000;
                REG(0xE000EDA0u) = 11u << 1 | 1;
                REG(0xE000ED94u) = i % 2 == 0 ? 0 : 5;
                code[100] = 0;
                code[0] = 0x2005 + i;
                code[2] = 0x2009 + i;
                __asm volatile("isb" ::: "memory");
                MARK = run(0);
                MARK = run(2);
            }
        }""")
    )
    assert probe.values_marked() == [5, 9, 6, 10, 7, 11, 8, 12]


def test_systick_comes_to_the_cycle(build: Build) -> None:
    probe = run_program(
        build("""static uint32_t times;
        void on_systick(void) { MARK = ++times; }
        void program(void) {
            times = 0;
            REG(0xE000E014u) = 83999;
            REG(0xE000E018u) = 0;
            REG(0xE000E010u) = 7;
            while (times < 5) { __asm volatile("wfi" ::: "memory"); }
            REG(0xE000E010u) = 0;
        }""")
    )
    steps = [b - a for a, b in zip(probe.times(), probe.times()[1:], strict=False)]
    assert steps == [84_000] * 4


def test_systick_counts_down_and_reloads(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            REG(0xE000E014u) = 100;
            REG(0xE000E018u) = 5;
            REG(0xE000E010u) = 5;
            uint32_t a = REG(0xE000E018u);
            uint32_t b = REG(0xE000E018u);
            MARK = a - b;
            for (uint32_t i = 0; i < 100; i++) { __asm volatile("nop"); }
            MARK = REG(0xE000E010u);
            MARK = REG(0xE000E010u);
            REG(0xE000E010u) = 0;
            a = REG(0xE000E018u);
            MARK = a - REG(0xE000E018u);
            MARK = a <= 100;
        }""")
    )
    assert probe.values_marked() == [CYCLES_PER_INSTRUCTION, 0x10005, 5, 0, 1]


def test_cycle_counter_counts_master_clocks(build: Build) -> None:
    probe = run_program(
        build("""void program(void) {
            REG(0xE000EDFCu) = 1u << 24;
            REG(0xE0001000u) = 1;
            uint32_t a = REG(0xE0001004u);
            __asm volatile(REPEAT16("nop\\n"));
            MARK = REG(0xE0001004u) - a;
        }""")
    )
    assert probe.values_marked()[0] == 17 * CYCLES_PER_INSTRUCTION


def test_handlers_are_chained_without_a_new_frame(build: Build) -> None:
    """Interrupt 1 comes while 30 is active: less time passes than a return and an entry take."""
    probe = run_program(
        build(
            """void on_irq(void) {
                if (REG(0xE000ED04u) & 1) { MARK = 1; return; }
                LINE = 0;
                REG(0xE000E200u) = 2;
                MARK = 30;
            }
            void program(void) { ISER = PROBE_BIT | 2; LINE = 1; __asm volatile("isb"); }"""
        )
    )
    assert probe.values_marked() == [30, 1]
    first, second = probe.times()
    assert second - first < 10 * CYCLES_PER_INSTRUCTION + CHAIN_CYCLES
    assert second - first >= CHAIN_CYCLES + 3 * CYCLES_PER_INSTRUCTION


def test_an_interrupt_masked_for_long_is_taken_soon_after(build: Build) -> None:
    """Single steps would make a hang with interrupts off too slow to wait for the watchdog."""
    probe = run_program(
        build(
            """void on_irq(void) { LINE = 0; MARK = 2; }
            void program(void) {
                ISER = PROBE_BIT;
                __asm volatile("cpsid i");
                LINE = 1;
                __asm volatile("ldr r0, =100000\\n 1: subs r0, #1\\n bne 1b" ::: "r0", "cc");
                MARK = 1;
                __asm volatile("cpsie i");
                for (;;) { if (REG(0xE000E200u) == 0) { break; } }
            }"""
        )
    )
    assert probe.values_marked() == [1, 2]
    first, second = probe.times()
    assert second - first < 2 * MASKED_SLICE * CYCLES_PER_INSTRUCTION
