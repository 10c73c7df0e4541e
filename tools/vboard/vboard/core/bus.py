"""Peripherals as lists of registers, and the strict bus in front of them.

Whatever the chip would silently ignore or get wrong is an error here: an unknown register, a write
to a read-only one, a read of a write-only one, an access that is not 32 bits wide, a peripheral
whose clock is off. The error names the place and ends the run; a test sees it as its failure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

from vboard.core.clock import Clock


class BusViolation(Exception):
    """The image did something to the bus that no correct image does."""


@dataclass(frozen=True)
class Reg:
    """One register, or ``count`` of them every ``stride`` bytes.

    The class holding it may define ``read_<name>()`` and ``write_<name>(value)`` in lower case,
    with an index as first argument when count > 1; otherwise the register just keeps its value.
    """

    name: str
    offset: int
    access: str = "rw"  # "rw", "r" or "w"
    reset: int = 0
    count: int = 1
    stride: int = 4


class Soc(Protocol):
    """What a peripheral may ask of the chip around it."""

    clock: Clock

    def mck_hz(self) -> int:
        """Master clock now."""

    def mck_ticks(self) -> int:
        """Clock ticks (1/84 us) per cycle of the master clock."""

    def pid_clocked(self, pid: int) -> bool:
        """Whether the power management controller clocks this peripheral."""

    def set_irq(self, number: int, level: bool) -> None:
        """Drives an interrupt line into the NVIC; number = peripheral id."""

    def read_memory(self, address: int, length: int) -> bytes:
        """As a bus master (PDC) sees it: RAM and flash only, else BusViolation."""

    def write_memory(self, address: int, data: bytes) -> None:
        """As a bus master (PDC) sees it: RAM only, else BusViolation."""

    def request_reset(self, cause: int) -> None:
        """Resets the processor and its peripherals after the present instruction; RSTTYP cause."""


@dataclass(frozen=True)
class Access:
    """One access as the trace keeps it."""

    time: int
    peripheral: str
    register: str
    value: int
    write: bool


class Peripheral:
    """Base of all peripherals. ``pid`` None: always clocked."""

    registers: ClassVar[tuple[Reg, ...]] = ()
    size: ClassVar[int] = 0x200

    def __init__(self, soc: Soc, name: str, base: int, pid: int | None = None) -> None:
        self.soc, self.name, self.base, self.pid = soc, name, base, pid
        self.values: dict[str, int] = {}
        self._readers: dict[int, tuple[str, Callable[[], int]]] = {}
        self._writers: dict[int, tuple[str, Callable[[int], None]]] = {}
        for reg in self.registers:
            for index in range(reg.count):
                self._bind(reg, index)
        self.reset()

    def reset(self) -> None:
        """To the values after a reset. Subclasses extend it and cancel their events."""
        for reg in self.registers:
            for index in range(reg.count):
                self.values[_key(reg, index)] = reg.reset

    def power_off(self) -> None:
        """The supply is gone at this very instant; for what keeps state without power (flash)."""

    def read(self, offset: int) -> tuple[str, int]:
        """Register name and value. Raises BusViolation."""
        if offset not in self._readers:
            raise self._violation("read of", offset, self._writers)
        name, reader = self._readers[offset]
        return name, reader() & 0xFFFFFFFF

    def write(self, offset: int, value: int) -> str:
        """Register name. Raises BusViolation."""
        if offset not in self._writers:
            raise self._violation("write to", offset, self._readers)
        name, writer = self._writers[offset]
        writer(value)
        return name

    def steady(self, address: int, value: int) -> bool:
        """Whether the register that has just given ``value`` gives it again, and nothing else
        comes of reading it, until some event or access changes this peripheral."""
        del address, value
        return False

    def clocked(self) -> bool:
        """Whether accesses reach it."""
        return self.pid is None or self.soc.pid_clocked(self.pid)

    def _violation(
        self, verb: str, offset: int, others: Mapping[int, tuple[str, object]]
    ) -> BusViolation:
        known = others.get(offset)
        what = f"{known[0]}, which cannot be" if known else f"unknown register +0x{offset:x}"
        return BusViolation(f"{verb} {self.name} {what}")

    def _bind(self, reg: Reg, index: int) -> None:
        offset, key, name = reg.offset + index * reg.stride, _key(reg, index), reg.name.lower()
        arguments = (index,) if reg.count > 1 else ()
        if "r" in reg.access:
            reader = getattr(self, f"read_{name}", None)
            self._readers[offset] = (
                key,
                ((lambda: reader(*arguments)) if reader else (lambda: self.values[key])),
            )
        if "w" in reg.access:
            writer = getattr(self, f"write_{name}", None)
            self._writers[offset] = (
                key,
                (
                    (lambda value: writer(*arguments, value))
                    if writer
                    else (lambda value: self.values.__setitem__(key, value))
                ),
            )


class Bus:
    """All peripherals by address. ``trace`` collects accesses while it is a list."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.peripherals: dict[str, Peripheral] = {}
        self.trace: list[Access] | None = None
        self._pages: dict[int, list[Peripheral]] = {}

    def add(self, peripheral: Peripheral) -> None:
        """Puts a peripheral at its base address."""
        self.peripherals[peripheral.name] = peripheral
        last = peripheral.base + peripheral.size - 1
        for page in range(peripheral.base >> 8, (last >> 8) + 1):
            self._pages.setdefault(page, []).append(peripheral)

    def read(self, address: int, width: int) -> int:
        """A load by the processor. Raises BusViolation."""
        peripheral = self._find(address, width, "load from")
        register, value = peripheral.read(address - peripheral.base)
        if self.trace is not None:
            self.trace.append(Access(self.clock.now, peripheral.name, register, value, False))
        return value

    def write(self, address: int, width: int, value: int) -> None:
        """A store by the processor. Raises BusViolation."""
        peripheral = self._find(address, width, "store to")
        if self.trace is not None:
            at = len(self.trace)
            register = peripheral.write(address - peripheral.base, value)
            self.trace.insert(at, Access(self.clock.now, peripheral.name, register, value, True))
            return
        peripheral.write(address - peripheral.base, value)

    def _find(self, address: int, width: int, verb: str) -> Peripheral:
        for peripheral in self._pages.get(address >> 8, ()):
            if 0 <= address - peripheral.base < peripheral.size:
                break
        else:
            raise BusViolation(f"{verb} 0x{address:08x}, where no peripheral is modelled")
        if width != 4:
            raise BusViolation(f"{verb} {peripheral.name} with {width * 8} bits; it takes 32")
        if not peripheral.clocked():
            raise BusViolation(f"{verb} {peripheral.name}, whose clock is off (PMC_PCER)")
        return peripheral


def _key(reg: Reg, index: int) -> str:
    return reg.name if reg.count == 1 else f"{reg.name}{index}"
