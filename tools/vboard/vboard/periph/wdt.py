"""Watchdog: one write of its mode per reset, then it is fed or it bites."""

from __future__ import annotations

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.core.clock import Event
from vboard.periph.protect import need_key, only_bits
from vboard.periph.supply import SlowClock

KEY = 0xA5
WDRSTT = 1
WDFIEN, WDRSTEN, WDRPROC, WDDIS = 1 << 12, 1 << 13, 1 << 14, 1 << 15
WDIDLEHLT = 1 << 29
WDUNF, WDERR = 1, 2
RESET_WATCHDOG = 2
SLOW_PER_COUNT = 128
SETTLE_SLOW_CLOCKS = 3
WDT_IRQ = 4


class Wdt(Peripheral):
    """Counts WDV down on the slow clock / 128. The processor calls idle() around each sleep."""

    size = 0x10
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("MR", 0x04, "rw", 0x3FFF2FFF),
        Reg("SR", 0x08, "r"),
    )

    def __init__(self, soc: Soc, name: str, base: int, slow: SlowClock) -> None:
        self.slow = slow
        self.fed = 0
        self.shortest_left_s: float | None = None
        self._event: Event | None = None
        super().__init__(soc, name, base)
        slow.before_change.append(self._hold)
        slow.after_change.append(self._run)

    def reset(self) -> None:
        """Runs from the reset on, with the longest time."""
        super().reset()
        self._mode_written = False
        self._idle = False
        self._fed_at: int | None = None
        self._flags = 0
        self._left = float(0xFFF)  # counts left when it was last held
        self._since: int | None = None
        self._run()

    def power_off(self) -> None:
        """Stops."""
        self.soc.clock.cancel(self._event)
        self._event = self._since = None
        self.slow.before_change.remove(self._hold)
        self.slow.after_change.remove(self._run)

    # Counting.

    def counter(self) -> float:
        """Counts left."""
        if self._since is None:
            return self._left
        gone = (self.soc.clock.now - self._since) / self.slow.ticks(SLOW_PER_COUNT)
        return max(self._left - gone, 0.0)

    def idle(self, sleeping: bool) -> None:
        """The processor goes to sleep or wakes."""
        self._idle = sleeping
        if self.values["MR"] & WDIDLEHLT:
            self._hold()
            self._run()

    def _hold(self) -> None:
        self._left = self.counter()
        self._since = None
        self.soc.clock.cancel(self._event)
        self._event = None

    def _run(self) -> None:
        mode = self.values["MR"]
        if mode & WDDIS or (mode & WDIDLEHLT and self._idle):
            return
        self.soc.clock.cancel(self._event)
        self._since = self.soc.clock.now
        ticks = round(self._left * self.slow.ticks(SLOW_PER_COUNT))
        self._event = self.soc.clock.after(ticks, lambda: self._bite(WDUNF))

    def _reload(self) -> None:
        self._hold()
        self._left = float(self.values["MR"] & 0xFFF)
        self._run()

    def _bite(self, flag: int) -> None:
        self._flags |= flag
        mode = self.values["MR"]
        if mode & WDFIEN:
            self.soc.set_irq(WDT_IRQ, True)
        self._reload()
        if mode & WDRSTEN:
            self.soc.request_reset(RESET_WATCHDOG)

    # Registers.

    def write_mr(self, value: int) -> None:
        """Once."""
        only_bits("WDT_MR", value, 0x3FFFFFFF)
        if self._mode_written:
            raise BusViolation("WDT_MR written a second time; the chip ignores it")
        if value & WDRPROC:
            raise BusViolation("WDT_MR with WDRPROC: this chip then does not reset at all")
        now, settle = self.soc.clock.now, self.slow.ticks(SETTLE_SLOW_CLOCKS)
        if self._fed_at is not None and now < self._fed_at + settle:
            raise BusViolation("WDT_MR written within three slow clocks after WDT_CR")
        self._mode_written = True
        self._hold()
        self.values["MR"] = value
        self._reload()

    def write_cr(self, value: int) -> None:
        """Feeds it; while the counter is above WDD that is an error."""
        need_key("WDT_CR", value, 24, 8, KEY)
        only_bits("WDT_CR", value & 0xFFFFFF, WDRSTT)
        if not value & WDRSTT:
            return
        left = self.counter()
        self._fed_at = self.soc.clock.now
        self.fed += 1
        seconds = left * SLOW_PER_COUNT / self.slow.hz
        shortest = self.shortest_left_s
        self.shortest_left_s = seconds if shortest is None else min(shortest, seconds)
        if left > self.values["MR"] >> 16 & 0xFFF:
            self._bite(WDERR)
        else:
            self._reload()

    def read_sr(self) -> int:
        """Why it bit; cleared by the reading."""
        value, self._flags = self._flags, 0
        self.soc.set_irq(WDT_IRQ, False)
        return value
