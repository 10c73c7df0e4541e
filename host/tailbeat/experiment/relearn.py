"""Learns from an experiment's trials again, with the board's own code, one after the other."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tailbeat.board.snapshot import Snapshot
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.law import Averaging, Law, errors_of
from tailbeat.core.law_memory import LawMemory
from tailbeat.core.native import lib
from tailbeat.core.records import decode_learned
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.trial_rows import TrialRow

_BY_THE_BOARD = ("law", "restored", "first", "")  # what makes a trial's amplitudes; "" = not told
_NOT_HERE = "what the board had learned before is not in the folder"


@dataclass
class Relearned:
    """``learned``: trials after which the law gives the very amplitudes of the next.
    ``not_learned``: trials that were learned from, of which that cannot be told, and why."""

    learned: list[int] = field(default_factory=list)
    not_learned: list[tuple[int, str]] = field(default_factory=list)
    different: list[str] = field(default_factory=list)


def relearn(analysis: Analysis, held: Snapshot | None = None) -> Relearned:
    """Every trial that was learned from, against the amplitudes of the next; the last one against
    ``held``, the board's state as it was copied last. Older firmware judged no trial with missing
    beats: what does not come out by today's rule may by that one."""
    found = _relearned(analysis, held, judges_gaps=True)
    if not found.different:
        return found
    older = _relearned(analysis, held, judges_gaps=False)
    return older if len(older.different) < len(found.different) else found


def _relearned(analysis: Analysis, held: Snapshot | None, judges_gaps: bool) -> Relearned:
    found = Relearned()
    board = _Board(analysis.reference_m_s.astype(np.float32), analysis.beat_s, judges_gaps)
    pending: tuple[TrialRow, Trial] | None = None
    aside: _Board | None = None
    for row, trial in zip(analysis.rows, analysis.trials, strict=True):
        if trial.input in _BY_THE_BOARD:
            before = board.copy()
            if aside is not None and aside.same(trial.beats.amplitude_rad):
                board = aside
            board = _expected(board, pending, trial, found)
            aside = before if _only_repeats(row, trial, pending) else None
            pending = None
        elif pending is not None:
            found.not_learned.append((pending[1].number, "the next amplitudes were uploaded"))
            board, pending = next(board.after(pending[1], trial)), None
        if row.learned:
            if trial.input not in _BY_THE_BOARD:
                board.take_over(trial)
            pending = row, trial
    if pending is not None:
        _against_state(board, pending[1], held, found)
    return found


def _only_repeats(row: TrialRow, trial: Trial, pending: tuple[TrialRow, Trial] | None) -> bool:
    """Whether the best swam once more for its own sake, as after a battery swap: then what was to
    swim before may be put back."""
    return pending is None and trial.input == "restored" and row.decision == "repeat"


def _expected(
    board: _Board, pending: tuple[TrialRow, Trial] | None, trial: Trial, found: Relearned
) -> _Board:
    """The board as it was when ``trial`` swam; what it swam is compared."""
    if board.begins(trial):
        if pending is not None:
            found.not_learned.append((pending[1].number, "the board began anew after it"))
        pending = None
        board.first(trial)
    if pending is None:
        if trial.input == "restored" and board.whole:
            board.restore_best()
        if not board.same(trial.beats.amplitude_rad):
            if board.whole:
                found.different.append(
                    f"trial {trial.number} swam other amplitudes than were to swim next"
                )
            board.take_over(trial)
        return board
    number, rolled_back = pending[1].number, pending[0].rolled_back
    last: _Board | None = None
    for candidate in board.after(pending[1], trial):
        last = candidate
        if candidate.same(trial.beats.amplitude_rad) and candidate.rolled_back == rolled_back:
            found.learned.append(number)
            return candidate
    assert last is not None
    if last.refusal:
        found.not_learned.append((number, last.refusal))
    elif not board.whole:
        found.not_learned.append((number, _NOT_HERE))
    else:
        found.different.append(
            f"trial {trial.number} did not swim what the law makes of trial {number}"
        )
    last.take_over(trial)
    return last


