"""The peripherals without a processor: registers by name, RAM, a clock. For trying them out."""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.bus import Bus, BusViolation
from vboard.core.clock import Clock, ticks_of_us
from vboard.native.clock import NativeClock
from vboard.native.core import Core
from vboard.native.models import NATIVE
from vboard.periph import build
from vboard.periph.flash import FLASH_BASE, Flash
from vboard.periph.models import REFERENCE, native_unless
from vboard.periph.pmc import Pmc
from vboard.periph.supply import Rail, SlowClock

RAM_BASE, RAM_BYTES = 0x20070000, 0x18000


class Bench:
    """A Soc. ``irq`` holds the interrupt lines, ``resets`` the causes of resets asked for; they are
    not carried out. ``native``: as for Board."""

    def __init__(
        self,
        *,
        flash: Flash | None = None,
        crystal: bool = True,
        unique_id: bytes = bytes(range(16)),
        seed: int = 1,
        slow: SlowClock | None = None,
        rail: Rail | None = None,
        native: bool | None = None,
    ) -> None:
        native = native_unless(native)
        self.clock: Clock = NativeClock() if native else Clock()
        self.bus = Bus(self.clock)
        self.ram = bytearray(RAM_BYTES)
        self.irq: dict[int, bool] = {}
        self.irq_rises: dict[int, list[int]] = {}
        self.resets: list[tuple[int, int]] = []
        self.flash = flash or Flash()
        self.slow, self.rail = slow or SlowClock(), rail or Rail()
        if isinstance(self.clock, NativeClock):
            calls: dict[str, Callable[..., None]] = {
                "set_irq": lambda number, level: self.set_irq(number, bool(level)),
                "request_reset": self.request_reset,
            }
            self.core = Core(self.clock, self.flash.memory, self.ram, calls)
        self.periph = build(
            self,
            flash=self.flash,
            crystal=crystal,
            unique_id=unique_id,
            seed=seed,
            slow=self.slow,
            rail=self.rail,
            models=NATIVE if native else REFERENCE,
        )
        if native:
            self.core.follow(self._pmc())
        for peripheral in self.periph.values():
            self.bus.add(peripheral)

    # Soc.

    def mck_hz(self) -> int:
        """Master clock."""
        return self._pmc().mck_hz

    def mck_ticks(self) -> int:
        """Clock ticks per cycle."""
        return self._pmc().mck_ticks

    def pid_clocked(self, pid: int) -> bool:
        """Whether a peripheral's clock is on."""
        return self._pmc().pid_clocked(pid)

    def set_irq(self, number: int, level: bool) -> None:
        """Keeps the level and the time of each rise."""
        if level and not self.irq.get(number):
            self.irq_rises.setdefault(number, []).append(self.clock.now)
        self.irq[number] = level

    def read_memory(self, address: int, length: int) -> bytes:
        """RAM or flash."""
        if address >= RAM_BASE:
            return bytes(self.ram[self._offset(address, length) :][:length])
        start = address - FLASH_BASE
        return bytes(self.flash.memory[start : start + length])

    def write_memory(self, address: int, data: bytes) -> None:
        """RAM."""
        start = self._offset(address, len(data))
        self.ram[start : start + len(data)] = data

    def request_reset(self, cause: int) -> None:
        """Notes time and cause."""
        self.resets.append((self.clock.now, cause))

    # The hand of the tester.

    def read(self, register: str) -> int:
        """``read("USART0.CSR")``; an index for arrays: ``"PWM.CDTY4"``."""
        return self.bus.read(self.address(register), 4)

    def write(self, register: str, value: int) -> None:
        """Like read()."""
        self.bus.write(self.address(register), 4, value)

    def run_us(self, us: float) -> None:
        """Lets time pass."""
        self.clock.advance(self.clock.now + ticks_of_us(us))

    def full_speed(self) -> None:
        """84 MHz the way the chip's start-up code does it."""
        self.write("EEFC0.FMR", 0x400)
        self.write("EEFC1.FMR", 0x400)
        for register, value, wait_us in (
            ("PMC.CKGR_MOR", 0x00370809, 2100),
            ("PMC.CKGR_MOR", 0x01370809, 10),
            ("PMC.CKGR_PLLAR", 0x200D3F01, 2000),
            ("PMC.PMC_MCKR", 0x11, 10),
            ("PMC.PMC_MCKR", 0x12, 10),
        ):
            self.write(register, value)
            self.run_us(wait_us)

    def enable(self, *pids: int) -> None:
        """Peripheral clocks on."""
        for pid in pids:
            self.write(f"PMC.PMC_PCER{pid // 32}", 1 << pid % 32)

    def address(self, register: str) -> int:
        """Address of a register by name."""
        name, _, key = register.partition(".")
        peripheral = self.periph[name]
        for reg in peripheral.registers:
            for index in range(reg.count):
                if key == (reg.name if reg.count == 1 else f"{reg.name}{index}"):
                    return peripheral.base + reg.offset + index * reg.stride
        raise KeyError(register)

    def _pmc(self) -> Pmc:
        pmc = self.periph["PMC"]
        assert isinstance(pmc, Pmc)
        return pmc

    def _offset(self, address: int, length: int) -> int:
        start = address - RAM_BASE
        if start < 0 or start + length > RAM_BYTES:
            raise BusViolation(f"DMA to 0x{address:08x} is outside RAM")
        return start
