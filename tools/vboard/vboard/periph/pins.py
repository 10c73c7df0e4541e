"""Which pin carries which signal, and what a pin did over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vboard.core.clock import Clock
from vboard.periph.pio import Pio
from vboard.periph.pwm import Pwm

# (port, bit, peripheral) of PWM outputs and of the transmit pins.
PWML_PINS = {
    0: ("PIOC", 2, "B"),
    1: ("PIOC", 4, "B"),
    2: ("PIOC", 6, "B"),
    3: ("PIOC", 8, "B"),
    4: ("PIOC", 21, "B"),
    5: ("PIOC", 22, "B"),
    6: ("PIOC", 23, "B"),
    7: ("PIOC", 24, "B"),
}
TXD_PINS = {
    "UART": ("PIOA", 9, "A"),
    "USART0": ("PIOA", 11, "A"),
    "USART1": ("PIOA", 13, "A"),
    "USART2": ("PIOB", 20, "A"),
    "USART3": ("PIOD", 4, "B"),
}


@dataclass(frozen=True)
class Pulse:
    """A time during which the pin was high."""

    start: int
    ticks: int


class PinTrace:
    """The level of one pin, as edges (time, level); the first is the level when connect() was first
    called. Follows the port, the pull-up and the PWM channel whose PWML may drive it. connect() it
    anew to the peripherals of each power-on; it is low in between.

    ``on_pulse`` is called at the start of each PWM period like Pwm.on_period, without the channel
    and with a high time of 0 while the pin does not carry it."""

    def __init__(self, clock: Clock, bit: int, channel: int | None = None) -> None:
        self.clock, self.bit, self.channel = clock, bit, channel
        self._pio: Pio | None = None
        self._pwm: Pwm | None = None
        self.on_pulse: list[Callable[[int, int, int], None]] = []
        self.edges: list[tuple[int, bool]] = []
        self._turn: int | None = None

    def connect(self, pio: Pio, pwm: Pwm | None = None) -> None:
        """Puts the probe on the pin."""
        self._pio, self._pwm = pio, pwm
        pio.on_change.append(self._look)
        if pwm is not None:
            pwm.on_change.append(self._look)
            pwm.on_period.append(self._period)
        self._look()

    @property
    def driven_by_pwm(self) -> bool:
        """Whether the pin carries the channel's PWML."""
        if self._pio is None or self._pwm is None or self.channel is None:
            return False
        return PWML_PINS[self.channel] == (self._pio.name, self.bit, self._pio.owner(self.bit))

    def level(self) -> bool:
        """Level now."""
        self._settle()
        return self.edges[-1][1]

    def pulses(self) -> list[Pulse]:
        """All times high so far; one that lasts counts up to now."""
        self._settle(up_to_now=True)
        out: list[Pulse] = []
        rise: int | None = None
        for time, level in [*self.edges, (self.clock.now, False)]:
            if level and rise is None:
                rise = time
            elif not level and rise is not None:
                if time > rise:
                    out.append(Pulse(rise, time - rise))
                rise = None
        return out

    def longest_high(self) -> int:
        """Ticks of the longest time high."""
        return max((pulse.ticks for pulse in self.pulses()), default=0)

    def _look(self) -> None:
        """Something changed: closes what was, starts what is."""
        self._settle()
        level, turn = self._source()
        self._turn = turn
        if not self.edges or self.edges[-1][1] != level:
            self._edge(self.clock.now, level)

    def _settle(self, up_to_now: bool = False) -> None:
        turn = self._turn
        if turn is None or turn > self.clock.now or (turn == self.clock.now and not up_to_now):
            return
        self._turn = None
        self._edge(turn, not self.edges[-1][1])

    def _edge(self, time: int, level: bool) -> None:
        if len(self.edges) > 1 and self.edges[-1][0] == time:
            self.edges.pop()
            if self.edges[-1][1] == level:
                return
        self.edges.append((time, level))

    def _source(self) -> tuple[bool, int | None]:
        assert self._pio is not None
        if self._pwm is not None and self.channel is not None and self.driven_by_pwm:
            return self._pwm.waveform(self.channel)
        return self._pio.level(self.bit), None

    def _period(self, channel: int, start: int, period: int, high: int) -> None:
        if channel != self.channel:
            return
        seen = high if self.driven_by_pwm else 0
        for call in self.on_pulse:
            call(start, period, seen)
