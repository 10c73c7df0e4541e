"""SysTick (ARMv7-M Architecture Reference Manual, B3.3), computed when somebody looks."""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.clock import Clock, Event

ENABLE, TICKINT, CLKSOURCE, COUNTFLAG = 1 << 0, 1 << 1, 1 << 2, 1 << 16
SLOW_DIVIDER = 8  # CLKSOURCE = 0 counts the master clock divided by this
CALIBRATION = 10500


class SysTick:
    """``mck_ticks()`` is asked for the clock; ``expired()`` is called when TICKINT is set."""

    def __init__(
        self, clock: Clock, mck_ticks: Callable[[], int], expired: Callable[[], None]
    ) -> None:
        self._clock, self._mck_ticks, self._expired = clock, mck_ticks, expired
        self._event: Event | None = None
        self.reset()

    def reset(self) -> None:
        """Off."""
        self._clock.cancel(self._event)
        self._event = None
        self._control = CLKSOURCE
        self._load = 0
        self._counted = False
        self._left = 0  # cycles to zero while stopped
        self._zero_at: int | None = None  # None while stopped

    def read_control(self) -> int:
        """CTRL; clears COUNTFLAG."""
        self._catch_up()
        value = self._control | (COUNTFLAG if self._counted else 0)
        self._counted = False
        return value

    def write_control(self, value: int) -> None:
        """CTRL."""
        self.before_clock_change()
        self._control = value & (ENABLE | TICKINT | CLKSOURCE)
        self.after_clock_change()

    def read_load(self) -> int:
        """LOAD."""
        return self._load

    def write_load(self, value: int) -> None:
        """LOAD, from the next reload on."""
        self._catch_up()
        self._load = value & 0xFFFFFF
        if self._control & ENABLE and self._zero_at is None:
            self.after_clock_change()

    def read_value(self) -> int:
        """VAL."""
        self._catch_up()
        left = self._left
        if self._zero_at is not None:
            left = -(-(self._zero_at - self._clock.now) // self._cycle())
        return left if left <= self._load else 0

    def write_value(self, _value: int) -> None:
        """VAL: to zero, whatever is written; the next clock reloads."""
        self.before_clock_change()
        self._counted = False
        self._left = 0
        self.after_clock_change()

    def before_clock_change(self) -> None:
        """Stops the counting; the cycles left stay."""
        self._catch_up()
        self._clock.cancel(self._event)
        self._event = None
        if self._zero_at is not None:
            self._left = -(-(self._zero_at - self._clock.now) // self._cycle())
            self._zero_at = None

    def after_clock_change(self) -> None:
        """Goes on counting, if it is on."""
        if not self._control & ENABLE or (self._load == 0 and self._left == 0):
            return
        left = self._left or self._load + 1
        self._zero_at = self._clock.now + left * self._cycle()
        self._schedule()

    def _cycle(self) -> int:
        return self._mck_ticks() * (1 if self._control & CLKSOURCE else SLOW_DIVIDER)

    def _schedule(self) -> None:
        if self._control & TICKINT and self._zero_at is not None:
            self._event = self._clock.at(self._zero_at, self._fire)

    def _fire(self) -> None:
        self._catch_up()
        self._expired()
        self._schedule()

    def _catch_up(self) -> None:
        """Counts the zeros up to now."""
        if self._zero_at is None or self._zero_at > self._clock.now:
            return
        self._counted = True
        if self._load == 0:
            self._zero_at, self._left = None, 0
            return
        period = (self._load + 1) * self._cycle()
        self._zero_at += period * (1 + (self._clock.now - self._zero_at) // period)
