"""Embedded flash controller: one per bank."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.core.clock import Event, ticks_of_us
from vboard.periph.flash import (
    BANK_BYTES,
    FLASH_BASE,
    PAGE_BYTES,
    PAGES,
    REGION_PAGES,
    REGIONS,
    UNIT_BYTES,
    WORDS,
    Flash,
    tear,
)
from vboard.periph.protect import need_key, only_bits
from vboard.periph.supply import Rail

FRDY, FCMDE, FLOCKE = 1 << 0, 1 << 1, 1 << 2
SCOD = 1 << 16
FSR_OFFSET = 0x08
KEY = 0x5A
WRITE_WAIT_STATES = 6  # erratum: while the latch is filled and the command is given

GETD, WP, WPL, EWP, EWPL, EA = 0x00, 0x01, 0x02, 0x03, 0x04, 0x05
SLB, CLB, GLB, SGPB, CGPB, GGPB, STUI, SPUI = 0x08, 0x09, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
PAGE_COMMANDS = frozenset({WP, WPL, EWP, EWPL})
REGION_COMMANDS = frozenset({SLB, CLB})
GPNVM_COMMANDS = frozenset({SGPB, CGPB})
ARGUMENT_LIMIT = (
    dict.fromkeys(PAGE_COMMANDS | REGION_COMMANDS, PAGES)
    | dict.fromkeys(GPNVM_COMMANDS, 3)
    | dict.fromkeys((GETD, EA, GLB, GGPB, STUI, SPUI), 1)
)


@dataclass
class FlashTiming:
    """Microseconds per command; not in any source at hand, of the order of the data sheet's."""

    erase_write_us: float = 4600.0
    write_us: float = 2300.0
    erase_all_us: float = 10_000.0
    bit_us: float = 1000.0  # lock and GPNVM bits
    read_us: float = 1.0  # GETD, GLB, GGPB, SPUI

    def of(self, command: int) -> int:
        """Clock ticks of a command."""
        us = self.read_us
        if command in PAGE_COMMANDS:
            us = self.erase_write_us if command in (EWP, EWPL) else self.write_us
        elif command == EA:
            us = self.erase_all_us
        elif command in REGION_COMMANDS | GPNVM_COMMANDS:
            us = self.bit_us
        return ticks_of_us(us)


@dataclass
class _Running:
    command: int
    argument: int
    start: int
    end: int
    low_supply: bool


