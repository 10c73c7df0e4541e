"""Whoever is at the tank: a terminal, a page in a browser, a script."""

from __future__ import annotations

from typing import Protocol

from tailbeat.session.events import Event
from tailbeat.session.outcome import Decision, RecordedTrial


class Operator(Protocol):
    """All methods are called in the thread that swims, none is called in another."""

    def tell(self, event: Event) -> None:
        """Something happened. Must return at once."""

    def wants_abort(self) -> bool:
        """Whether the tail is to stop, or the waiting before the start to end; asked some ten times
        a second. Stays true until the swim or the waiting has ended."""

    def decide(self, recorded: RecordedTrial) -> Decision:
        """What becomes of it; may take as long as it likes, the tail is still."""

    def confirm(self, question: str) -> bool:
        """A question with yes or no; as above."""
