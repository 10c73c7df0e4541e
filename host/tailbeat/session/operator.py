"""Whoever is at the tank: a terminal, a page in a browser, a script."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

from tailbeat.core.errors import InputError
from tailbeat.session.events import Event

if TYPE_CHECKING:
    from tailbeat.session.collect import RecordedTrial

DecisionKind = Literal["keep", "repeat", "discard"]
KINDS: tuple[DecisionKind, ...] = ("keep", "repeat", "discard")


@dataclass(frozen=True)
class Decision:
    """What becomes of a swim. ``keep``: it is learned from. ``repeat``: its log counts as a repeat,
    nothing is learned, the same amplitudes swim again. ``discard``: it counts for nothing, the same
    amplitudes swim again. ``reason``: needed unless it is kept."""

    kind: DecisionKind
    reason: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"'{self.kind}' is no decision.", f"Say {', '.join(KINDS)}.")
        if self.kind != "keep" and not self.reason.strip():
            raise InputError(
                f"a swim to {self.kind} needs a reason.", "Say it in a few words: bumped the wall."
            )


class Operator(Protocol):
    """All methods are called in the thread that swims, none is called in another."""

    def tell(self, event: Event) -> None:
        """Something happened. Must return at once."""

    def wants_abort(self) -> bool:
        """Whether the tail is to stop, or the waiting before the start to end; asked some ten times
        a second. Stays true until the swim or the waiting has ended."""

    def decide(self, swum: RecordedTrial) -> Decision:
        """What becomes of it; may take as long as it likes, the tail is still."""

    def confirm(self, question: str) -> bool:
        """A question with yes or no; as above."""
