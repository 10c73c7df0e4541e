"""Virtual time that native models and Python share."""

from __future__ import annotations

import ctypes
import heapq
from collections.abc import Callable
from typing import Any

from vboard.core.bus import BusViolation
from vboard.core.clock import Clock, Event
from vboard.core.exceptions import Lockup
from vboard.native.library import (
    LOCKUP,
    NEVER,
    OK,
    PYTHON,
    VIOLATION,
    Call,
    ClockFields,
    handle_of,
    library,
)


class SharedTime:
    """A vb_clock_t, Python's events, and what failed.

    ``events``: a heap of (due, number, event), the first of which is not cancelled.
    """

    def __init__(self) -> None:
        self.memory = ctypes.create_string_buffer(library.vb_clock_bytes())
        self.fields = ClockFields.from_buffer(self.memory)
        self.handle = handle_of(self.memory)
        self.events: list[tuple[int, int, Event]] = []
        self._error: BaseException | None = None
        self._run_first = Call(self._run)
        library.vb_clock_init(self.handle, self._run_first)

    def show_first(self) -> None:
        """Tells the native clock which of Python's events is the next."""
        events = self.events
        while events and events[0][2].cancelled:
            heapq.heappop(events)
        self.fields.foreign_due = events[0][0] if events else NEVER
        self.fields.foreign_number = events[0][1] if events else 0

    def fail(self, error: BaseException) -> None:
        """Keeps the first exception out of a callback until check()."""
        if self.fields.failure == OK:
            self._error = error
            self.fields.failure = PYTHON

    def check(self) -> None:
        """Raises what failed since the last time."""
        failure = self.fields.failure
        if failure == OK:
            return
        self.fields.failure = OK
        message = self.fields.message.decode()
        if failure == VIOLATION:
            raise BusViolation(message)
        if failure == LOCKUP:
            raise Lockup(message)
        error, self._error = self._error, None
        assert error is not None
        raise error

    def guard(self, function: Callable[..., Any], otherwise: Any = None) -> Callable[..., Any]:
        """``function`` for C: what it raises comes out of check(), and it gives ``otherwise``."""

        def guarded(*arguments: Any) -> Any:
            self.fields.steady_at = 0
            try:
                return function(*arguments)
            except BaseException as error:
                self.fail(error)
                return otherwise

        return guarded

    def _run(self) -> None:
        self.fields.steady_at = 0
        try:
            _, _, event = heapq.heappop(self.events)
            self.show_first()
            event.callback()
        except BaseException as error:
            self.fail(error)


class NativeClock(Clock):
    """The clock of a board with native models."""

    def __init__(self) -> None:
        super().__init__()
        self.shared = SharedTime()

    def part(self) -> NativeClock:
        """The same time; but what is scheduled through it can be dropped all at once."""
        part = NativeClock.__new__(NativeClock)
        Clock.__init__(part)
        part.shared = self.shared
        part._own = []
        return part

    @property
    def now(self) -> int:
        """Ticks since the board came to be."""
        return int(self.shared.fields.now)

    def at(self, due: int, callback: Callable[[], None]) -> Event:
        """Calls ``callback`` once when time reaches ``due`` (not before now)."""
        shared = self.shared
        fields = shared.fields
        number = fields.number = fields.number + 1
        event = Event(max(due, fields.now), callback, self._dropped)
        heapq.heappush(shared.events, (event.due, number, event))
        if shared.events[0][2] is event:
            shared.show_first()
        if self._own is not None:
            self._remember(event)
        return event

    def after(self, ticks: int, callback: Callable[[], None]) -> Event:
        """Calls ``callback`` once, ``ticks`` from now."""
        return self.at(self.shared.fields.now + ticks, callback)

    def cancel(self, event: Event | None) -> None:
        """Takes an event back; None and past events are ignored."""
        if event is None:
            return
        event.cancelled = True
        events = self.shared.events
        if events and events[0][2] is event:
            self.shared.show_first()

    def drop(self) -> None:
        """Of a part: takes back all that was scheduled through it, and all that still will be."""
        self._dropped = True
        for event in self._own or ():
            event.cancelled = True
        self._own = []
        events = self.shared.events
        events[:] = [entry for entry in events if not entry[2].cancelled]
        heapq.heapify(events)
        self.shared.show_first()

    def next_due(self) -> int | None:
        """Time of the next event."""
        due = int(library.vb_clock_next_due(self.shared.handle))
        return None if due == NEVER else due

    def advance(self, until: int) -> None:
        """Runs all that is due up to and including ``until``, each at its own time."""
        library.vb_clock_advance(self.shared.handle, until)
        self.shared.check()
