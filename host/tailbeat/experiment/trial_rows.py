"""The trials of an experiment as rows of its table: errors, decisions, contraction, noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from tailbeat.core.trial_checks import HeadingDrift, heading_drift, on_common_beats
from tailbeat.core.trial_file import Trial
from tailbeat.learning.assessment import scores_of
from tailbeat.learning.convergence import Score, comparable, score_of, student_t
from tailbeat.learning.saturation import at_limit

DISCARD = "discard"
_RATIO_MIN = 0.05  # where a band of noise ends below: an error is no less than nothing
_BY_THE_LAW = ("law", "")  # "" = unknown: a log of an older board


@dataclass(frozen=True)
class TrialRow:
    """One trial. ``iteration``: of its amplitudes; a repeat of older ones has theirs. ``decision``:
    keep, repeat, discard, or empty when nobody decided. ``repeat_of``: the first trial of its epoch
    that counts with the same amplitudes, 0 = this is the first. ``contraction``: what a step of the
    law did, max|e| of a kept trial over that of the last kept trial of the iteration before; NaN =
    its amplitudes are not the law's (first, uploaded, restored), or one of the two is not complete;
    on the beats that both measured.
    ``noise_low``, ``noise_high``: ratios between which 95 % lie when nothing but noise differs, NaN
    = there is no contraction or there are no repeats. ``complete``: it is judged
    (``Score.judged``); in a folder of a tool from before that rule every beat is measured.
    ``learned``, ``rolled_back``: what the board did with it; where the journal does not tell, by
    what swam next. Voltages: before the tail loaded the battery, as the journal has it, else the
    first in the log; and the last in the log; NaN = none. ``file``: its name in ``raw/``.
    ``undecided``: nobody decided, nothing was learned from it, and the journal tells of trials (in
    a folder without a journal all count as kept). ``epoch``: 0, and one more each time the board
    began anew and counted iterations from the beginning again."""

    trial: int
    iteration: int
    end: str
    decision: str
    reason: str
    repeat_of: int
    max_abs_error_m_s: float
    rms_error_m_s: float
    measured_beats: int
    saturated_beats: int
    distance_m: float
    contraction: float
    learned: bool
    rolled_back: bool
    straight: HeadingDrift | None
    battery_start_v: float
    battery_end_v: float
    input: str
    file: str
    time: str
    complete: bool = False
    undecided: bool = False
    epoch: int = 0
    noise_low: float = math.nan
    noise_high: float = math.nan

    @property
    def counts(self) -> bool:
        """Whether it may be used for any statistic."""
        return self.decision != DISCARD and not self.undecided

    @property
    def kept(self) -> bool:
        """Decided so, or learned from; in a folder without a journal all are."""
        return self.counts and (self.decision in ("keep", "") or self.learned)


def rows_of(
    kept: Sequence[tuple[Path, Trial]], histories: Mapping[str, TrialHistory], judges_gaps: bool
) -> list[TrialRow]:
    """A row for each trial, in order. ``judges_gaps``: trials with missing beats are judged."""
    rows: list[TrialRow] = []
    scores = [_judged(s, judges_gaps) for s in scores_of([trial for _, trial in kept])]
    journalled = any(one.recorded for one in histories.values())
    epochs = _epochs([trial for _, trial in kept])
    first: dict[tuple[int, int], TrialRow] = {}
    for at, (path, trial) in enumerate(kept):
        history = histories[path.name]
        if history.learned is None:
            rolled_back = scores[at].rolled_back
            history = replace(history, learned=_went_on(kept, at), rolled_back=rolled_back)
        row = replace(_row(path, trial, scores[at], history), epoch=epochs[at])
        row = replace(row, undecided=journalled and not (row.decision or row.learned))
        name = (row.epoch, scores[at].input_crc)
        original = first.get(name)
        came_back = original is not None and original.iteration < row.iteration
        if original and row.decision == "repeat":
            row = replace(row, iteration=original.iteration)
        if row.counts:
            first.setdefault(name, row)
        row = replace(row, repeat_of=original.trial if original else 0)
        before = None if came_back and not row.input else _step_from(row, rows)
        if before is not None:
            row = replace(row, contraction=_contraction(scores[at], scores[before]))
        rows.append(row)
    return rows


def _epochs(trials: Sequence[Trial]) -> list[int]:
    """Of each: one more where a board began anew. Its iterations fall back, or its trial numbers do
    while it is still at the first; those of another board that was given all that this one had
    learned go on."""
    epochs = [0] * len(trials)
    for at, (before, now) in enumerate(pairwise(trials), 1):
        fell_back = now.iteration < before.iteration
        from_first = now.iteration == 1 and now.number <= before.number
        epochs[at] = epochs[at - 1] + (fell_back or from_first)
    return epochs


def _row(path: Path, trial: Trial, score: Score, history: TrialHistory) -> TrialRow:
    assert score.error_m_s is not None
    error = score.error_m_s[np.isfinite(score.error_m_s)].astype(np.float64)
    recorded = np.arange(len(trial.beats.samples)) < trial.executed_beats
    limit = np.float32(trial.params.get("AMP_MAX_RAD", math.inf))
    speed = trial.beats.speed_m_s[recorded & np.isfinite(trial.beats.speed_m_s)].astype(np.float64)
    volts = [volt for _, volt in trial.battery_v] or [math.nan]
    return TrialRow(
        trial=trial.number,
        iteration=trial.iteration,
        end=trial.end,
        decision=history.decision,
        reason=history.reason,
        repeat_of=0,
        max_abs_error_m_s=score.max_abs_error_m_s,
        rms_error_m_s=_rms(error.tolist()),
        measured_beats=error.size,
        saturated_beats=at_limit(trial.beats.applied_rad[recorded], float(limit)),
        distance_m=math.fsum(speed.tolist()) * trial.beat_s,
        contraction=math.nan,
        learned=bool(history.learned),
        rolled_back=history.rolled_back,
        straight=heading_drift(trial),
        battery_start_v=volts[0] if history.battery_start_v is None else history.battery_start_v,
        battery_end_v=volts[-1],
        input=trial.input,
        file=path.name,
        time=history.time,
        complete=score.judged,
    )


def _rms(error: Sequence[float]) -> float:
    """By an exact sum: numpy adds in an order of its own."""
    if not error:
        return math.nan
    return math.sqrt(math.fsum(e * e for e in error) / len(error))


def _went_on(kept: Sequence[tuple[Path, Trial]], at: int) -> bool:
    """Where the journal does not tell: a trial that was learned from is followed by the next
    iteration."""
    later = [trial for _, trial in kept[at + 1 :]]
    return bool(later) and later[0].iteration == kept[at][1].iteration + 1


def _judged(score: Score, judges_gaps: bool) -> Score:
    assert score.error_m_s is not None
    every = bool(np.isfinite(score.error_m_s).all())
    return replace(score, judged=score.judged and (judges_gaps or every))


def _step_from(row: TrialRow, earlier: Sequence[TrialRow]) -> int | None:
    """Where in ``earlier`` the trial is whose amplitudes the law made this trial's of."""
    if not (row.kept and row.complete) or row.input not in _BY_THE_LAW:
        return None
    before = [
        at
        for at, one in enumerate(earlier)
        if (one.epoch, one.iteration) == (row.epoch, row.iteration - 1) and one.kept
    ]
    return before[-1] if before and earlier[before[-1]].complete else None


