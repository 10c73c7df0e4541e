"""Who asks for a page waits for its turn: making one keeps the only thread of the server busy, and
between two of them ABORT gets through."""

from __future__ import annotations

import asyncio
from collections.abc import MutableMapping
from dataclasses import dataclass, field
from typing import Any

from tailbeat.ui.access import App, Receive, Scope, Send, answer

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
