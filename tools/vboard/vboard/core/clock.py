"""Virtual time and what is due when.

Time is a whole number of ticks of 1/84 microsecond since power-on: one cycle of the 84 MHz master
clock, and a whole number of them for each slower clock the chip can run on. No wall clock anywhere.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

TICKS_PER_US = 84
TICKS_PER_S = 84_000_000
_MANY_OWN_EVENTS = 256


@dataclass(slots=True)
class Event:
    """A callback at a time."""

    due: int
    callback: Callable[[], None]
    cancelled: bool = False


@dataclass(slots=True)
class _Time:
    """``events``: a heap of (due, number, event); same time: in the order of scheduling."""

    now: int = 0
    number: int = 0
    events: list[tuple[int, int, Event]] = field(default_factory=list)


class Clock:
    """The one clock of a board. ``now`` moves only in advance().

    ``line_type``: the kind of serial lines that belong to it, if not the usual one.
    """

    line_type: ClassVar[type[Any] | None] = None

    def __init__(self) -> None:
        self._time = _Time()
        self._own: list[Event] | None = None
        self._dropped = False

    def part(self) -> Clock:
        """The same time; but what is scheduled through it can be dropped all at once."""
        part = Clock()
        part._time = self._time
        part._own = []
        return part

    @property
    def now(self) -> int:
        """Ticks since the board came to be."""
        return self._time.now

    def at(self, due: int, callback: Callable[[], None]) -> Event:
        """Calls ``callback`` once when time reaches ``due`` (not before now)."""
        time = self._time
        time.number += 1
        event = Event(max(due, time.now), callback, self._dropped)
        heapq.heappush(time.events, (event.due, time.number, event))
        if self._own is not None:
            self._remember(event)
        return event

    def after(self, ticks: int, callback: Callable[[], None]) -> Event:
        """Calls ``callback`` once, ``ticks`` from now."""
        return self.at(self._time.now + ticks, callback)

    def cancel(self, event: Event | None) -> None:
        """Takes an event back; None and past events are ignored."""
        if event is not None:
            event.cancelled = True

    def drop(self) -> None:
        """Of a part: takes back all that was scheduled through it, and all that still will be."""
        self._dropped = True
        for event in self._own or ():
            event.cancelled = True
        self._own = []
        events = self._time.events
        events[:] = [entry for entry in events if not entry[2].cancelled]
        heapq.heapify(events)

    def next_due(self) -> int | None:
        """Time of the next event."""
        events = self._time.events
        while events and events[0][2].cancelled:
            heapq.heappop(events)
        return events[0][0] if events else None

    def advance(self, until: int) -> None:
        """Runs all that is due up to and including ``until``, each at its own time."""
        time = self._time
        events = time.events
        while events and events[0][0] <= until:
            due, _, event = heapq.heappop(events)
            if not event.cancelled:
                time.now = max(time.now, due)
                event.callback()
        if until > time.now:
            time.now = until

    def _remember(self, event: Event) -> None:
        assert self._own is not None
        self._own.append(event)
        if len(self._own) % _MANY_OWN_EVENTS == 0:
            now = self._time.now
            self._own = [own for own in self._own if not own.cancelled and own.due >= now]


def ticks_of_us(us: float) -> int:
    """Microseconds as ticks, to the nearest."""
    return round(us * TICKS_PER_US)
