"""The person at a terminal: sees what goes on, stops it with a key, decides."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tailbeat.cli.livewords import (
    LINK_NEWS,
    countdown_text,
    decided_text,
    learned_text,
    live_text,
    loud,
    step_text,
    swum_lines,
)
from tailbeat.day.person import Decision
from tailbeat.day.swums import proposed
from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.cli.display import Display
    from tailbeat.cli.keys import Keys
    from tailbeat.day.person import Event
    from tailbeat.day.swum import Swum

_LOOK_S = 0.2  # how long a question goes without a heartbeat to the board
_KINDS = {"k": "keep", "r": "repeat", "d": "discard"}
_ENTER = ("\r", "\n")
_ESCAPE = "\x1b"


class Undecided(TailbeatError):
    """There is nobody to say what becomes of a swim; it waits on the board."""


class TerminalPerson:
    """``keys`` None: nobody is there to press any. ``then``: the answer given beforehand; somebody
    who is there and stopped the swim is asked all the same, before it is learned from. ``idle`` is
    called again and again while a question waits."""

    def __init__(
        self,
        display: Display,
        keys: Keys | None,
        then: Decision | None = None,
        idle: Callable[[], None] = lambda: None,
    ) -> None:
        self._display, self._keys, self._then, self._idle = display, keys, then, idle

    def tell(self, event: Event) -> None:
        """Shows it."""
        kind, display = event["event"], self._display
        if kind == "step":
            line = step_text(event)
            display.show(line) if event["ok"] is None else display.keep(line)
        elif kind == "countdown":
            display.bell()
            display.show(countdown_text(event))
        elif kind == "live":
            display.show(live_text(event, keys=self._keys is not None))
        elif kind == "swum":
            for line in swum_lines(event):
                display.keep(line)
        elif kind == "decided":
            display.keep(decided_text(event))
        elif kind == "learned":
            display.keep(learned_text(event))
        elif kind == "verdict":
            display.keep(event["words"])
        elif kind in LINK_NEWS:
            display.keep(f"tailbeat: {LINK_NEWS[kind]}", loud=True)
        elif (words := loud(event)) is not None:
            display.keep(f"tailbeat: {words}", loud=True)

    def wants_abort(self) -> bool:
        """Any key."""
        return self._keys is not None and self._keys.pressed()

    def decide(self, swum: Swum) -> Decision:
        """The answer given beforehand, else by a key. Raises Undecided when nobody is there and
        the swim is not plainly good."""
        proposal = proposed(swum)
        learned_unseen = proposal.kind != "keep" and self._then == Decision("keep")
        if self._then is not None and not (self._keys is not None and learned_unseen):
            return self._then
        if self._keys is not None:
            return self._ask(self._keys, swum, proposal)
        if swum.outcome.end == "complete" and not swum.problems:
            return Decision("keep")
        raise Undecided(
            f"trial {swum.outcome.number} waits on the board: {'; '.join(swum.problems)}",
            "Say what becomes of it: tailbeat trial run --then keep|repeat|discard --reason WHY,"
            " or at a terminal.",
        )

    def confirm(self, question: str) -> bool:
        """With y; without a terminal the answer is no."""
        if self._keys is None:
            return False
        self._keys.forget()
        self._display.ask(f"{question} y/n ")
        key = self._key(self._keys, ("y", "n"))
        self._display.keep(key)
        return key == "y"

    def _ask(self, keys: Keys, swum: Swum, proposal: Decision) -> Decision:
        letters = tuple(k for k in _KINDS if k != "k" or swum.measured_beats > 0)
        words = ", ".join(f"{letter} = {_KINDS[letter]}" for letter in letters)
        keys.forget()  # the key that stopped the tail is no answer
        self._display.bell()
        self._display.ask(f"{words}, Enter = {proposal.kind}: ")
        key = self._key(keys, (*letters, *_ENTER))
        kind = proposal.kind if key in _ENTER else _KINDS[key]
        self._display.keep(kind)
        if kind == "keep":
            return Decision("keep")
        return Decision(kind, self._reason(keys, proposal.reason))  # type: ignore[arg-type]

    def _reason(self, keys: Keys, usual: str) -> str:
        while True:
            self._display.ask(f"why? [{usual}] " if usual else "why? ")
            if reason := keys.line() or usual:
                return reason

    def _key(self, keys: Keys, wanted: tuple[str, ...]) -> str:
        """One of ``wanted``, however long it takes; Escape puts the question off, as Ctrl-C."""
        while True:
            key = keys.key(_LOOK_S)
            if key == _ESCAPE:
                raise KeyboardInterrupt
            if key is not None and key in wanted:
                return key
            self._idle()
