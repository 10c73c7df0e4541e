"""What is decided on a trial, carried out: event log and trial library first, then the board.

Single commands (learn, trial discard) log in the same order as a series does.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused, TailbeatError
from tailbeat.core.faults import WRONG_STATE, fault_info
from tailbeat.experiment.current import (
    current,
    experiment_for,
    require_expected,
    require_expected_here,
)
from tailbeat.experiment.folder import copy_state
from tailbeat.experiment.library import DISCARDED, library_of
from tailbeat.experiment.redo import write_redo
from tailbeat.learning.assessment import rollback_words
from tailbeat.link.messages import BoardStatus, LearnReport
from tailbeat.session.collect import STOPPED, dangerous, recover_trial, settled, stop_words
from tailbeat.session.events import Notice, Operator, TrialDecided
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import Decision, DecisionKind, RecordedTrial

_NO_REASON = "by command, no reason given"


@dataclass(frozen=True)
class LoggedDecision:
    """A decision that is in the experiment's journal. ``added``: by this command."""

    account: SessionLog
    recorded: RecordedTrial
    added: bool

    def learned(self, fish: Fish, report: LearnReport) -> None:
        """What the board says it has learned, and its state. Raises InputError (disk full)."""
        _write_down(fish, self.account, report)


def pending_of(fish: Fish, number: int | None, command: str) -> int | None:
    """The trial that waits, if it is the one that is meant. Raises Refused when the board is
    stopped: it would turn ``command`` down."""
    status = fish.status()
    pending = status.pending_trial
    if pending is None or number not in (None, pending):
        return None
    if status.state in STOPPED:
        fault, refused = status.fault, fault_info(WRONG_STATE)
        raise Refused(
            refused.number,
            refused.name,
            f"the board is stopped ({fault.name}: {fault.meaning})",
            f"tailbeat board clear, then again: tailbeat {command}",
        )
    return pending


def log_decision(
    fish: Fish, number: int, kind: DecisionKind, reason: str = ""
) -> LoggedDecision | None:
    """Into the experiment the fish swims for, with the trial's log, before the board hears of it.
    None when it swims for none. Raises InputError (disk full)."""
    if (account := _account(fish)) is None:
        return None
    recorded = recover_trial(fish, account, number)
    before = account.decision_on(recorded.file)
    if kind == "keep" and before is not None and before.kind == kind:
        return LoggedDecision(account, recorded, added=False)  # as trial run --no-learn has it
    account.decided(recorded, Decision(kind, reason or _NO_REASON))
    return LoggedDecision(account, recorded, added=True)


@contextlib.contextmanager
def withdrawn_if_refused(noted: LoggedDecision | None) -> Iterator[None]:
    """Around what tells the board: a decision that it refuses is asked again."""
    try:
        yield
    except Refused as refused:
        if noted is not None and noted.added:
            noted.account.withdrawn(noted.recorded, str(refused))
        raise


def learn_and_log(fish: Fish, number: int | None, command: str) -> LearnReport:
    """The board learns from the pending trial, whose log and decision its experiment has before.
    When nothing waits, what the board has learned last and could not be written down then (disk
    full) is written down. Raises InputError (disk full; parameters that are not as they are meant
    to be), and Refused, of a stopped board before anything is written."""
    pending = pending_of(fish, number, command)
    if pending is not None:
        require_expected_here(fish)
    if pending is None and (owing := _owing(fish)) is not None:
        account, owed = owing
        if number in (None, owed):
            report = fish.learn(owed)  # said again it only tells what it learned
            _write_down(fish, account, report)
            return report
    noted = None if pending is None else log_decision(fish, pending, "keep")
    with withdrawn_if_refused(noted):
        report = fish.learn(number)
    if noted is not None:
        noted.learned(fish, report)
    return report


def not_logged_text(fish: Fish) -> str:
    """What an operator should know when the fish is in an experiment that its trials are not of;
    empty otherwise."""
    experiment = current(fish)
    if experiment is None or experiment_for(fish) is not None:
        return ""
    return (
        f"not written into {experiment.name}, which is of another reference. A new one begins with"
        " the next guided trial, or now: tailbeat experiment new"
    )


def restore_best_and_log(fish: Fish) -> None:
    """The best amplitudes swim next; the experiment knows."""
    account = _account(fish)
    fish.restore_best()
    if account is None:
        return
    improved = [one for one in account.journal.entries("learned") if one.get("improved")]
    account.journal.add("restored", trial=improved[-1]["trial"] if improved else None)
    copy_state(fish, account.experiment)
    write_redo(account.experiment)


def log_state(fish: Fish) -> None:
    """Other amplitudes swim next: the experiment's copy of the board's state follows."""
    if (account := _account(fish)) is not None:
        copy_state(fish, account.experiment)


def _account(fish: Fish) -> SessionLog | None:
    experiment = experiment_for(fish)
    return None if experiment is None else SessionLog(experiment)


def _owing(fish: Fish) -> tuple[SessionLog, int] | None:
    """The trial that the board has learned from without the experiment's knowing it."""
    account, status = _account(fish), fish.status()
    if account is None or status.pending_trial is not None:
        return None
    owed = account.owed()
    return (account, owed) if owed is not None and owed == status.last_learned_trial else None


def _write_down(fish: Fish, account: SessionLog, report: LearnReport) -> None:
    account.journal.add("learned", **asdict(report))
    copy_state(fish, account.experiment)
    write_redo(account.experiment)


