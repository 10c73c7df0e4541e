"""Requests under way: which are to be said again, and when to give up."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.core.errors import LinkLostError
from tailbeat.link.mavlink import Link

_FIRST_S, _LEAST_S, _MOST_S = 0.5, 0.08, 2.0
_BACKOFF = 1.5
_STALLED_S = 25.0  # without anything new: some fifteen rounds
_DEAD_S = 12.0  # without a word from the board


class RoundTrip:
    """How long an answer takes on this link: mean and spread, as TCP keeps them."""

    def __init__(self) -> None:
        self._mean_s = -1.0
        self._spread_s = 0.0

    def heard(self, took_s: float, tries: int = 1) -> None:
        """An answer came so long after the last of so many ``tries``; which of them it answers is
        not known, so that more than one tells something only as long as nothing is known."""
        if self._mean_s < 0:
            self._mean_s, self._spread_s = took_s, took_s / 2
        if tries > 1:
            return
        self._spread_s += (abs(took_s - self._mean_s) - self._spread_s) / 4
        self._mean_s += (took_s - self._mean_s) / 8

    def patience_s(self, tries: int) -> float:
        """How long to wait for the answer to the last of so many ``tries``."""
        wait_s = self._mean_s + 4 * self._spread_s if self._mean_s >= 0 else _FIRST_S
        wait_s = max(wait_s, _LEAST_S)
        for _ in range(1, tries):
            wait_s = min(wait_s * _BACKOFF, max(wait_s, _MOST_S))
        return wait_s


@dataclass
class Asked:
    """A request that waits for its answer."""

    order: int
    sent_s: float
    due_s: float
    tries: int
    alone: bool  # nothing else on the line, so that its answer tells the round trip


class Window:
    """Requests under way, by file offset. The line keeps the order of what passes: an answer to a
    later request means that those before it are lost."""

    def __init__(self, link: Link, round_trip: RoundTrip) -> None:
        self._link = link
        self._round_trip = round_trip
        self._asked: dict[int, Asked] = {}
        self._order = 0

    def tries(self, offset: int) -> int:
        """How often that was asked."""
        return self._asked[offset].tries if offset in self._asked else 0

    def waits(self, offset: int) -> bool:
        """Whether its answer may still come."""
        asked = self._asked.get(offset)
        return asked is not None and self._link.transport.now_s() < asked.due_s

    def under_way(self) -> int:
        """How many answers may still come."""
        now_s = self._link.transport.now_s()
        return sum(now_s < asked.due_s for asked in self._asked.values())

    def next_due_s(self) -> float:
        """When the first answer is overdue; infinite without any."""
        now_s = self._link.transport.now_s()
        due = (asked.due_s for asked in self._asked.values() if asked.due_s > now_s)
        return min(due, default=float("inf"))

    def say(self, offset: int, least_s: float = 0.0) -> None:
        """It is being asked now; ``least_s``: the answer has other things before it."""
        now_s = self._link.transport.now_s()
        tries = self.tries(offset) + 1
        self._order += 1
        patience_s = self._link.patient(max(self._round_trip.patience_s(tries), least_s))
        self._asked[offset] = Asked(self._order, now_s, now_s + patience_s, tries, least_s == 0)

    def answered(self, offset: int) -> None:
        """Its answer has come."""
        asked = self._asked.pop(offset, None)
        if asked is None:
            return
        if asked.alone:
            took_s = self._link.transport.now_s() - asked.sent_s
            self._round_trip.heard(took_s, asked.tries)
        for earlier in self._asked.values():
            if earlier.order < asked.order:
                earlier.due_s = earlier.sent_s

    def forget(self) -> None:
        """None of them will be answered."""
        self._asked.clear()


class Stall:
    """Ends a transfer in which nothing new comes."""

    def __init__(self, link: Link, remedy: str) -> None:
        self._link = link
        self._remedy = remedy
        self._since_s = link.transport.now_s()

    def moved(self) -> None:
        """Something new has come."""
        self._since_s = self._link.transport.now_s()

    def check(self, what: str) -> None:
        """Raises LinkLostError, ``what`` being how far it came, when it has been too long."""
        link = self._link
        waited_s = link.transport.now_s() - self._since_s
        silent_s = min(waited_s, link.transport.now_s() - link.last_heard_s)
        if waited_s > link.patient(_STALLED_S) or silent_s > link.patient(_DEAD_S):
            raise LinkLostError(
                f"{what} and then nothing for {waited_s:.0f} s on {link.transport.name}",
                f"Check power, cable and radio, then {self._remedy}.",
            )
