"""Supply rail, slow clock, and the supply controller that watches both."""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.core.clock import TICKS_PER_S, Event
from vboard.periph.protect import need_key, only_bits

KEY = 0xA5
SLOW_CRYSTAL_HZ = 32768
RC_MIN_HZ, RC_MAX_HZ = 20_000, 44_000
CRYSTAL_START_S = 0.9  # typical of 32 kHz crystals

BODRSTS, SMRSTS, SMS, SMOS, OSCSEL = 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
SMRSTEN, SMIEN = 1 << 12, 1 << 13
SAMPLE_SLOW_CLOCKS = {1: 1, 2: 32, 3: 256, 4: 2048}
RESET_GENERAL = 0


class SlowClock:
    """The 32 kHz clock: RC oscillator (20 to 44 kHz over parts and temperature) or crystal."""

    def __init__(self, rc_hz: int = SLOW_CRYSTAL_HZ) -> None:
        if not RC_MIN_HZ <= rc_hz <= RC_MAX_HZ:
            raise ValueError(f"the slow RC runs at {RC_MIN_HZ} to {RC_MAX_HZ} Hz, not {rc_hz}")
        self.rc_hz = rc_hz
        self.crystal = False
        self.before_change: list[Callable[[], None]] = []
        self.after_change: list[Callable[[], None]] = []

    @property
    def hz(self) -> int:
        """Frequency now."""
        return SLOW_CRYSTAL_HZ if self.crystal else self.rc_hz

    def ticks(self, cycles: float) -> int:
        """Ticks of the board's clock for so many slow clocks."""
        return round(cycles * TICKS_PER_S / self.hz)

    def use_crystal(self) -> None:
        """Switches from RC to crystal."""
        for call in self.before_change:
            call()
        self.crystal = True
        for call in self.after_change:
            call()


class Rail:
    """The supply voltage. ``on_change`` is called after each change."""

    def __init__(self, volts: float = 3.3) -> None:
        self._volts = volts
        self.on_change: list[Callable[[], None]] = []

    @property
    def volts(self) -> float:
        """Voltage now."""
        return self._volts

    def set(self, volts: float) -> None:
        """Changes the voltage."""
        self._volts = volts
        for call in self.on_change:
            call()


class Supc(Peripheral):
    """Supply controller. In the backup domain: a reset of the processor leaves it alone."""

    size = 0x20
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("SMMR", 0x04),
        Reg("MR", 0x08, "rw", 0x5A00),
        Reg("SR", 0x14, "r"),
    )

    def __init__(
        self, soc: Soc, name: str, base: int, slow: SlowClock, rail: Rail, *, crystal: bool = True
    ) -> None:
        self.slow, self.rail, self.crystal = slow, rail, crystal
        self._starting: Event | None = None
        self._sample: Event | None = None
        self._flags = 0
        self._low = False
        super().__init__(soc, name, base)
        rail.on_change.append(self._rail_moved)

    def reset(self) -> None:
        """Keeps everything but the first time."""
        if not self.values:
            super().reset()

    def power_off(self) -> None:
        """Forgets, the crystal too."""
        self.values.clear()
        self._flags, self._low = 0, False
        self.soc.clock.cancel(self._starting)
        self.soc.clock.cancel(self._sample)
        self._starting = self._sample = None
        self.slow.crystal = False
        self.rail.on_change.remove(self._rail_moved)

    def write_cr(self, value: int) -> None:
        """XTALSEL only; the regulator cannot be turned off here."""
        need_key("SUPC_CR", value, 24, 8, KEY)
        only_bits("SUPC_CR", value & 0xFFFFFF, 1 << 3)
        if value & 1 << 3 and self.crystal and not self.slow.crystal and not self._starting:
            start = round(CRYSTAL_START_S * TICKS_PER_S)
            self._starting = self.soc.clock.after(start, self.slow.use_crystal)

    def write_mr(self, value: int) -> None:
        """Brown-out detector and friends; only kept."""
        need_key("SUPC_MR", value, 24, 8, KEY)
        self.values["MR"] = value & 0xFFFFFF

    def write_smmr(self, value: int) -> None:
        """Threshold 1.9 V + 0.1 V a step, sampling, reset and interrupt."""
        only_bits("SUPC_SMMR", value, 0x370F)
        if (value >> 8) & 7 not in (0, *SAMPLE_SLOW_CLOCKS):
            raise BusViolation(f"SUPC_SMMR 0x{value:08x}: reserved sampling period")
        self.values["SMMR"] = value
        self._rail_moved()
        self._drive()

    def read_sr(self) -> int:
        """Flags; the reading clears those that only tell of the past."""
        value = self._flags | (SMOS if self._low else 0) | (OSCSEL if self.slow.crystal else 0)
        self._flags = 0
        self._drive()
        return value

    def threshold_volts(self) -> float:
        """What the monitor compares with."""
        return 1.9 + 0.1 * (self.values["SMMR"] & 0xF)

    def _period(self) -> int | None:
        return SAMPLE_SLOW_CLOCKS.get((self.values["SMMR"] >> 8) & 7)

    def _rail_moved(self) -> None:
        """The monitor sees a change only when it samples next."""
        period = self._period()
        if period is None:
            self._low = False
            return
        if self._sample is None:
            ticks = self.slow.ticks(period)
            now = self.soc.clock.now
            self._sample = self.soc.clock.at((now // ticks + 1) * ticks, self._sampled)

    def _sampled(self) -> None:
        self._sample = None
        low = self._period() is not None and self.rail.volts < self.threshold_volts()
        if low and not self._low:
            self._flags |= SMS
            if self.values["SMMR"] & SMRSTEN:
                self._flags |= SMRSTS
                self.soc.request_reset(RESET_GENERAL)
        self._low = low
        self._drive()

    def _drive(self) -> None:
        self.soc.set_irq(0, bool(self._flags & SMS and self.values["SMMR"] & SMIEN))
