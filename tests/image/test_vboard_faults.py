"""Faults of the emulated processor, and violations that end a test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from vboard.board import Board
from vboard.core.bench import only_probe, run_program
from vboard.core.bus import BusViolation
from vboard.core.exceptions import Lockup

pytestmark = pytest.mark.usefixtures("both_models")

Build = Callable[[str], Path]


REPORT = """
static void report(void) {
    MARK = REG(0xE000ED28u);
    MARK = REG(0xE000ED2Cu);
    MARK = REG(0xE000ED38u);
    MARK = REG(0xE000ED34u);
    DONE = 1;
    for (;;) { }
}
"""


@pytest.mark.parametrize("enabled", [True, False])
def test_bus_fault_records_where(build: Build, enabled: bool) -> None:
    handler = "on_bus" if enabled else "on_hard"
    probe = run_program(
        build(
            REPORT
            + f"""void {handler}(void) {{ report(); }}
        void program(void) {{
            REG(0xE000ED24u) = {0x70000 if enabled else 0};
            REG(0x30000010u) = 1;
        }}"""
        )
    )
    cfsr, hfsr, bfar, _ = probe.values_marked()
    assert (cfsr, hfsr, bfar) == (0x8200, 0 if enabled else 1 << 30, 0x30000010)


@pytest.mark.parametrize("address", [0x4000C000, 0xE0001000, 0xA0000000])
def test_devices_are_not_executed(build: Build, address: int) -> None:
    probe = run_program(
        build(
            REPORT
            + f"""void on_mem(void) {{ report(); }}
        void program(void) {{
            REG(0xE000ED24u) = 0x70000;
            ((void (*)(void)){address | 1})();
        }}"""
        )
    )
    assert probe.values_marked()[:2] == [1, 0]


def test_fault_in_hard_fault_locks_up(build: Build) -> None:
    board = Board(build("void program(void) { REG(0x30000000u) = 1; }"), peripherals=only_probe)
    with pytest.raises(Lockup, match=r"HardFault priority .* in on_hard\+0x"):
        board.run_for(0.1)


def test_violation_names_the_place(build: Build) -> None:
    image = build(
        """__attribute__((noinline)) static void wrong(void) { REG(0x4000C100u) = 1; }
        void program(void) { wrong(); }"""
    )
    board = Board(image, peripherals=only_probe)
    with pytest.raises(BusViolation) as caught:
        board.run_for(0.1)
    message = str(caught.value)
    assert "write to PROBE unknown register +0x100" in message
    assert "in wrong+0x" in message
    assert int.from_bytes(board.read(board.cpu.pc, 2), "little") >> 11 in (0b01100, 0b11111)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("(void)BYTE(0x4000C010u);", "8 bits"),
        ("REG(0x4000C014u) = 1;", "READ_ONLY, which cannot be"),
        ("(void)REG(0x4000D000u);", "no peripheral"),
        ("REG(0xE000E000u) = 1;", "no such writable system register"),
        ("REG(0xE000ED14u) = 0x208;", "CCR: bits 0x8 are unknown or not modelled"),
        ("REG(0xE000ED0Cu) = 4;", "AIRCR written without its key"),
        ("(void)REG(0x42000000u);", "no peripheral"),
    ],
)
def test_violations_come_out_of_the_run(build: Build, code: str, words: str) -> None:
    board = Board(build(f"void program(void) {{ {code} }}"), peripherals=only_probe)
    with pytest.raises(BusViolation, match=words):
        board.run_for(0.1)


def test_stopped_clock_is_a_violation(build: Build) -> None:
    board = Board(build("void program(void) { VALUE = 1; }"), peripherals=only_probe)
    board.periph["PROBE"].clock_is_on = False
    with pytest.raises(BusViolation, match="clock is off"):
        board.run_for(0.1)


def test_division_by_zero_is_a_usage_fault(build: Build) -> None:
    probe = run_program(
        build(
            REPORT
            + """void on_usage(void) { report(); }
        static volatile uint32_t zero;
        void program(void) {
            zero = 0;
            MARK = 7 / (zero + 2);
            REG(0xE000ED24u) = 0x70000;
            REG(0xE000ED14u) = 0x210;
            MARK = 1000 / (zero + 7);
            MARK = 1000 / zero;
        }"""
        )
    )
    assert probe.values_marked()[:4] == [3, 142, 0x02000000, 0]


def test_stack_overflow_meets_the_guard(build: Build) -> None:
    """The guard is met by a push; the fault's own frame meets it as well."""
    probe = run_program(
        build("""static uint32_t stack[512] __attribute__((aligned(2048)));
        __attribute__((used)) void show(void) {
            MARK = REG(0xE000ED28u);
            MARK = REG(0xE000ED34u) - (uint32_t)stack;
            DONE = 1;
            for (;;) { }
        }
        __attribute__((naked)) void on_mem(void) {
            __asm volatile("ldr sp, =stack_top\\n b show");
        }
        __attribute__((noinline)) static uint32_t deep(uint32_t n) {
            volatile uint32_t room[8];
            room[0] = n;
            return deep(n + 1) + room[0];
        }
        void program(void) {
            REG(0xE000ED98u) = 0;
            REG(0xE000ED9Cu) = (uint32_t)stack;
            REG(0xE000EDA0u) = 1u << 28 | 5u << 1 | 1;
            REG(0xE000ED94u) = 5;
            REG(0xE000ED24u) = 0x70000;
            __asm volatile("mov sp, %0" :: "r"(stack + 512));
            MARK = deep(0);
        }""")
    )
    cfsr, address = probe.values_marked()
    assert cfsr & 0x82 == 0x82
    assert cfsr & ~0x92 == 0
    assert 0 <= address < 64
