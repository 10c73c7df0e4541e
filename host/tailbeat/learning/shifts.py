"""How the trials of a series differ from the model that was measured before them.

A trial's speeds less the model's are split into a shift (one gain and one flow for the whole trial,
told at the reference's top speed) and a remainder of each beat. What healthy fish show was measured
on random fish of both plants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from typing import Literal

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds

# Standard deviations of shifts: of one gain from trial to trial, of everything else from trial to
# trial, of the measured model, and of what a cause adds.
_GAIN_SIGMA, _TRIAL_SIGMA_M_S = 0.02, 0.0018
_MODEL_SIGMA_M_S, _CAUSE_SIGMA_M_S = 0.0025, 0.012
_NOISY = 4.0  # times the usual scatter of shifts
_SURE = 0.5  # posterior probability from which on shifts are called unusual
_BEAT_SIGMA_M_S = 0.0015
_START_M_S = 0.002
_RIDGE = np.diag(np.square([_BEAT_SIGMA_M_S / 0.1, _BEAT_SIGMA_M_S / 0.005]))

Pattern = Literal["usual", "constant", "stepped", "scattered", "single"]
_PRIORS: dict[Pattern, float] = {
    "usual": 0.7, "stepped": 0.12, "constant": 0.08, "scattered": 0.06, "single": 0.04
}  # fmt: skip


@dataclass(frozen=True)
class Split:
    """A trial less the model. ``shift_m_s``: at the top speed; ``remainder_m_s``: what is left of
    each beat, NaN = not measured."""

    shift_m_s: float
    remainder_m_s: F64


@dataclass(frozen=True)
class Shifts:
    """``pattern`` of the shifts of a series: ``constant`` from the first trial on, ``stepped`` from
    the trial with the index ``since`` on, ``scattered``, one ``single`` trial, or ``usual``, also
    where none of these is likely enough. ``size_m_s``: of the step, the constant or the scatter."""

    pattern: Pattern
    since: int = 0
    size_m_s: float = 0.0


@dataclass(frozen=True)
class _ShiftPattern:
    """A normal distribution of the shifts, mean 0."""

    pattern: Pattern
    since: int
    covariance: F64

    def log_density(self, shifts: F64) -> float:
        odd = float(shifts @ np.linalg.solve(self.covariance, shifts))
        return -0.5 * (odd + float(np.linalg.slogdet(self.covariance)[1]))


def split_of(trial: TrialSpeeds, model: FishModel, top_m_s: float) -> Split:
    """By ridge regression on one gain and one flow. The trial has some speed."""
    modelled = model.beats(trial.amplitude_rad, trial.beat_s, Conditions(_START_M_S))
    missed = trial.speed_m_s - modelled
    seen = trial.measured
    by = np.column_stack([modelled, np.ones(trial.beats)])
    gain, flow = np.linalg.solve(by[seen].T @ by[seen] + _RIDGE, by[seen].T @ missed[seen])
    return Split(float(gain * top_m_s + flow), missed - by @ (gain, flow))


def remainders(splits: Sequence[Split]) -> tuple[float, float]:
    """(what comes again in every trial, what does not) of a beat, RMS, m/s; zeros while no two
    trials have a speed at the same beat."""
    rows = np.array([one.remainder_m_s for one in splits])
    products = np.array([one * other for one, other in combinations(rows, 2)])
    if not np.isfinite(products).any():
        return 0.0, 0.0
    again = float(np.nanmean(products))
    alone = float(np.nanmean(rows**2)) - again
    return math.sqrt(max(again, 0.0)), math.sqrt(max(alone, 0.0))


def shifts_of(splits: Sequence[Split], top_m_s: float) -> Shifts:
    """The likeliest pattern, by Bayes; which trial it begins with is likely alike."""
    shifts = np.array([one.shift_m_s for one in splits])
    rows = sorted(_hypotheses(len(shifts), top_m_s), key=lambda row: row.pattern)
    log = np.array([row.log_density(shifts) for row in rows])
    likely = np.exp(log - log.max())
    chance: dict[Pattern, float] = {}
    since: dict[Pattern, int] = {}
    for pattern, group in groupby(zip(rows, likely, strict=True), key=lambda row: row[0].pattern):
        of = list(group)
        chance[pattern] = _PRIORS[pattern] * float(np.mean([one for _, one in of]))
        since[pattern] = max(of, key=lambda one: one[1])[0].since
    best = max(chance, key=lambda pattern: chance[pattern])
    if best == "usual" or chance[best] < _SURE * sum(chance.values()):
        return Shifts("usual")
    return Shifts(best, since[best], _size_m_s(best, shifts, since[best]))


def _hypotheses(count: int, top_m_s: float) -> Iterator[_ShiftPattern]:
    one, all_ = np.eye(count), np.ones((count, count))
    scatter = one * math.hypot(_GAIN_SIGMA * top_m_s, _TRIAL_SIGMA_M_S) ** 2
    model, more = all_ * _MODEL_SIGMA_M_S**2, _CAUSE_SIGMA_M_S**2
    yield _ShiftPattern("usual", 0, scatter + model)
    yield _ShiftPattern("constant", 0, scatter + more * all_)
    if count > 1:
        yield _ShiftPattern("scattered", 0, _NOISY**2 * scatter + model)
    for at in range(count):
        yield _ShiftPattern("single", at, scatter + model + more * np.outer(one[at], one[at]))
    for at in range(1, count - 1):
        after = (np.arange(count) >= at).astype(float)
        yield _ShiftPattern("stepped", at, scatter + model + more * np.outer(after, after))


def _size_m_s(pattern: Pattern, shifts: F64, since: int) -> float:
    if pattern == "scattered":
        return float(np.std(shifts, ddof=1))
    after = float(np.mean(shifts[since:]))
    return abs(after - float(np.mean(shifts[:since]))) if since else abs(after)
