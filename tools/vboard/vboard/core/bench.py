"""Small programs in C and a probe they speak to: the processor without a whole image."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

from vboard.board import Board
from vboard.core.bus import Peripheral, Reg, Soc

COMPILER = "arm-none-eabi-gcc"
PROBE = 0x4000C000
PROBE_IRQ = 30
RAM, RAM_BYTES = 0x20070000, 0x18000

LINKER_SCRIPT = """
MEMORY {
    rom (rx) : ORIGIN = 0x00080000, LENGTH = 64K
    ram (rwx) : ORIGIN = 0x20070000, LENGTH = 96K
}
SECTIONS {
    .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) } > rom
    .bss (NOLOAD) : { *(.bss*) *(COMMON) } > ram
    stack_top = ORIGIN(ram) + LENGTH(ram);
    /DISCARD/ : { *(.ARM.*) *(.comment) }
}
"""

PRELUDE = """
#include <stdint.h>
#define REG(address) (*(volatile uint32_t *)(address))
#define BYTE(address) (*(volatile uint8_t *)(address))
#define MARK REG(0x4000C000u)
#define LINE REG(0x4000C004u)
#define ALARM REG(0x4000C008u)
#define DONE REG(0x4000C00Cu)
#define VALUE REG(0x4000C010u)
#define ISER REG(0xE000E100u)
#define PROBE_BIT (1u << 30)
#define REPEAT4(x) x x x x
#define REPEAT16(x) REPEAT4(x) REPEAT4(x) REPEAT4(x) REPEAT4(x)
#line 1
"""

START = """
#include <stdint.h>
#define WEAK __attribute__((weak))
extern uint32_t stack_top;
void program(void);
WEAK void on_hard(void) { for (;;) { __asm volatile("udf #9"); } }
WEAK void on_mem(void) { on_hard(); }
WEAK void on_bus(void) { on_hard(); }
WEAK void on_usage(void) { on_hard(); }
WEAK void on_svc(void) { on_hard(); }
WEAK void on_systick(void) { on_hard(); }
WEAK void on_irq(void) { on_hard(); }
void start(void) {
    program();
    *(volatile uint32_t *)0x4000C00Cu = 1;
    for (;;) { __asm volatile("wfi"); }
}
#define IRQ4 on_irq, on_irq, on_irq, on_irq
#define IRQ16 IRQ4, IRQ4, IRQ4, IRQ4
__attribute__((section(".vectors"), used)) static void (*const vectors[])(void) = {
    (void (*)(void))&stack_top, start, on_hard, on_hard, on_mem, on_bus, on_usage, on_hard,
    on_hard, on_hard, on_hard, on_svc, on_hard, on_hard, on_hard, on_systick, IRQ16, IRQ16, IRQ16};
"""


class Probe(Peripheral):
    """What a program shows and asks of its test."""

    registers = (
        Reg("MARK", 0x0, "w"),
        Reg("LINE", 0x4, "w"),
        Reg("ALARM", 0x8, "w"),
        Reg("DONE", 0xC, "w"),
        Reg("VALUE", 0x10),
        Reg("READ_ONLY", 0x14, "r", 0x77),
    )

    def reset(self) -> None:
        """Forgets everything."""
        super().reset()
        self.marks: list[tuple[int, int]] = []
        self.done = False
        self.clock_is_on = True

    def write_mark(self, value: int) -> None:
        """Keeps value and time."""
        self.marks.append((self.soc.clock.now, value))

    def write_line(self, value: int) -> None:
        """Drives the probe's interrupt."""
        self.soc.set_irq(PROBE_IRQ, bool(value))

    def write_alarm(self, value: int) -> None:
        """Raises the interrupt after so many ticks."""
        self.soc.clock.after(value, lambda: self.soc.set_irq(PROBE_IRQ, True))

    def write_done(self, _value: int) -> None:
        """The program has nothing more to show."""
        self.done = True

    def clocked(self) -> bool:
        """A test may stop the clock."""
        return self.clock_is_on

    def values_marked(self) -> list[int]:
        """What was written to MARK."""
        return [value for _, value in self.marks]

    def times(self) -> list[int]:
        """When MARK was written."""
        return [time for time, _ in self.marks]


def only_probe(soc: Soc) -> dict[str, Peripheral]:
    """For Board(peripherals=...)."""
    return {"PROBE": Probe(soc, "PROBE", PROBE)}


def compile_program(
    code: str, folder: Path, library: Path | None = None, includes: Iterable[Path] = ()
) -> Path:
    """Compiles C that defines program() and handlers (on_bus, on_irq, ...) with the names of
    PRELUDE; RAM is not cleared. ``library``: an archive of objects it uses, compiled as they are
    for a board; ``includes``: folders of their headers. Raises CalledProcessError."""
    image = folder / "program.elf"
    sources = {"start.c": START, "program.c": PRELUDE + code, "program.ld": LINKER_SCRIPT}
    for name, text in sources.items():
        (folder / name).write_text(text)
    command = [COMPILER, "-mcpu=cortex-m3", "-mthumb", "-Os", "-ffreestanding", "-nostdlib"]
    command += ["-Wno-array-bounds", "-Wl,--entry=start", "-T", "program.ld", "-o", str(image)]
    command += [f"-I{include.resolve()}" for include in includes] + ["start.c", "program.c"]
    if library is not None:
        command += ["-Wl,--gc-sections", str(library.resolve()), "--specs=nano.specs"]
        command += ["-lc", "-lgcc"]
    subprocess.run(command, check=True, cwd=folder)
    return image


def run_program(image: Path, seconds: float = 0.1) -> Probe:
    """On a board with nothing but the probe, until the program is done, which it must be."""
    return finish(Board(image, peripherals=only_probe), seconds)


def finish(board: Board, seconds: float = 0.1) -> Probe:
    """Until the program is done, which it must be."""
    probe: Probe = board.periph["PROBE"]
    assert board.run_for(seconds, lambda: probe.done), f"stuck at {board.where()}"
    return probe
