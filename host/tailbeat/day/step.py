"""One step of the ritual while it is waited for: tells how it stands, and when it is given up."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tailbeat.day.wanted import GivenUp, NotReady

if TYPE_CHECKING:
    from tailbeat.day.person import Person
    from tailbeat.fish import Fish

_LOOK_S = 0.1  # of board time; so often the person is asked
_TELL_S = 0.5  # words that change all the time are told so often
_SILENT_S = 5.0  # of board time without a word from the board, after which it is asked


class Step:
    """``name`` as in person.Event; times in s of board time, from when it was made."""

    def __init__(self, fish: Fish, person: Person, name: str, patience_s: float = math.inf) -> None:
        self.fish = fish
        self._person, self._name, self._patience_s = person, name, patience_s
        self._begin_s = fish.transport.now_s()
        self._told: tuple[str, bool | None, int | None] | None = None
        self._told_at_s = -math.inf

    @property
    def elapsed_s(self) -> float:
        """How long it has taken."""
        return (self.fish.transport.now_s() - self._begin_s) * self.fish.clock.rate

    @property
    def is_late(self) -> bool:
        """Whether the patience is used up."""
        return self.elapsed_s > self._patience_s

    def tell(self, text: str, ok: bool | None = None, left_s: float | None = None) -> None:
        """How it stands, unless that has just been said."""
        whole_s = None if left_s is None else math.ceil(max(left_s, 0.0))
        now = (text, ok, whole_s)
        same_second = self._told is not None and now[1:] == self._told[1:]
        if now == self._told or (same_second and self.elapsed_s - self._told_at_s < _TELL_S):
            return
        self._told, self._told_at_s = now, self.elapsed_s
        self._person.tell(
            {"event": "step", "step": self._name, "text": text, "ok": ok, "left_s": whole_s}
        )

    def notice(self, text: str) -> None:
        """Something to know that stops nothing."""
        self._person.tell({"event": "notice", "text": text})

    def refuse(self, what: str, remedy: str) -> NotReady:
        """The error to raise, told."""
        self._told = None
        self.tell(what, ok=False)
        return NotReady(what, remedy)

    def wait(self) -> None:
        """A moment. Raises GivenUp when the person wants no more, LinkLostError when the board has
        gone."""
        fish = self.fish
        if self._person.wants_abort():
            self.tell("given up", ok=False)
            raise GivenUp(
                f"given up at the step '{self._name}'", "Nothing has swum. Begin again when ready."
            )
        fish.link.run(_LOOK_S / max(fish.clock.rate, 1.0))
        fish.clock.keep()
        silent_s = (fish.transport.now_s() - fish.link.last_heard_s) * fish.clock.rate
        if silent_s > _SILENT_S:
            fish.status()
