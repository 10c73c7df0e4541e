"""12-bit converter: software trigger and free run, one channel after the other."""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.bus import BusViolation, Reg, Soc
from vboard.core.clock import TICKS_PER_S, Event
from vboard.periph.protect import WriteProtected, only_bits

CHANNELS = 16
FULL_SCALE_VOLTS = 3.3
CLOCK_HZ = (1_000_000, 20_000_000)
DRDY, GOVRE = 1 << 24, 1 << 25
FREERUN, LOWRES, SLEEP = 1 << 7, 1 << 4, 1 << 5
CONVERSION_CLOCKS = 20  # besides tracking
STARTUP_CLOCKS = (0, 8, 16, 24, 64, 80, 96, 112, 512, 576, 640, 704, 768, 832, 896, 960)
ADC_IRQ = 37


class Adc(WriteProtected):
    """``volts[channel]`` is a voltage or a function giving it."""

    size = 0x128
    wp_key = 0x414443
    protected = frozenset({"MR", "CHER", "CHDR"})
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("MR", 0x04),
        Reg("CHER", 0x10, "w"),
        Reg("CHDR", 0x14, "w"),
        Reg("CHSR", 0x18, "r"),
        Reg("LCDR", 0x20, "r"),
        Reg("IER", 0x24, "w"),
        Reg("IDR", 0x28, "w"),
        Reg("IMR", 0x2C, "r"),
        Reg("ISR", 0x30, "r"),
        Reg("OVER", 0x3C, "r"),
        Reg("EMR", 0x40),
        Reg("CDR", 0x50, "r", 0, CHANNELS, 4),
        Reg("WPMR", 0xE4),
    )

    def __init__(self, soc: Soc, name: str, base: int, pid: int) -> None:
        self.volts: dict[int, float | Callable[[], float]] = {}
        self._event: Event | None = None
        super().__init__(soc, name, base, pid)

    def reset(self) -> None:
        """Off."""
        super().reset()
        self.soc.clock.cancel(self._event)
        self._event = None
        self._started: int | None = None  # when the sequence under way began
        self._done = 0  # conversions of it finished
        self._warm = False
        self._flags = self._overrun = 0
        self._drive()

    def power_off(self) -> None:
        """Stops."""
        self.reset()

    # Conversions, carried out when somebody looks.

    def clock_hz(self) -> float:
        """ADC clock; raises BusViolation outside its limits."""
        hz = self.soc.mck_hz() / (2 * ((self.values["MR"] >> 8 & 0xFF) + 1))
        if not CLOCK_HZ[0] <= hz <= CLOCK_HZ[1]:
            raise BusViolation(f"ADC clock {hz:.0f} Hz is outside {CLOCK_HZ[0]} to {CLOCK_HZ[1]}")
        return hz

    def _ticks(self, clocks: int) -> int:
        return round(clocks * TICKS_PER_S / self.clock_hz())

    def _conversion_ticks(self) -> int:
        return self._ticks((self.values["MR"] >> 24 & 0xF) + 1 + CONVERSION_CLOCKS)

    def _channels(self) -> list[int]:
        return [channel for channel in range(CHANNELS) if self.values["CHSR"] >> channel & 1]

    def sync(self) -> None:
        """Finishes the conversions whose time has come."""
        channels = self._channels()
        if self._started is None or not channels:
            return
        finished = max(self.soc.clock.now - self._started, 0) // self._conversion_ticks()
        free = bool(self.values["MR"] & FREERUN)
        if not free:
            finished = min(finished, len(channels))
        # Of many rounds of free running only the last two leave a trace.
        self._done = max(self._done, finished - 2 * len(channels))
        while self._done < finished:
            self._convert(channels[self._done % len(channels)])
            self._done += 1
        if not free and finished == len(channels):
            self._started = None

    def _convert(self, channel: int) -> None:
        source = self.volts.get(channel, 0.0)
        volts = source() if callable(source) else source
        value = min(max(round(volts / FULL_SCALE_VOLTS * 4095), 0), 4095)
        if self.values["MR"] & LOWRES:
            value >>= 2
        if self._flags & DRDY:
            self._flags |= GOVRE
        if self._flags >> channel & 1:
            self._overrun |= 1 << channel
        self._flags |= DRDY | 1 << channel
        self.values[f"CDR{channel}"] = value
        self.values["LCDR"] = value | (channel << 12 if self.values["EMR"] & DRDY else 0)

    def _start(self) -> None:
        self.clock_hz()
        startup = 0 if self._warm else STARTUP_CLOCKS[self.values["MR"] >> 16 & 0xF]
        self._warm = not self.values["MR"] & SLEEP
        self._started = self.soc.clock.now + self._ticks(startup)
        self._done = 0

    # Registers.

    def write_cr(self, value: int) -> None:
        """SWRST and START."""
        only_bits("ADC_CR", value, 3)
        if value & 1:
            self.reset()
        if value & 2:
            self.sync()
            if self._started is None:
                if not self._channels():
                    raise BusViolation("ADC started without a channel")
                self._start()
        self._plan()

    def write_mr(self, value: int) -> None:
        """Mode; hardware triggers, sequences and fast wake-up are not modelled."""
        only_bits("ADC_MR", value, 0x3FBFFFB0)
        self.sync()
        self.values["MR"] = value
        self.clock_hz()
        self._started = None
        if value & FREERUN and self._channels():
            self._start()
        self._plan()

    def write_cher(self, value: int) -> None:
        """Channels on."""
        only_bits("ADC_CHER", value, 0xFFFF)
        self._select(self.values["CHSR"] | value)

    def write_chdr(self, value: int) -> None:
        """Channels off."""
        self._select(self.values["CHSR"] & ~value)

    def _select(self, mask: int) -> None:
        self.sync()
        self.values["CHSR"] = mask
        self._started = None
        if mask and self.values["MR"] & FREERUN:
            self._start()
        self._plan()

    def read_lcdr(self) -> int:
        """Last result; clears DRDY."""
        self.sync()
        self._flags &= ~DRDY
        self._plan()
        return self.values["LCDR"]

    def read_cdr(self, channel: int) -> int:
        """Last result of a channel; clears its EOC."""
        self.sync()
        self._flags &= ~(1 << channel)
        self._plan()
        return self.values[f"CDR{channel}"]

    def read_isr(self) -> int:
        """Flags; the reading clears GOVRE."""
        self.sync()
        value = self._flags
        self._flags &= ~GOVRE
        self._plan()
        return value

    def read_over(self) -> int:
        """Channels overrun since the last reading."""
        self.sync()
        value, self._overrun = self._overrun, 0
        return value

    def write_emr(self, value: int) -> None:
        """TAG only; comparison is not modelled."""
        only_bits("ADC_EMR", value, DRDY)
        self.values["EMR"] = value

    def write_ier(self, value: int) -> None:
        """Interrupts on."""
        only_bits("ADC_IER", value, 0xFFFF | DRDY | GOVRE)
        self.values["IMR"] |= value
        self._plan()

    def write_idr(self, value: int) -> None:
        """Interrupts off."""
        self.values["IMR"] &= ~value
        self._plan()

    def _plan(self) -> None:
        """An event at the next conversion's end, while an interrupt may come of it."""
        self.sync()
        self._drive()
        self.soc.clock.cancel(self._event)
        self._event = None
        if self._started is not None and self.values["IMR"] & ~self._flags:
            due = self._started + (self._done + 1) * self._conversion_ticks()
            self._event = self.soc.clock.at(due, self._plan)

    def _drive(self) -> None:
        self.soc.set_irq(ADC_IRQ, bool(self._flags & self.values["IMR"]))