class Eefc(Peripheral):
    """Controller of bank 0 or 1.

    The processor hands every store into the bank to latch_store(), and asks readable() before it
    reads from a bank that is ``busy`` or shows the unique id; ``on_busy`` is called when that may
    have changed. With ``strict`` off
    a missing FWS = 6 corrupts the page instead of being a violation.
    """

    size = 0x10
    registers = (
        Reg("FMR", 0x00),
        Reg("FCR", 0x04, "w"),
        Reg("FSR", FSR_OFFSET, "r", 0x1),
        Reg("FRR", 0x0C, "r"),
    )

    def __init__(
        self,
        soc: Soc,
        name: str,
        base: int,
        bank: int,
        flash: Flash,
        rail: Rail,
        *,
        unique_id: bytes,
        seed: int,
    ) -> None:
        self.bank, self.flash, self.rail, self.unique_id = bank, flash, rail, unique_id
        self.timing = FlashTiming()
        self.min_write_volts = 2.0
        self.strict = True
        self.fail_next: int | None = None  # FCMDE or FLOCKE for the next page command
        self.speed_check: Callable[[int], None] = lambda waits: None
        self.on_busy: list[Callable[[bool], None]] = []
        self.commands: dict[int, int] = {}  # how often each was given
        self._chance = random.Random(seed * 2 + bank)
        self._event: Event | None = None
        self._running: _Running | None = None
        self._hidden: bytes | None = None  # what the unique id covers
        super().__init__(soc, name, base)
        rail.on_change.append(self._rail_moved)

    def reset(self) -> None:
        """A reset of the chip in the middle of a command tears the page."""
        if self._running is not None:
            self._abort()
        self._end_unique_id()
        super().reset()
        self.soc.clock.cancel(self._event)
        self._event, self._running = None, None
        self._errors = 0
        self._results: list[int] = []
        self._latch: dict[int, int] = {}
        self._latch_page: int | None = None
        self._bad_latch = False
        self._drive()

    def power_off(self) -> None:
        """Whatever is under way stays half done."""
        if self._running is not None:
            self._abort()
        self._end_unique_id()
        self.rail.on_change.remove(self._rail_moved)

    # Seen by the processor.

    @property
    def busy(self) -> bool:
        """Whether a command is under way: reads of this bank would stall or return garbage."""
        return self._running is not None

    @property
    def unique_id_shown(self) -> bool:
        """Between STUI and SPUI: the bank shows the unique id; code must not run from it."""
        return self._hidden is not None

    @property
    def wait_states(self) -> int:
        """FWS."""
        return (self.values["FMR"] >> 8) & 0xF

    def readable(self, address: int) -> bool:
        """Whether a load from an address of this bank gives what it should now."""
        offset = address - FLASH_BASE - self.bank * BANK_BYTES
        if self.unique_id_shown and not self.busy:
            return 0 <= offset < UNIT_BYTES
        return not self.busy

    def latch_store(self, address: int, width: int, value: int) -> None:
        """A store of ``width`` bytes into the bank: goes to the page latch. Raises BusViolation."""
        where = f"store to flash 0x{address:08x}"
        if width != 4 or address % 4:
            raise BusViolation(f"{where} with {width * 8} bits; the latch takes whole words")
        if self.busy or self.unique_id_shown:
            raise BusViolation(f"{where} while {self.name} is busy")
        page, word = divmod((address - FLASH_BASE - self.bank * BANK_BYTES) // 4, WORDS)
        self._need_wait_states(where)
        if not self._latch:
            self._latch_page = page
        if page != self._latch_page:
            raise BusViolation(f"{where}: page {page}, but the latch holds page {self._latch_page}")
        if word != len(self._latch):
            raise BusViolation(f"{where}: word {word} of the page where {len(self._latch)} is due")
        self._latch[word] = value & 0xFFFFFFFF

    def _need_wait_states(self, what: str) -> None:
        if self.wait_states == WRITE_WAIT_STATES:
            return
        if self.strict:
            raise BusViolation(f"{what} with FWS {self.wait_states}; the erratum asks for 6")
        self._bad_latch = True

    # Registers.

    def write_fmr(self, value: int) -> None:
        """Wait states, FRDY interrupt, SCOD."""
        only_bits(f"{self.name} FMR", value, 0x01010F01)
        self.values["FMR"] = value
        self.speed_check(self.wait_states)
        self._drive()

    def read_fsr(self) -> int:
        """Ready and errors; the reading clears the errors."""
        value = self._errors | (0 if self._not_ready() else FRDY)
        self._errors = 0
        return value

    def steady(self, address: int, value: int) -> bool:
        """FSR, while there is no error that the reading would have cleared."""
        return address == self.base + FSR_OFFSET and not value & ~FRDY

    def _not_ready(self) -> bool:
        return self.busy or self.unique_id_shown

    def read_frr(self) -> int:
        """Next word of the answer to GETD, GLB or GGPB."""
        return self._results.pop(0) if self._results else 0

    def write_fcr(self, value: int) -> None:
        """A command."""
        need_key(f"{self.name} FCR", value, 24, 8, KEY)
        command, argument = value & 0xFF, (value >> 8) & 0xFFFF
        if self.busy:
            raise BusViolation(f"{self.name} command 0x{command:02x} while FRDY is 0")
        if self.unique_id_shown and command != SPUI:
            raise BusViolation(f"{self.name} command 0x{command:02x} before SPUI")
        self._errors = 0
        self.commands[command] = self.commands.get(command, 0) + 1
        if argument >= ARGUMENT_LIMIT.get(command, 0):
            self._errors |= FCMDE
            return
        if command in PAGE_COMMANDS and not self._may_program(command, argument):
            self._empty_latch()
            return
        self._check_unique_id(command)
        if command == STUI:  # shown at once; FRDY stays down until SPUI is through
            self._small(command, argument)
            self._drive()
            self._tell(True)
        else:
            self._start(command, argument)

    def _may_program(self, command: int, page: int) -> bool:
        what = f"{self.name} command 0x{command:02x} page {page}"
        self._need_wait_states(what)
        if len(self._latch) != WORDS:
            raise BusViolation(f"{what}: {len(self._latch)} of {WORDS} words are in the latch")
        if page != self._latch_page:
            raise BusViolation(f"{what}: the latch was filled for page {self._latch_page}")
        error = FLOCKE if page // REGION_PAGES in self.flash.locked[self.bank] else self.fail_next
        self.fail_next = None
        if error:
            self._errors |= error
            return False
        if command in (WP, WPL):
            self._check_units(what, page)
        return True

    def _check_units(self, what: str, page: int) -> None:
        old, new = self.flash.page(self.bank, page), self._latch_bytes()
        blank = b"\xff" * UNIT_BYTES
        for at in range(0, PAGE_BYTES, UNIT_BYTES):
            unit = slice(at, at + UNIT_BYTES)
            if old[unit] != blank and new[unit] != blank:
                raise BusViolation(f"{what}: 16 bytes at +{at} programmed twice without an erase")

    def _check_unique_id(self, command: int) -> None:
        if command not in (STUI, SPUI):
            return
        if self.bank != 0:
            raise BusViolation(
                f"{self.name}: reading the unique id is only known to work on bank 0"
            )
        if not self.values["FMR"] & SCOD:
            raise BusViolation(f"{self.name}: unique id without FMR.SCOD (erratum)")

    # A command's life.

    def _start(self, command: int, argument: int) -> None:
        now = self.soc.clock.now
        end = now + self.timing.of(command)
        low = self.rail.volts < self.min_write_volts
        self._running = _Running(command, argument, now, end, low)
        self._event = self.soc.clock.at(end, self._finish)
        self._drive()
        self._tell(True)

    def _finish(self) -> None:
        running = self._running
        assert running is not None
        self._running = self._event = None
        if running.command in PAGE_COMMANDS:
            self._program(running)
        elif running.command == EA:
            self._erase_all(running)
        else:
            self._small(running.command, running.argument)
        self._drive()
        self._tell(False)

    def _program(self, running: _Running) -> None:
        page, erase = running.argument, running.command in (EWP, EWPL)
        if running.low_supply:
            self._tear(running, self._chance.random())
            return
        old, new = self.flash.page(self.bank, page), self._latch_bytes()
        if not erase:
            new = bytes(a & b for a, b in zip(old, new, strict=True))
        if self._bad_latch:
            new = self._corrupted(new)
        self._count(page, erase)
        self.flash.set(self.bank, page * PAGE_BYTES, new)
        self._empty_latch()
        if running.command in (WPL, EWPL):
            self.flash.locked[self.bank].add(page // REGION_PAGES)

    def _count(self, page: int, erase: bool) -> None:
        wear = self.flash.wear[self.bank]
        wear.programmed[page] += 1
        wear.erased[page] += erase

    def _erase_all(self, running: _Running) -> None:
        if self.flash.locked[self.bank] or running.low_supply:
            self._errors |= FLOCKE
            return
        self.flash.set(self.bank, 0, b"\xff" * BANK_BYTES)

    def _small(self, command: int, argument: int) -> None:
        flash, locked = self.flash, self.flash.locked[self.bank]
        if command == GETD:
            plane = [1, BANK_BYTES, REGIONS, *[REGION_PAGES * PAGE_BYTES] * REGIONS]
            self._results = [0, BANK_BYTES, PAGE_BYTES, *plane]
        elif command == GLB:
            self._results = [sum(1 << region for region in locked)]
        elif command == SLB:
            locked.add(argument // REGION_PAGES)
        elif command == CLB:
            locked.discard(argument // REGION_PAGES)
        elif command == SGPB:
            flash.gpnvm |= 1 << argument
        elif command == CGPB:
            flash.gpnvm &= ~(1 << argument)
        elif command == GGPB:
            self._results = [flash.gpnvm]
        elif command == STUI:
            self._hidden = bytes(flash.memory[:UNIT_BYTES])
            flash.set(0, 0, self.unique_id)
        elif command == SPUI:
            self._end_unique_id()

    def _end_unique_id(self) -> None:
        if self._hidden is not None:
            self.flash.set(0, 0, self._hidden)
            self._hidden = None

    # What goes wrong.

    def _rail_moved(self) -> None:
        if self._running is not None and self.rail.volts < self.min_write_volts:
            self._running.low_supply = True

    def _abort(self) -> None:
        running = self._running
        assert running is not None
        self.soc.clock.cancel(self._event)
        self._running = self._event = None
        span = running.end - running.start
        progress = (self.soc.clock.now - running.start) / span
        if running.command in PAGE_COMMANDS:
            self._tear(running, progress)
        elif running.command == EA:
            for page in range(PAGES):
                old = self.flash.page(self.bank, page)
                torn = tear(old, b"\xff" * PAGE_BYTES, True, progress / 2, self._chance)
                self.flash.set(self.bank, page * PAGE_BYTES, torn)
        self._tell(False)

    def _tear(self, running: _Running, progress: float) -> None:
        page, erase = running.argument, running.command in (EWP, EWPL)
        old = self.flash.page(self.bank, page)
        torn = tear(old, self._latch_bytes(), erase, progress, self._chance)
        self._count(page, erase)
        self.flash.set(self.bank, page * PAGE_BYTES, torn)
        self.flash.torn.append((self.bank, page))
        self._empty_latch()

    def _corrupted(self, data: bytes) -> bytes:
        out = bytearray(data)
        out[self._chance.randrange(PAGE_BYTES)] ^= 1 << self._chance.randrange(8)
        return bytes(out)

    def _latch_bytes(self) -> bytes:
        return b"".join(self._latch[word].to_bytes(4, "little") for word in range(WORDS))

    def _empty_latch(self) -> None:
        self._latch, self._latch_page, self._bad_latch = {}, None, False

    def _drive(self) -> None:
        self.soc.set_irq(6 + self.bank, bool(self.values["FMR"] & 1) and not self._not_ready())

    def _tell(self, busy: bool) -> None:
        for call in self.on_busy:
            call(busy)
