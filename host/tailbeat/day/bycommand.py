"""Single commands (learn, trial discard) in the experiment the fish is in: what they decide and
what the board learns is written down as a series writes it, and in the same order."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from tailbeat.day.account import Account
from tailbeat.day.board import STOPPED
from tailbeat.day.logs import keep_log, outcome_of
from tailbeat.day.person import Decision
from tailbeat.day.swums import swum_of
from tailbeat.errors import Refused
from tailbeat.experiment.board import copy_state
from tailbeat.experiment.current import current, swims_for
from tailbeat.experiment.meant import require_meant_here
from tailbeat.experiment.redo import write_redo
from tailbeat.faults import WRONG_STATE, fault_info

if TYPE_CHECKING:
    from tailbeat.day.person import DecisionKind
    from tailbeat.day.swum import Swum
    from tailbeat.fish import Fish
    from tailbeat.results import LearnReport

_NO_REASON = "by command, no reason given"


@dataclass(frozen=True)
class Noted:
    """A decision that is in the experiment's journal. ``added``: by this command."""

    account: Account
    swum: Swum
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
            f"tailbeat clear, then again: tailbeat {command}",
        )
    return pending


def noted_decision(fish: Fish, number: int, kind: DecisionKind, reason: str = "") -> Noted | None:
    """Into the experiment the fish swims for, with the trial's log, before the board hears of it.
    None when it swims for none. Raises InputError (disk full)."""
    if (account := _account(fish)) is None:
        return None
    log = keep_log(fish, account.experiment, number)
    swum = swum_of(outcome_of(log.trial), log, None)
    account.swum(swum)
    before = account.decision_on(swum.file)
    if kind == "keep" and before is not None and before.kind == kind:
        return Noted(account, swum, added=False)  # as trial run --no-learn has it
    account.decided(swum, Decision(kind, reason or _NO_REASON))
    return Noted(account, swum, added=True)


@contextlib.contextmanager
def withdrawn_if_refused(noted: Noted | None) -> Iterator[None]:
    """Around what tells the board: a decision that it refuses is asked again."""
    try:
        yield
    except Refused as refused:
        if noted is not None and noted.added:
            noted.account.withdrawn(noted.swum, str(refused))
        raise


def learn_noted(fish: Fish, number: int | None, command: str) -> LearnReport:
    """The board learns from the pending trial, whose log and decision its experiment has before.
    When nothing waits, what the board has learned last and could not be written down then (disk
    full) is written down. Raises InputError (disk full; parameters that are not as they are meant
    to be), and Refused, of a stopped board before anything is written."""
    pending = pending_of(fish, number, command)
    if pending is not None:
        require_meant_here(fish)
    if pending is None and (owing := _owing(fish)) is not None:
        account, owed = owing
        if number in (None, owed):
            report = fish.learn(owed)  # said again it only tells what it learned
            _write_down(fish, account, report)
            return report
    noted = None if pending is None else noted_decision(fish, pending, "keep")
    with withdrawn_if_refused(noted):
        report = fish.learn(number)
    if noted is not None:
        noted.learned(fish, report)
    return report


def not_noted(fish: Fish) -> str:
    """What a person should know when the fish is in an experiment that its swims are not of; empty
    otherwise."""
    experiment = current(fish)
    if experiment is None or swims_for(fish) is not None:
        return ""
    return (
        f"not written into {experiment.name}, which is of another reference; a new one begins with"
        " the next guided trial run, or now: tailbeat experiment new"
    )


def restore_best_noted(fish: Fish) -> None:
    """The best amplitudes swim next; the experiment knows."""
    account = _account(fish)
    fish.restore_best()
    if account is None:
        return
    improved = [one for one in account.journal.entries("learned") if one.get("improved")]
    account.journal.add("restored", trial=improved[-1]["trial"] if improved else None)
    copy_state(fish, account.experiment)
    write_redo(account.experiment)


def state_noted(fish: Fish) -> None:
    """Other amplitudes swim next: the experiment's copy of the board's state follows."""
    if (account := _account(fish)) is not None:
        copy_state(fish, account.experiment)


def _account(fish: Fish) -> Account | None:
    experiment = swims_for(fish)
    return None if experiment is None else Account(experiment, experiment.journal)


def _owing(fish: Fish) -> tuple[Account, int] | None:
    """The trial that the board has learned from without the experiment's knowing it."""
    account, status = _account(fish), fish.status()
    if account is None or status.pending_trial is not None:
        return None
    owed = account.owed()
    return (account, owed) if owed is not None and owed == status.last_learned_trial else None


def _write_down(fish: Fish, account: Account, report: LearnReport) -> None:
    account.journal.add("learned", **asdict(report))
    copy_state(fish, account.experiment)
    write_redo(account.experiment)