def _contraction(now: Score, before: Score) -> float:
    assert now.error_m_s is not None and before.error_m_s is not None
    mine, its = on_common_beats(now.error_m_s, before.error_m_s)
    return mine / its if its > 0 else math.nan


def with_noise(rows: Sequence[TrialRow], noise_m_s: float, freedom: int) -> list[TrialRow]:
    """With the band of noise beside each contraction: 1 ± t·√2·σ over the error before, t of
    Student's distribution, as σ itself is known from a few repeats only."""
    if freedom < 1:
        return list(rows)
    half_m_s = student_t(freedom) * math.sqrt(2) * noise_m_s
    found = []
    for row in rows:
        if math.isfinite(row.contraction) and row.contraction > 0:
            half = half_m_s * row.contraction / row.max_abs_error_m_s
            row = replace(row, noise_low=max(_RATIO_MIN, 1 - half), noise_high=1 + half)
        found.append(row)
    return found


def noise_of(rows: Sequence[TrialRow], trials: Sequence[Trial]) -> tuple[float, int]:
    """(standard deviation, degrees of freedom) of deviations from the mean of an input's repeats in
    one epoch, pooled over all."""
    groups: dict[tuple[int, int], list[float]] = {}
    counting = [
        (row, score_of(trial))
        for row, trial in zip(rows, trials, strict=True)
        if row.counts and row.complete
    ]
    scores = comparable([score for _, score in counting])
    for (row, _), score in zip(counting, scores, strict=True):
        groups.setdefault((row.epoch, score.input_crc), []).append(score.max_abs_error_m_s)
    freedom = sum(len(group) - 1 for group in groups.values())
    if freedom == 0:
        return math.nan, 0
    means = {name: fmean(group) for name, group in groups.items()}
    squares = math.fsum((e - means[name]) ** 2 for name, group in groups.items() for e in group)
    return math.sqrt(squares / freedom), freedom


@dataclass(frozen=True)
class TrialHistory:
    """Of one trial's file. ``decision`` empty: nobody decided. ``learned`` None: the journal does
    not tell (an older tool, or commands without a series). ``recorded``: it tells of the trial.
    ``battery_start_v``: before the tail loaded it; a log begins later."""

    decision: str = ""
    reason: str = ""
    learned: bool | None = None
    rolled_back: bool = False
    time: str = ""
    recorded: bool = False
    battery_start_v: float | None = None


def histories_of(
    entries: Iterable[Mapping[str, Any]], names: Mapping[str, str]
) -> dict[str, TrialHistory]:
    """By the file's name. ``names``: of every raw file, that of the file its trial is now (a log
    that grew was kept again). An entry that names no file is of the last trial with its number; a
    board that was made anew counts from 1 again."""
    histories = {name: TrialHistory() for name in names.values()}
    file_of = {Path(name).stem: name for name in names}
    for entry in entries:
        number = entry.get("trial")
        stem = f"{number:04d}" if isinstance(number, int) else ""
        file = Path(str(entry.get("file") or file_of.get(stem, ""))).name
        if file not in names:
            continue
        if entry["what"] == "swum":
            file_of[stem] = file
        histories[names[file]] = _with(histories[names[file]], entry)
    return histories


def _with(history: TrialHistory, entry: Mapping[str, Any]) -> TrialHistory:
    if entry["what"] == "swum":
        volts = entry.get("battery_start_v")
        return replace(history, time=str(entry["time"]), recorded=True, battery_start_v=volts)
    if entry["what"] == "decided":
        decision, reason = str(entry.get("decision", "")), str(entry.get("reason") or "")
        learned = history.learned or False  # a decision alone: it has not happened, or not yet
        return replace(history, decision=decision, reason=reason, learned=learned, recorded=True)
    if entry["what"] == "withdrawn":
        return replace(history, decision="", reason="")
    if entry["what"] == "learned":
        return replace(history, learned=True, rolled_back=bool(entry.get("rolled_back")))
    return history