def _against_state(board: _Board, trial: Trial, held: Snapshot | None, found: Relearned) -> None:
    """Of the last trial: what the board had learned when its state was copied."""
    why = "no trial swam after it"
    if held is not None and held.learned is not None and held.last_learned_trial == trial.number:
        record = decode_learned(held.learned)
        back = record.input == lib.MEMORY_INPUT_RESTORED
        following = replace(trial, input="restored") if back else trial
        candidates = list(board.after(trial, following))
        if record.input not in (lib.MEMORY_INPUT_LAW, lib.MEMORY_INPUT_RESTORED):
            why = "the next amplitudes were uploaded"
        elif any(one.same(record.amplitude_rad) for one in candidates):
            found.learned.append(trial.number)
            return
        elif candidates[-1].refusal or not board.whole:
            why = candidates[-1].refusal or _NOT_HERE
        else:
            found.different.append(
                f"board/state.json does not hold what the law makes of trial {trial.number}"
            )
            return
    found.not_learned.append((trial.number, why))


class _Board:
    """A board's memory and the trials it looks back on. ``whole``: all of it is known since the
    first trial."""

    def __init__(self, reference_m_s: F32, beat_s: float, judges_gaps: bool) -> None:
        self.reference_m_s, self.beat_s = reference_m_s, beat_s
        self.judges_gaps = judges_gaps
        self.beats = len(reference_m_s)
        self.memory = LawMemory(self.beats)
        self.begun = False
        self.whole = False
        self.past_doubted = False
        self.rolled_back = False
        self.refusal = ""

    def copy(self) -> _Board:
        other = _Board(self.reference_m_s, self.beat_s, self.judges_gaps)
        other.memory = self.memory.copy()
        other.begun, other.whole, other.past_doubted = self.begun, self.whole, self.past_doubted
        return other

    def begins(self, trial: Trial) -> bool:
        """Whether the board had learned nothing when ``trial`` swam."""
        return trial.iteration == 1 and trial.input in ("first", "")

    def first(self, trial: Trial) -> None:
        """The law applied to rest."""
        self.begun, self.past_doubted = True, False
        with contextlib.suppress(InputError):
            self.whole = False
            self.memory.first(Law.from_params(trial.params, self.beat_s), self.reference_m_s)
            self.whole = True

    def take_over(self, trial: Trial) -> None:
        """The amplitudes of a trial that the board got in another way; they have no past."""
        recorded = trial.beats.amplitude_rad
        known = np.isfinite(recorded)
        held = np.where(known, recorded, self.memory.amplitude_rad)
        self.memory.set_input(held, trial.iteration)
        self.begun = True
        self.whole = self.whole and bool(known.all())
        self.past_doubted = True

    def restore_best(self) -> None:
        """As asked for by the host; what it looks back on is the firmware's to say."""
        self.memory.restore_best()
        self.past_doubted = True

    def same(self, amplitude_rad: F32) -> bool:
        """Bit for bit, where the file tells (a trial that was cut short tells of its beats)."""
        if not self.begun or len(amplitude_rad) != self.beats:
            return False
        known = np.isfinite(amplitude_rad)
        mine = self.memory.amplitude_rad
        return mine[known].tobytes() == amplitude_rad[known].tobytes()

    def after(self, trial: Trial, following: Trial) -> Iterator[_Board]:
        """The board when it has learned from ``trial``, the likeliest first: parameters may have
        been set before or after learning, amplitudes that were brought back may have a past."""
        settings: list[Mapping[str, float]] = [trial.params]
        if following.params != trial.params:
            settings.append(following.params)
        for params in settings:
            for forget in (False, True) if self.past_doubted else (False,):
                board = self.copy()
                board._learn(trial, params, forget)
                yield board
                if following.input == "restored" and not board.rolled_back:
                    restored = board.copy()
                    restored.restore_best()
                    yield restored

    def _learn(self, trial: Trial, params: Mapping[str, float], forget: bool) -> None:
        if forget:
            self.memory.forget()
        error, measured = errors_of(self.reference_m_s, trial.beats.speed_m_s)
        if not measured.any():
            self.refusal = "its file has no speeds: they were uploaded after it was pulled"
            return
        complete = trial.end_fault == 0 and trial.executed_beats == self.beats
        complete = complete and (self.judges_gaps or bool(measured.all()))
        law = Law.from_params(params, self.beat_s)
        rollback_ratio = params.get("ROLLBACK_RATIO", 0.0)
        extrapolation = int(params.get("ILC_EXTRAP", 0))
        try:
            self.memory.average(Averaging.from_params(params))
            self.memory.learn(law, error, measured, complete, rollback_ratio, extrapolation)
        except InputError:
            self.refusal = "the law refuses it"
            return
        self.rolled_back = self.memory.rolled_back