_ROLLED_BACK = (
    f"{rollback_words()}. Look before it swims on: did the fish, the water or the battery change?"
    " If so, one repeat tells; if not, halve the gain"
)


@dataclass(frozen=True)
class DecisionResult:
    """What became of a decision. ``learned``: nothing was to be learned, or it was learned before,
    when None. ``left``: the board stopped by a rule of its own and was left so, in words."""

    learned: LearnReport | None = None
    left: str = ""


@dataclass(frozen=True)
class Decisions:
    """Decides with the operator and carries it out."""

    fish: Fish
    operator: Operator
    account: SessionLog
    learn: bool

    def decide(self, recorded: RecordedTrial) -> Decision:
        """As it was decided before, else as the operator says; logged when this returns. Raises
        InputError for what cannot be."""
        decision = self.account.decision_on(recorded.file)
        if decision is None:
            decision = self._of_itself(recorded) or self.operator.decide(recorded)
            self._require_possible(recorded, decision)
            self.account.decided(recorded, decision)
        self.operator.tell(TrialDecided(recorded.outcome.number, decision))
        return decision

    def carry_out(self, recorded: RecordedTrial, decision: Decision) -> DecisionResult:
        """The board learns from the trial or drops it. Clears what stopped it, unless that was a
        rule of the board's own. Raises Refused; then it is asked again; InputError when the board
        would learn with parameters nobody meant."""
        self._file(recorded, decision)
        status = self.fish.status()
        number = recorded.outcome.number
        if recorded.measured_beats and number not in (
            status.pending_trial,
            status.last_learned_trial,
        ):
            status = settled(self.fish, number)
        if status.state in STOPPED:
            if dangerous(status.fault):
                return DecisionResult(left=stop_words(status))
            self.fish.clear()
            status = self.fish.status()
        if decision.kind == "keep":  # somebody may have swapped the battery while it was asked
            require_expected(self.fish, self.account.experiment)
        try:
            learned = self._on_board(recorded, decision, status)
        except Refused as refused:
            self._withdraw(recorded, str(refused))
            raise
        self._require_done(recorded, decision)
        copy_state(self.fish, self.account.experiment)
        return DecisionResult(learned)

    def write_down(self, report: LearnReport) -> None:
        """What the board has learned: logged and told."""
        self.account.journal.add("learned", **asdict(report))
        self.operator.tell(report)
        if report.rolled_back:
            self.operator.tell(Notice(_ROLLED_BACK))

    def _of_itself(self, recorded: RecordedTrial) -> Decision | None:
        """Of a trial without a speed that the board does not hold: nobody can bring it any."""
        number, end = recorded.outcome.number, recorded.outcome.end
        if recorded.measured_beats or self.fish.status().pending_trial == number:
            return None
        text = f"trial {number} ({end}) has no speeds: discarded, it counts for nothing"
        self.operator.tell(Notice(text))
        return Decision("discard", f"{end}, no speeds")

    def _require_possible(self, recorded: RecordedTrial, decision: Decision) -> None:
        number = recorded.outcome.number
        if decision.kind == "keep" and recorded.measured_beats == 0:
            raise InputError(
                f"trial {number} has no speeds, so nothing can be learned from it; it waits",
                f"Upload them (tailbeat trial speeds {number} FILE), or discard it:"
                " tailbeat trial discard --reason WHY",
            )

    def _require_done(self, recorded: RecordedTrial, decision: Decision) -> None:
        """Another program may have answered while this one asked. Raises TailbeatError."""
        number, status = recorded.outcome.number, self.fish.status()
        waits = status.pending_trial == number
        learned = status.last_learned_trial == number
        if decision.kind != "keep" and learned:
            what, remedy = (
                "has learned from it",
                "To use the best input next: tailbeat trial learn --restore-best",
            )
        elif decision.kind == "keep" and recorded.measured_beats and not (learned or waits):
            what, remedy = (
                "does not hold it any more and has not learned from it",
                "Run the trial again",
            )
        else:
            return
        self._withdraw(recorded, f"the board {what}")
        raise TailbeatError(
            f"trial {number} was decided on ({decision.kind}), but the board {what}: another "
            "program was quicker; the decision is withdrawn",
            f"{remedy}. Make sure that only one program controls this fish.",
        )

    def _withdraw(self, recorded: RecordedTrial, why: str) -> None:
        """What was decided; the trial counts in the trial library until it is decided on again."""
        self.account.withdrawn(recorded, why)
        self._file(recorded, None)

    def _file(self, recorded: RecordedTrial, decision: Decision | None) -> None:
        """Into the fish's trial library; one that cannot take it is no reason to stop. None: the
        decision is withdrawn."""
        dropped = decision is not None and decision.kind == "discard"
        try:
            if (book := library_of(self.fish)) is not None:
                copy = book.keep(recorded.file, DISCARDED if dropped else "")
                if decision is None:
                    book.unmark(copy, DISCARDED)
        except TailbeatError as error:
            self.operator.tell(Notice(f"not kept in the trial library: {error}"))

    def _on_board(
        self, recorded: RecordedTrial, decision: Decision, status: BoardStatus
    ) -> LearnReport | None:
        number = recorded.outcome.number
        if status.pending_trial != number:
            return None  # cut before a beat was executed, or carried out before
        if decision.kind != "keep":
            self.fish.discard(number)
            return None
        if not self.learn:
            return None
        report = self.fish.learn(number)
        self.write_down(report)
        return report
