"""What people ask for, on its way to the thread that swims: in order, but abort overtakes."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

from tailbeat.core.errors import InputError
from tailbeat.session.next_law import LawName
from tailbeat.session.options import Until
from tailbeat.session.outcome import Decision, DecisionKind

KINDS = (
    "swim", "decide", "answer", "upload", "note", "clear", "params", "set", "health",
    "report",
)  # fmt: skip
Commission = Literal["new", "anew", "never"]
"""Whether the fish is measured before the trials: an unknown one, any, none."""

_SINGLE = frozenset(KINDS) - {"note"}  # the first who asks is served, the second hears why not


@dataclass(frozen=True)
class Ask:
    """One wish. ``kind``: one of KINDS."""

    kind: str
    values: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, kind: str, values: dict[str, Any]) -> Ask:
        """Checked where it is asked, so that who asked hears of it. Raises InputError."""
        check = _CHECKS.get(kind, dict)
        return cls(kind, check(**values))


def _swim(
    until: str = "1",
    preflight: bool = True,
    law: LawName = "auto",
    commission: Commission = "never",
) -> dict[str, Any]:
    return {
        "until": Until.parse(str(until)),
        "preflight": bool(preflight),
        "law": law,
        "commission": commission,
    }


def number_of(text: object) -> float | None:
    """As somebody types it; None: it is no number."""
    try:
        number = float(str(text).strip().replace(",", "."))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _set(name: str, value: object) -> dict[str, Any]:
    if (number := number_of(value)) is None:
        raise InputError(f"'{value}' is no number.", "Write it like 0.55.")
    return {"name": name, "value": number}


def _answer(yes: bool, typed: object = "") -> dict[str, Any]:
    return {"yes": bool(yes), "typed": str(typed)}


def _decision(kind: DecisionKind, reason: str = "") -> dict[str, Any]:
    made = Decision(kind, str(reason).strip())
    return {"kind": made.kind, "reason": made.reason}


def _note(text: str) -> dict[str, Any]:
    if not (words := " ".join(str(text).split())):
        raise InputError("the note is empty.", "Write what you want to remember.")
    return {"text": words, "at": datetime.now()}


_CHECKS: dict[str, Callable[..., dict[str, Any]]] = {
    "swim": _swim, "decide": _decision, "answer": _answer, "note": _note, "set": _set,
}  # fmt: skip


class Asks:
    """Filled by any thread, emptied by one. It takes in only what the emptying thread has opened;
    the first of several who ask for the same thing gets it, whoever comes later hears why not."""

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
                why = _BUSY.get(ask.kind, _NOT_NOW)
                raise InputError(why, "Look at the page: it shows how things stand.")
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

    def open(self, *kinds: str) -> list[Ask]:
        """From now on these are taken in. What was asked before and not taken is dropped, but for
        notes; returns it."""
        with self._news:
            self._open = frozenset(kinds)
            dropped = [ask for ask in self._waiting if ask.kind != "note"]
            self._waiting = deque(ask for ask in self._waiting if ask.kind == "note")
        return dropped

    def take(self, *kinds: str) -> Ask | None:
        """The next one of ``kinds`` (none named: of any) that waits; None = none does."""
        with self._news:
            for ask in self._waiting:
                if not kinds or ask.kind in kinds:
                    self._waiting.remove(ask)
                    return ask
        return None

    def wait(self, patience_s: float, *kinds: str) -> None:
        """Until one of ``kinds`` waits, or the end; none named: any, or an abort. At most so
        long."""

        def there() -> bool:
            is_there = any(not kinds or ask.kind in kinds for ask in self._waiting)
            return is_there or self._closed or (self._abort and not kinds)

        with self._news:
            self._news.wait_for(there, patience_s)

    def wait_closed(self, patience_s: float) -> None:
        """Until the end, at most so long."""
        with self._news:
            self._news.wait_for(lambda: self._closed, patience_s)


_BUSY = {
    "decide": "there is nothing to decide: somebody has decided already",
    "answer": "there is nothing to answer: somebody has answered already",
    "swim": "a trial runs already, or none can start now",
}
_NOT_NOW = "this cannot be done now: the fish is busy, or not connected"
