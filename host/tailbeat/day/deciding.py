"""What is decided on a swim, carried out: journal and logbook first, then the board."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from tailbeat.day.board import STOPPED, dangerous, settled, stop_words
from tailbeat.day.person import Decision
from tailbeat.errors import InputError, Refused, TailbeatError
from tailbeat.experiment.board import copy_state
from tailbeat.experiment.meant import require_meant
from tailbeat.logbook import DISCARDED, logbook_of
from tailbeat.verdict import rollback_words

if TYPE_CHECKING:
    from tailbeat.day.account import Account
    from tailbeat.day.person import Person
    from tailbeat.day.swum import Swum
    from tailbeat.fish import Fish
    from tailbeat.results import BoardStatus, LearnReport

_ROLLED_BACK = (
    f"{rollback_words()}. Look before it swims on: did the fish, the water or the battery change?"
    " If so, one repeat tells; if not, halve the gain"
)


@dataclass(frozen=True)
class Done:
    """What became of a decision. ``learned``: nothing was to be learned, or it was learned before,
    when None. ``left``: the board stopped by a rule of its own and was left so, in words."""

    learned: LearnReport | None = None
    left: str = ""


@dataclass(frozen=True)
class Office:
    """Decides with the person and carries it out."""

    fish: Fish
    person: Person
    account: Account
    learn: bool

    def decide(self, swum: Swum) -> Decision:
        """As it was decided before, else as the person says; journalled when this returns. Raises
        InputError for what cannot be."""
        decision = self.account.decision_on(swum.file)
        if decision is None:
            decision = self._of_itself(swum) or self.person.decide(swum)
            self._require_possible(swum, decision)
            self.account.decided(swum, decision)
        told = {"trial": swum.outcome.number, "decision": decision.kind, "reason": decision.reason}
        self.person.tell({"event": "decided", **told})
        return decision

    def carry_out(self, swum: Swum, decision: Decision) -> Done:
        """The board learns from the trial or drops it. Clears what stopped it, unless that was a
        rule of the board's own. Raises Refused; then it is asked again; InputError when the board
        would learn with parameters nobody meant."""
        self._file(swum, decision)
        status = self.fish.status()
        number = swum.outcome.number
        if swum.measured_beats and number not in (status.pending_trial, status.last_learned_trial):
            status = settled(self.fish, number)
        if status.state in STOPPED:
            if dangerous(status.fault):
                return Done(left=stop_words(status))
            self.fish.clear()
            status = self.fish.status()
        if decision.kind == "keep":  # somebody may have swapped the battery while it was asked
            require_meant(self.fish, self.account.experiment)
        try:
            learned = self._on_board(swum, decision, status)
        except Refused as refused:
            self.account.withdrawn(swum, str(refused))
            raise
        self._require_done(swum, decision)
        copy_state(self.fish, self.account.experiment)
        return Done(learned)

    def write_down(self, report: LearnReport) -> None:
        """What the board has learned: journalled and told."""
        self.account.journal.add("learned", **asdict(report))
        self.person.tell({"event": "learned", **asdict(report)})
        if report.rolled_back:
            self.person.tell({"event": "notice", "text": _ROLLED_BACK})

    def _of_itself(self, swum: Swum) -> Decision | None:
        """Of a swim without a speed that the board does not hold: nobody can bring it any."""
        number, end = swum.outcome.number, swum.outcome.end
        if swum.measured_beats or self.fish.status().pending_trial == number:
            return None
        text = f"trial {number} ({end}) has no speeds: discarded, it counts for nothing"
        self.person.tell({"event": "notice", "text": text})
        return Decision("discard", f"{end}, no speeds")

    def _require_possible(self, swum: Swum, decision: Decision) -> None:
        number = swum.outcome.number
        if decision.kind == "keep" and swum.measured_beats == 0:
            raise InputError(
                f"trial {number} has no speeds, so nothing can be learned from it; it waits",
                f"Upload them (tailbeat speed upload --trial {number}), or discard it:"
                " tailbeat trial discard --reason WHY",
            )

    def _require_done(self, swum: Swum, decision: Decision) -> None:
        """Another program may have answered while this one asked. Raises TailbeatError."""
        number, status = swum.outcome.number, self.fish.status()
        waits = status.pending_trial == number
        learned = status.last_learned_trial == number
        if decision.kind != "keep" and learned:
            what, remedy = (
                "has learned from it",
                "To swim the best so far next: tailbeat learn --restore-best",
            )
        elif decision.kind == "keep" and swum.measured_beats and not (learned or waits):
            what, remedy = "does not hold it any more and has not learned from it", "Swim it again"
        else:
            return
        self.account.withdrawn(swum, f"the board {what}")
        raise TailbeatError(
            f"trial {number} was decided on ({decision.kind}), but the board {what}: another "
            "program was quicker; the decision is withdrawn",
            f"{remedy}. See that only one program swims this fish.",
        )

    def _file(self, swum: Swum, decision: Decision) -> None:
        """Into the fish's logbook; one that cannot take it is no reason to stop."""
        try:
            if (book := logbook_of(self.fish)) is not None:
                book.keep(swum.file, DISCARDED if decision.kind == "discard" else "")
        except TailbeatError as error:
            self.person.tell({"event": "notice", "text": f"not kept in the logbook: {error}"})

    def _on_board(self, swum: Swum, decision: Decision, status: BoardStatus) -> LearnReport | None:
        number = swum.outcome.number
        if status.pending_trial != number:
            return None  # cut before a beat was swum, or carried out before
        if decision.kind != "keep":
            self.fish.discard(number)
            return None
        if not self.learn:
            return None
        report = self.fish.learn(number)
        self.write_down(report)
        return report
