"""PWM controller: eight left-aligned channels, duty and period taken over at the period's end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.core.clock import Event
from vboard.periph.protect import only_bits

CHANNELS = 8
OUTPUTS = 0x00FF00FF  # OOV and friends: PWMH in [7:0], PWML in [23:16]
CLKA, CLKB = 0xB, 0xC
CPOL = 1 << 9
PWM_IRQ = 36

PeriodListener = Callable[[int, int, int, int], None]


@dataclass
class _Channel:
    number: int
    running: bool = False
    stopping: bool = False
    start: int = 0  # of the present period
    unit: int = 1  # clock ticks per count
    event: Event | None = None
    duty_next: int | None = None
    period_next: int | None = None


class Pwm(Peripheral):
    """``on_period`` is called at the start of each period with channel, start (clock ticks), period
    and high time of PWML in counts of the channel's clock; ``on_change`` after anything that may
    move an output at another time than waveform() told."""

    size = 0x300
    registers = (
        Reg("CLK", 0x00),
        Reg("ENA", 0x04, "w"),
        Reg("DIS", 0x08, "w"),
        Reg("SR", 0x0C, "r"),
        Reg("IER1", 0x10, "w"),
        Reg("IDR1", 0x14, "w"),
        Reg("IMR1", 0x18, "r"),
        Reg("ISR1", 0x1C, "r"),
        Reg("SCM", 0x20),
        Reg("OOV", 0x44),
        Reg("OS", 0x48),
        Reg("OSS", 0x4C, "w"),
        Reg("OSC", 0x50, "w"),
        Reg("OSSUPD", 0x54, "w"),
        Reg("OSCUPD", 0x58, "w"),
        Reg("CMR", 0x200, "rw", 0, CHANNELS, 0x20),
        Reg("CDTY", 0x204, "rw", 0, CHANNELS, 0x20),
        Reg("CDTYUPD", 0x208, "w", 0, CHANNELS, 0x20),
        Reg("CPRD", 0x20C, "rw", 0, CHANNELS, 0x20),
        Reg("CPRDUPD", 0x210, "w", 0, CHANNELS, 0x20),
        Reg("CCNT", 0x214, "r", 0, CHANNELS, 0x20),
    )

    def __init__(self, soc: Soc, name: str, base: int, pid: int) -> None:
        self.on_period: list[PeriodListener] = []
        self.on_change: list[Callable[[], None]] = []
        self._channels: list[_Channel] = []
        super().__init__(soc, name, base, pid)

    def reset(self) -> None:
        """All channels off."""
        super().reset()
        for channel in self._channels:
            self.soc.clock.cancel(channel.event)
        self._channels = [_Channel(number) for number in range(CHANNELS)]
        self._set_next = self._clear_next = 0
        self._flags = 0
        self._drive()
        self._tell()

    def power_off(self) -> None:
        """All channels off."""
        self.reset()

    def retime(self) -> None:
        """The master clock jumped (crystal failure): running channels go on at the new rate."""
        now = self.soc.clock.now
        for channel in self._channels:
            if not channel.running:
                continue
            count = (now - channel.start) // channel.unit
            channel.unit = self._unit(channel.number)
            channel.start = now - count * channel.unit
            left = self.values[f"CPRD{channel.number}"] - count
            self.soc.clock.cancel(channel.event)
            channel.event = self.soc.clock.after(left * channel.unit, partial(self._end, channel))
        self._tell()

    # Outputs.

    def waveform(self, channel: int, output: str = "L") -> tuple[bool, int | None]:
        """Level of PWML ("L") or PWMH ("H") now, and when it changes within this period.

        A channel that does not run leaves its outputs where CPOL puts them: with CPOL = 0 PWML is
        high (to be safe; the data sheet does not tell)."""
        bit = 1 << (channel + (16 if output == "L" else 0))
        if self.values["OS"] & bit:
            return bool(self.values["OOV"] & bit), None
        state = self._channels[channel]
        polarity = bool(self.values[f"CMR{channel}"] & CPOL)
        first_level = (output == "L") != polarity
        if not state.running:
            return first_level, None
        turn = state.start + self.values[f"CDTY{channel}"] * state.unit
        if self.soc.clock.now < turn:
            return first_level, turn
        return not first_level, None

    def running(self, channel: int) -> bool:
        """Whether the channel counts."""
        return self._channels[channel].running

    def high_counts(self, channel: int, output: str = "L") -> int:
        """High time of an output in the present period, in counts of the channel's clock."""
        bit = 1 << (channel + (16 if output == "L" else 0))
        period, duty = self.values[f"CPRD{channel}"], self.values[f"CDTY{channel}"]
        if self.values["OS"] & bit:
            return period if self.values["OOV"] & bit else 0
        first_level = (output == "L") != bool(self.values[f"CMR{channel}"] & CPOL)
        return duty if first_level else period - duty

    # A period's life.

    def _begin(self, channel: _Channel) -> None:
        number = channel.number
        channel.start = self.soc.clock.now
        period = self.values[f"CPRD{number}"]
        channel.event = self.soc.clock.after(period * channel.unit, partial(self._end, channel))
        self._tell()
        high = self.high_counts(number)
        for call in self.on_period:
            call(number, channel.start, period, high)

    def _end(self, channel: _Channel) -> None:
        number = channel.number
        self._take_over(channel)
        self._flags |= 1 << number
        self._drive()
        if channel.stopping:
            channel.running = channel.stopping = False
            channel.event = None
            self._tell()
        else:
            self._begin(channel)

    def _take_over(self, channel: _Channel) -> None:
        number = channel.number
        if channel.period_next is not None:
            self.values[f"CPRD{number}"], channel.period_next = channel.period_next, None
        if channel.duty_next is not None:
            self.values[f"CDTY{number}"], channel.duty_next = channel.duty_next, None
        self._check_duty(number)
        own = 0x00010001 << number
        self.values["OS"] |= self._set_next & own
        self.values["OS"] &= ~(self._clear_next & own)
        self._set_next &= ~own
        self._clear_next &= ~own

    def _check_duty(self, number: int) -> None:
        period, duty = self.values[f"CPRD{number}"], self.values[f"CDTY{number}"]
        if period == 0 or duty > period:
            raise BusViolation(f"PWM channel {number}: duty {duty} of a period of {period}")

    def _unit(self, number: int) -> int:
        prescaler = self.values[f"CMR{number}"] & 0xF
        if prescaler <= 10:
            return self.soc.mck_ticks() << prescaler
        clk = self.values["CLK"] >> (0 if prescaler == CLKA else 16)
        divider = clk & 0xFF
        if divider == 0:
            raise BusViolation(f"PWM channel {number} runs on a clock that is off (CLK)")
        return (self.soc.mck_ticks() << ((clk >> 8) & 0xF)) * divider

    # Registers.

    def write_clk(self, value: int) -> None:
        """CLKA and CLKB; not under a running channel."""
        only_bits("PWM_CLK", value, 0x0FFF0FFF)
        if max((value >> 8) & 0xF, (value >> 24) & 0xF) > 10:
            raise BusViolation(f"PWM_CLK 0x{value:08x}: reserved prescaler")
        self.refuse_if_running("PWM_CLK written")
        self.values["CLK"] = value

    def refuse_if_running(self, what: str = "the master clock changed") -> None:
        """Raises BusViolation while a channel counts."""
        for channel in self._channels:
            if channel.running:
                raise BusViolation(f"{what} while PWM channel {channel.number} runs")

    def write_ena(self, value: int) -> None:
        """Starts channels, each with a whole period."""
        only_bits("PWM_ENA", value, 0xFF)
        for channel in self._channels:
            if not value >> channel.number & 1:
                continue
            channel.stopping = False
            if not channel.running:
                self._check_duty(channel.number)
                channel.unit = self._unit(channel.number)
                channel.running = True
                self._begin(channel)

    def write_dis(self, value: int) -> None:
        """Stops channels at the end of their period."""
        for channel in self._channels:
            if value >> channel.number & 1 and channel.running:
                channel.stopping = True

    def read_sr(self) -> int:
        """Channels that run."""
        return sum(1 << channel.number for channel in self._channels if channel.running)

    def write_ier1(self, value: int) -> None:
        """Period interrupts on."""
        only_bits("PWM_IER1", value, 0xFF)
        self.values["IMR1"] |= value
        self._drive()

    def write_idr1(self, value: int) -> None:
        """Period interrupts off."""
        self.values["IMR1"] &= ~value
        self._drive()

    def read_isr1(self) -> int:
        """Channels whose period ended since the last reading."""
        value, self._flags = self._flags, 0
        self._drive()
        return value

    def write_scm(self, value: int) -> None:
        """Synchronous channels are not modelled."""
        only_bits("PWM_SCM", value, 0)

    def write_oov(self, value: int) -> None:
        """Levels of overridden outputs, at once."""
        only_bits("PWM_OOV", value, OUTPUTS)
        self.values["OOV"] = value
        self._tell()

    def write_os(self, value: int) -> None:
        """Which outputs are overridden, at once."""
        only_bits("PWM_OS", value, OUTPUTS)
        self.values["OS"] = value
        self._tell()

    def write_oss(self, value: int) -> None:
        """Override on, at once."""
        self.write_os(self.values["OS"] | value)

    def write_osc(self, value: int) -> None:
        """Override off, at once."""
        self.write_os(self.values["OS"] & ~value)

    def write_ossupd(self, value: int) -> None:
        """Override on from the next period of the channel."""
        only_bits("PWM_OSSUPD", value, OUTPUTS)
        self._set_next |= value
        self._clear_next &= ~value

    def write_oscupd(self, value: int) -> None:
        """Override off from the next period of the channel."""
        only_bits("PWM_OSCUPD", value, OUTPUTS)
        self._clear_next |= value
        self._set_next &= ~value

    def write_cmr(self, number: int, value: int) -> None:
        """Clock and polarity; not while the channel runs."""
        only_bits(f"PWM_CMR{number}", value, 0xF | CPOL)
        if value & 0xF > CLKB:
            raise BusViolation(f"PWM_CMR{number}: reserved clock")
        self._stopped("CMR", number)
        self.values[f"CMR{number}"] = value
        self._tell()

    def write_cdty(self, number: int, value: int) -> None:
        """Duty of a channel that does not run; the chip ignores it otherwise."""
        self._stopped("CDTY", number)
        self.values[f"CDTY{number}"] = self._sixteen("CDTY", number, value)

    def write_cprd(self, number: int, value: int) -> None:
        """Period of a channel that does not run; the chip ignores it otherwise."""
        self._stopped("CPRD", number)
        self.values[f"CPRD{number}"] = self._sixteen("CPRD", number, value)

    def write_cdtyupd(self, number: int, value: int) -> None:
        """Duty from the next period on; the last one written counts."""
        self._counts("CDTYUPD", number).duty_next = self._sixteen("CDTYUPD", number, value)

    def write_cprdupd(self, number: int, value: int) -> None:
        """Period from the next one on."""
        self._counts("CPRDUPD", number).period_next = self._sixteen("CPRDUPD", number, value)

    def read_ccnt(self, number: int) -> int:
        """Count within the period."""
        channel = self._channels[number]
        if not channel.running:
            return 0
        return (self.soc.clock.now - channel.start) // channel.unit

    def _stopped(self, register: str, number: int) -> None:
        if self._channels[number].running:
            raise BusViolation(f"PWM_{register}{number} written while the channel runs")

    def _counts(self, register: str, number: int) -> _Channel:
        if not self._channels[number].running:
            raise BusViolation(f"PWM_{register}{number} written while the channel is off")
        return self._channels[number]

    def _sixteen(self, register: str, number: int, value: int) -> int:
        if value > 0xFFFF:
            raise BusViolation(f"PWM_{register}{number}: {value} does not fit in 16 bits")
        return value

    def _drive(self) -> None:
        self.soc.set_irq(PWM_IRQ, bool(self._flags & self.values["IMR1"]))

    def _tell(self) -> None:
        for call in self.on_change:
            call()
