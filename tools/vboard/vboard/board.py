"""The chip on its board: flashes an image, runs it, presses reset, cuts the power."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from vboard import periph
from vboard.chip import RESET_USER, Chip
from vboard.core.bus import Bus, Peripheral, Soc
from vboard.core.clock import TICKS_PER_S, Clock
from vboard.core.cpu import Cpu
from vboard.core.memory import BANK_SIZE, FLASH_SIZE, private_memory
from vboard.core.nvic import PrivateBus
from vboard.image import load
from vboard.native.chip import NativeChip
from vboard.native.clock import NativeClock
from vboard.native.models import NATIVE
from vboard.periph.flash import Flash
from vboard.periph.models import REFERENCE, native_unless

UNIQUE_ID = bytes(range(0x10, 0x20))


class Board:
    """A board with one image in flash. The same calls give the same run, bit for bit.

    ``bank1``: content of flash bank 1, erased if None. ``seed``: what RAM holds at power-on and how
    a torn page looks. ``crystal``: False for a dead 12 MHz crystal. ``trace``: keeps each access to
    a peripheral in ``bus.trace``. ``peripherals``: others than the chip's own, for tests; further
    options go to vboard.periph.build(). ``native``: False for the reference models, which are in
    Python all through; they do the same at the same tick. None: True but for reference_models().

    Peripherals are new after each power-on and want their wires again: wire() sees to it.
    """

    def __init__(
        self,
        image: Path,
        *,
        bank1: bytes | None = None,
        seed: int = 1,
        crystal: bool = True,
        unique_id: bytes = UNIQUE_ID,
        trace: bool = False,
        peripherals: Callable[[Soc], Mapping[str, Peripheral]] | None = None,
        native: bool | None = None,
        **options: Any,
    ) -> None:
        self.image = load(image)
        self.native = native_unless(native)
        self.clock: Clock = NativeClock() if self.native else Clock()
        cells = private_memory(FLASH_SIZE)
        cells[:] = self.image.flash.ljust(FLASH_SIZE, b"\xff")
        self.flash = Flash(cells)
        if bank1 is not None:
            self.bank1 = bank1
        self._seed, self._trace = seed, trace
        self._factory = peripherals or partial(
            periph.build,
            flash=self.flash,
            crystal=crystal,
            unique_id=unique_id,
            seed=seed,
            models=NATIVE if self.native else REFERENCE,
            **options,
        )
        self._wires: list[Callable[[], None]] = []
        self._past_idle = self._past_instructions = self._off_ticks = 0
        self._power_ons = 0
        self._off_since = 0
        self._chip: Chip | None = None
        self.on_breakpoint: Callable[[int], bool] | None = None
        self.power_on()

    # The chip.

    @property
    def chip(self) -> Chip:
        """The chip; a new one after each power-on. Raises RuntimeError while the power is off."""
        if self._chip is None:
            raise RuntimeError("the board has no power; call power_on()")
        return self._chip

    @property
    def powered(self) -> bool:
        """Whether the supply is on."""
        return self._chip is not None

    @property
    def cpu(self) -> Cpu:
        """Processor."""
        return self.chip.cpu

    @property
    def nvic(self) -> PrivateBus:
        """Interrupt controller, SysTick, MPU."""
        return self.chip.nvic

    @property
    def bus(self) -> Bus:
        """Peripherals by address, and the trace."""
        return self.chip.bus

    @property
    def periph(self) -> dict[str, Any]:
        """Peripherals by name, as vboard.periph.build() calls them."""
        return self.chip.periph

    def wire(self, connect: Callable[[], None]) -> None:
        """Calls ``connect`` now and after each power-on, to solder wires to the peripherals."""
        self._wires.append(connect)
        if self.powered:
            connect()

    # Time.

    @property
    def now_s(self) -> float:
        """Seconds since the board came to be."""
        return self.clock.now / TICKS_PER_S

    @property
    def idle_ticks(self) -> int:
        """Time the processor slept in WFI."""
        return self._past_idle + (self._chip.idle_ticks if self._chip else 0)

    @property
    def busy_ticks(self) -> int:
        """Time the processor ran."""
        off = self._off_ticks + (0 if self.powered else self.clock.now - self._off_since)
        return self.clock.now - self.idle_ticks - off

    @property
    def instructions(self) -> int:
        """Instructions executed; those skipped in IT blocks are not counted."""
        return self._past_instructions + (self._chip.instructions if self._chip else 0)

    def run_until(self, tick: int, stop: Callable[[], bool] | None = None) -> bool:
        """Runs until the clock reaches ``tick`` or ``stop()`` holds; True if it was ``stop``.

        Raises BusViolation for whatever no correct image does and Lockup for a fault without a
        handler, both with pc and function. Without power only time passes.
        """
        while self.clock.now < tick:
            if self._chip is not None:
                self._chip.on_breakpoint = self.on_breakpoint
                if self._chip.run_until(tick, stop):
                    return True
            elif self._wait_without_power(tick, stop):
                return True
        return stop is not None and stop()

    def _wait_without_power(self, tick: int, stop: Callable[[], bool] | None) -> bool:
        while self.clock.now < tick and not self.powered:
            if stop is not None and stop():
                return True
            due = self.clock.next_due()
            self.clock.advance(tick if due is None else min(tick, due))
        return False

    def run_for(self, seconds: float, stop: Callable[[], bool] | None = None) -> bool:
        """As run_until(), from now on."""
        return self.run_until(self.clock.now + round(seconds * TICKS_PER_S), stop)

    # What people do to a board.

    def reset_pin(self) -> None:
        """Pulls NRST for a moment; the reset comes with the next run."""
        if "RSTC" in self.periph:
            self.periph["RSTC"].press()
        else:
            self.chip.request_reset(RESET_USER)

    def power_cut(self) -> None:
        """Everything is lost but flash, in which a page being written is torn."""
        chip = self.chip
        chip.power_off()
        self._past_idle += chip.idle_ticks
        self._past_instructions += chip.instructions
        self._off_since = self.clock.now
        self._chip = None

    def power_on(self) -> None:
        """A new chip over the same flash."""
        if self._chip is not None:
            return
        self._off_ticks += self.clock.now - self._off_since
        self._power_ons += 1
        self._chip = (NativeChip if self.native else Chip)(
            self.clock,
            self.flash,
            self._factory,
            seed=self._seed * 1_000_003 + self._power_ons,
            where=self.image.where,
            trace=self._trace,
        )
        for connect in self._wires:
            connect()

    # Looking inside.

    @property
    def bank0(self) -> bytes:
        """Flash bank 0."""
        return self.flash.bank(0)

    @property
    def bank1(self) -> bytes:
        """Flash bank 1."""
        return self.flash.bank(1)

    @bank1.setter
    def bank1(self, content: bytes) -> None:
        if len(content) > BANK_SIZE:
            raise ValueError(f"bank 1 has {BANK_SIZE} bytes, not {len(content)}")
        self.flash.set(1, 0, content.ljust(BANK_SIZE, b"\xff"))

    def symbol(self, name: str) -> int:
        """Address of a symbol of the .elf. Raises KeyError."""
        return self.image.symbols[name]

    def word(self, address: int) -> int:
        """A 32-bit word of flash or RAM."""
        return self.chip.memory.word(address)

    def read(self, address: int, length: int) -> bytes:
        """Bytes of flash or RAM."""
        return self.chip.memory.read(address, length)

    def where(self) -> str:
        """Where the processor is."""
        return self.image.where(self.cpu.pc)
