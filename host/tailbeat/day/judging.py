"""The verdict on a series: by the trials of its experiment that count."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError
from tailbeat.logbook import logbook_of

if TYPE_CHECKING:
    from tailbeat.day.account import Account
    from tailbeat.day.person import Person
    from tailbeat.day.swimming import Around
    from tailbeat.fish import Fish
    from tailbeat.model.identified import Identified
    from tailbeat.verdict import Verdict


def judged(account: Account, around: Around, rolled_back: bool) -> Verdict | None:
    """On the last trial; None, with a notice, when it cannot be given: the board has learned all
    the same."""
    from tailbeat.progress import progress_of

    try:
        trials = account.counting()
        return progress_of(trials, None, _identified(around.fish), (), rolled_back).verdict
    except TailbeatError as error:
        around.person.tell({"event": "notice", "text": f"no verdict: {error}"})
        return None


def told(person: Person, verdict: Verdict | None) -> None:
    """Tells it."""
    if verdict is None:
        return
    values = ("words", "stop", "stop_reason", "advice")
    saturated = "" if verdict.saturation is None else verdict.saturation.text
    event = {name: getattr(verdict, name) for name in values}
    person.tell({"event": "verdict", **event, "saturation": saturated})


def _identified(fish: Fish) -> Identified | None:
    book = logbook_of(fish)
    return None if book is None else book.identified()
