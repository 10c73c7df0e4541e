"""Timer counter channel: a 32-bit counter with RC compare, up or up to RC."""

from __future__ import annotations

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.core.clock import Event
from vboard.periph.protect import only_bits
from vboard.periph.supply import SlowClock

COVFS, CPAS, CPBS, CPCS, CLKSTA = 1 << 0, 1 << 2, 1 << 3, 1 << 4, 1 << 16
CLKEN, CLKDIS, SWTRG = 1, 2, 4
CPCTRG, WAVE = 1 << 14, 1 << 15
WAVSEL_UP, WAVSEL_UP_RC = 0, 2
MCK_DIVIDER = {0: 2, 1: 8, 2: 32, 3: 128}
SLOW = 4
WRAP = 1 << 32


class TcChannel(Peripheral):
    """One channel of a block; register names without the channel's number. Outputs, external
    clocks and capture are not modelled."""

    size = 0x40
    registers = (
        Reg("CCR", 0x00, "w"),
        Reg("CMR", 0x04),
        Reg("CV", 0x10, "r"),
        Reg("RA", 0x14),
        Reg("RB", 0x18),
        Reg("RC", 0x1C),
        Reg("SR", 0x20, "r"),
        Reg("IER", 0x24, "w"),
        Reg("IDR", 0x28, "w"),
        Reg("IMR", 0x2C, "r"),
    )

    def __init__(self, soc: Soc, name: str, base: int, pid: int, slow: SlowClock) -> None:
        self.slow = slow
        self._event: Event | None = None
        super().__init__(soc, name, base, pid)

    def reset(self) -> None:
        """Off, at 0."""
        super().reset()
        self.soc.clock.cancel(self._event)
        self._event = None
        self._running = False
        self._unit = 2
        self._since = self.soc.clock.now  # when the count was _count
        self._count = 0
        self._flags = 0
        self._drive()

    def power_off(self) -> None:
        """Stops."""
        self.reset()

    # Counting, carried out when somebody looks.

    def _to_rc(self) -> bool:
        mode = self.values["CMR"]
        if mode & WAVE:
            return mode >> 13 & 3 == WAVSEL_UP_RC
        return bool(mode & CPCTRG)

    def _period(self) -> int:
        return (self.values["RC"] or WRAP) if self._to_rc() else WRAP

    def sync(self) -> None:
        """Brings count and flags up to the present."""
        if not self._running:
            return
        steps, rest = divmod(self.soc.clock.now - self._since, self._unit)
        if steps == 0:
            return
        period = self._period()
        start, end = self._count, self._count + steps
        if start >= period:  # RC was moved below the count: on to the wrap first
            period = WRAP
        for name, flag in (("RA", CPAS), ("RB", CPBS), ("RC", CPCS)):
            if _passed(start, end, self.values[name], period):
                self._flags |= flag
        if period == WRAP and end >= WRAP:
            self._flags |= COVFS
        self._count = end % period
        self._since = self.soc.clock.now - rest

    def retime(self) -> None:
        """The clock's frequency changes or changed."""
        self.sync()
        self._since = self.soc.clock.now
        self._unit = self._unit_ticks()
        self._plan()

    def _unit_ticks(self) -> int:
        source = self.values["CMR"] & 7
        if source == SLOW:
            return self.slow.ticks(1)
        return MCK_DIVIDER[source] * self.soc.mck_ticks()

    # Registers.

    def write_ccr(self, value: int) -> None:
        """Clock on and off, trigger (to 0)."""
        only_bits(f"{self.name} CCR", value, CLKEN | CLKDIS | SWTRG)
        self.sync()
        was = self._running
        if value & (CLKEN | CLKDIS):
            self._running = not value & CLKDIS
        if self._running and (value & SWTRG or not was):
            self._unit = self._unit_ticks()
            self._since = self.soc.clock.now
        if value & SWTRG:
            self._count = 0
        self._plan()

    def write_cmr(self, value: int) -> None:
        """Clock 1 to 5, up or up to RC; not while it counts."""
        what = f"{self.name} CMR 0x{value:08x}"
        if self._running:
            raise BusViolation(f"{what} while the channel counts")
        if value & 7 > SLOW or value & 0x78:
            raise BusViolation(f"{what}: clock not modelled")
        if value & WAVE and value >> 13 & 3 not in (WAVSEL_UP, WAVSEL_UP_RC):
            raise BusViolation(f"{what}: up-down counting is not modelled")
        self.values["CMR"] = value

    def read_cv(self) -> int:
        """Count now."""
        self.sync()
        return self._count

    def write_ra(self, value: int) -> None:
        """Compare A, at once."""
        self._compare("RA", value)

    def write_rb(self, value: int) -> None:
        """Compare B, at once."""
        self._compare("RB", value)

    def write_rc(self, value: int) -> None:
        """Compare C, at once."""
        self._compare("RC", value)

    def _compare(self, name: str, value: int) -> None:
        self.sync()
        self.values[name] = value
        self._plan()

    def read_sr(self) -> int:
        """Flags, cleared by the reading."""
        self.sync()
        value = self._flags | (CLKSTA if self._running else 0)
        self._flags = 0
        self._plan()
        return value

    def write_ier(self, value: int) -> None:
        """Interrupts on."""
        only_bits(f"{self.name} IER", value, COVFS | CPAS | CPBS | CPCS)
        self.sync()
        self.values["IMR"] |= value
        self._plan()

    def write_idr(self, value: int) -> None:
        """Interrupts off."""
        self.values["IMR"] &= ~value
        self._plan()

    def _plan(self) -> None:
        """An event at the next flag that an interrupt waits for."""
        self._drive()
        self.soc.clock.cancel(self._event)
        self._event = None
        wanted = self.values["IMR"] & ~self._flags
        if not self._running or not wanted:
            return
        period = self._period() if self._count < self._period() else WRAP
        targets = [
            self.values[name]
            for name, flag in (("RA", CPAS), ("RB", CPBS), ("RC", CPCS))
            if wanted & flag and self.values[name] <= period
        ]
        if wanted & COVFS and period == WRAP:
            targets.append(WRAP)
        if targets:
            steps = min((target - self._count - 1) % period + 1 for target in targets)
            self._event = self.soc.clock.at(self._since + steps * self._unit, self._happen)

    def _happen(self) -> None:
        self.sync()
        self._plan()

    def _drive(self) -> None:
        assert self.pid is not None
        self.soc.set_irq(self.pid, bool(self._flags & self.values["IMR"]))


def _passed(start: int, end: int, target: int, period: int) -> bool:
    """Whether a count from start (excluded) to end, wrapping at period, meets target. A target of
    the period itself is met at the wrap."""
    if target > period:
        return False
    first = target if target > start else target + period
    return first <= end
