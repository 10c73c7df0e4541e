"""What people ask for, on its way to the thread that swims: in order, but abort overtakes."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from tailbeat.errors import InputError

KINDS = ("swim", "decide", "answer", "upload", "set", "note", "clear", "fresh")
_SINGLE = frozenset(KINDS) - {"note"}  # the first who asks is served, the second hears why not


@dataclass(frozen=True)
class Ask:
    """One wish. ``kind``: one of KINDS."""

    kind: str
    values: dict[str, Any] = field(default_factory=dict)


class Asks:
    """Filled by any thread, emptied by one. It takes in only what the emptying thread has opened;
    the first of several who ask for the same thing gets it, whoever comes later is told."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._waiting: deque[Ask] = deque()
        self._open: frozenset[str] = frozenset()
        self._abort = False
        self._closed = False

    @property
    def abort(self) -> bool:
        """Whether somebody wants the tail to stop. Reading it needs no lock: asked often."""
        return self._abort

    @property
    def closed(self) -> bool:
        """Whether all is to end."""
        return self._closed

    def offer(self, ask: Ask) -> None:
        """Raises InputError for what is not wanted now."""
        if ask.kind not in KINDS:
            raise InputError(f"'{ask.kind}' is nothing to ask for.", f"Say {', '.join(KINDS)}.")
        with self._news:
            if ask.kind not in self._open or self._closed:
                raise InputError(_why_not(ask.kind), "Look at the page: it shows how things stand.")
            if ask.kind in _SINGLE:
                self._open &= {"note"}
            self._waiting.append(ask)
            self._news.notify_all()

    def want_abort(self) -> None:
        """Stop the tail."""
        with self._news:
            self._abort = True
            self._news.notify_all()

    def abort_done(self) -> None:
        """Nothing moves any more."""
        with self._news:
            self._abort = False

    def close(self) -> None:
        """Ends all waiting; nothing is taken in any more."""
        with self._news:
            self._closed = self._abort = True
            self._news.notify_all()

    def open(self, *kinds: str) -> None:
        """From now on these are taken in. What was asked before and not taken is forgotten, but for
        notes."""
        with self._news:
            self._open = frozenset(kinds)
            self._waiting = deque(a for a in self._waiting if a.kind == "note")

    def take(self, *kinds: str) -> Ask | None:
        """The next one of ``kinds`` (none named: of any) that waits; None = none does."""
        with self._news:
            for ask in self._waiting:
                if not kinds or ask.kind in kinds:
                    self._waiting.remove(ask)
                    return ask
        return None

    def wait(self, patience_s: float) -> None:
        """Until there may be something to take, an abort or the end; at most so long."""
        with self._news:
            if not (self._waiting or self._abort or self._closed):
                self._news.wait(patience_s)

    def wait_for(self, patience_s: float, *kinds: str) -> None:
        """Until one of ``kinds`` waits, or the end; at most so long."""

        def there() -> bool:
            return self._closed or any(ask.kind in kinds for ask in self._waiting)

        with self._news:
            self._news.wait_for(there, patience_s)

    def wait_closed(self, patience_s: float) -> None:
        """Until the end, at most so long."""
        with self._news:
            self._news.wait_for(lambda: self._closed, patience_s)


def _why_not(kind: str) -> str:
    if kind == "decide":
        return "there is nothing to decide: somebody has decided already"
    if kind == "answer":
        return "there is nothing to answer: somebody has answered already"
    if kind == "swim":
        return "it swims already, or cannot swim now"
    return "this cannot be done now: the fish is busy, or not connected"
