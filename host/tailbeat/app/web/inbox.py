"""What people ask for, on its way to the thread that swims: in order, but abort overtakes.

Who asks for a page waits for its turn: making one keeps the only thread of the server busy, and
between two of them ABORT gets through.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import MutableMapping
from dataclasses import dataclass, field
from typing import Any

from tailbeat.app.web.access import App, Receive, Scope, Send, answer
from tailbeat.core.errors import InputError

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


WAITING_MAX = 12  # pages of 0.1 to 0.3 s each: longer than that nobody waits for one
_AGAIN_S = 3
_PASSES = 8  # of the event loop: a connection is taken, read and answered in five
_LIGHT = ("/_nicegui", "/raw/", "/beats/")  # files, read by other threads
_LATER = (
    f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="{_AGAIN_S}">'
    '<meta name="viewport" content="width=device-width"><title>tailbeat</title>'
    "<p>tailbeat: many ask for the page at once; it is asked for again in a moment."
)


@dataclass
class Turns:
    """Before ``app`` (ASGI): one page at a time, and at most WAITING_MAX that wait. More get a 503,
    with which their browser comes again by itself."""

    app: App
    _turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    _waiting: int = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or str(scope["path"]).startswith(_LIGHT):
            await self.app(scope, receive, send)
        elif self._waiting >= WAITING_MAX:
            again = [(b"retry-after", str(_AGAIN_S).encode())]
            await answer(send, 503, _LATER, "text/html", again, scope["method"] == "HEAD")
        else:
            await self._in_turn(scope, receive, send)

    async def _in_turn(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._waiting += 1
        try:
            await self._turn.acquire()
        finally:
            self._waiting -= 1
        is_made = False

        async def sent(message: MutableMapping[str, Any]) -> None:
            nonlocal is_made
            if not is_made:  # who takes it in slowly holds up nobody
                is_made = True
                self._turn.release()
            await send(message)

        try:
            for _ in range(_PASSES):
                await asyncio.sleep(0)
            await self.app(scope, receive, sent)
        finally:
            if not is_made:
                self._turn.release()
