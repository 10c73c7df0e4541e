"""Trials of an experiment that the board executed without this computer: their logs are fetched,
and the event log says which law made their inputs.

A laptop that went away leaves a board that learns by its own law; another one, or a terminal, runs
the trials. What the board has learned from is kept, the rest is discarded.
"""

from __future__ import annotations

from itertools import pairwise

from tailbeat.board.fish import Fish
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.current import reference_crc
from tailbeat.experiment.library import DISCARDED, library_of
from tailbeat.session.collect import drop_peeked, peek_log, recover_trial
from tailbeat.session.events import InputChosen
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import Decision

_ELSEWHERE = "without this computer"
_LAWS = {"law": "p", "first": "p", "uploaded": "model", "restored": "best"}
_WORDS = {"p": "the P law on the board", "model": "an uploaded input", "best": "the best input"}


def fetch_missed(fish: Fish, log: SessionLog) -> str:
    """Into the experiment and the trial library, oldest first. What is to be said about them; empty
    = none were missed. Trials of another reference stay where they are. Raises InputError (disk
    full)."""
    numbers = _missed(fish, log)
    trials = [trial for number in numbers if (trial := _fetched(fish, log, number)) is not None]
    if not trials:
        return ""
    iterations = [*(trial.iteration for trial in trials), fish.status().iteration]
    for trial, (now, then) in zip(trials, pairwise(iterations), strict=True):
        _write_down(fish, log, trial, learned=then > now)
    laws = dict.fromkeys(_WORDS[_law_of(trial)] for trial in trials)
    first, last = trials[0].number, trials[-1].number
    which = f"trial {first} was" if first == last else f"trials {first} to {last} were"
    return f"{which} executed {_ELSEWHERE}; inputs by {' and '.join(laws)}. The logs are kept."


def _missed(fish: Fish, log: SessionLog) -> list[int]:
    """Of the board's trials since the last one that the event log knows; without the one that waits
    to be decided on, and the one that was begun here last."""
    status, known = fish.status(), log.last_executed()
    left = {status.pending_trial, log.open_trial()}
    after = range((known or status.next_trial) + 1, status.next_trial)
    wanted = {number for number in after if number not in left}
    return sorted(wanted & {one.number for one in fish.trials()}) if wanted else []


def _fetched(fish: Fish, log: SessionLog, number: int) -> Trial | None:
    """None: of another reference."""
    trial = peek_log(fish, log.experiment, number)
    if trial.reference_crc != reference_crc(log.experiment):
        drop_peeked(log.experiment, number)
        return None
    return trial


def _write_down(fish: Fish, log: SessionLog, trial: Trial, learned: bool) -> None:
    recorded = recover_trial(fish, log, trial.number)
    log.chosen(InputChosen(_law_of(trial), _ELSEWHERE), trial.number)
    kind, mark = ("keep", "") if learned else ("discard", DISCARDED)
    log.decided(recorded, Decision(kind, _ELSEWHERE))  # type: ignore[arg-type]
    book = library_of(fish)
    if book is not None:
        book.keep(recorded.file, mark)


def _law_of(trial: Trial) -> str:
    """Of its input; a log of older firmware does not say."""
    return _LAWS.get(trial.input, "p")
