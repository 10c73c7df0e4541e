"""How trials of one fish differ from each other, and how it is learned from what a fit leaves over.

What is usual of any fish counts as some trials of this one; the fish's own overrule it. A trial
whose gain or flow is far off counts less (a t distribution's weight), so one trial that a hand
spoilt makes neither the fish seem to scatter nor the model wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds

STD_ABS = 0.6028102749890869  # of |N(0, 1)|: a fish begins forwards or at rest
WALK = 0.004  # standard deviation of the log gain's change from trial to trial
MOVES_S = 6.0  # a flow that moves within a trial is forgotten in this time


@dataclass(frozen=True)
class Scatter:
    """How trials of one fish differ, as standard deviations; 0 = never differs. Of a beat's speed:
    ``model_m_s``, what the model leaves out of each beat alone; ``switch``, likewise, of the change
    of the steady speed; ``moves_m_s``, of the flow within a trial."""

    gain: float = 0.02
    flow_m_s: float = 0.0015
    start_m_s: float = 0.0025
    model_m_s: float = 0.0005
    switch: float = 0.03
    moves_m_s: float = 0.001

    @property
    def misfit_m_s(self) -> float:
        """What the model leaves out of a beat, RMS."""
        return math.hypot(self.moves_m_s, self.model_m_s)

    def draw(self, rng: np.random.Generator) -> Conditions:
        """How one trial differs from the others."""
        return Conditions(
            start_m_s=abs(rng.normal(0, self.start_m_s)),
            flow_m_s=rng.normal(0, self.flow_m_s),
            gain=max(rng.normal(1, self.gain), 0.0),
        )

    def moving(self, beats: int, beat_s: float) -> F64:
        """Covariance of the flow that moves within a trial, (beats, beats)."""
        apart_s = np.abs(np.subtract.outer(np.arange(beats), np.arange(beats))) * beat_s
        covariance: F64 = self.moves_m_s**2 * np.exp(-apart_s / MOVES_S)
        return covariance

    def alone(self, model: FishModel, amplitude_rad: F64) -> F64:
        """Variance per beat of what neighbouring beats do not share, without the measurement's."""
        switched = self.switch * steepness(model.root(amplitude_rad))
        variance: F64 = self.model_m_s**2 + switched**2
        return variance


def beat_variance(trial: TrialSpeeds, model: FishModel, scatter: Scatter) -> F64:
    """Variance of measured minus modelled speeds that neighbouring beats do not share."""
    own: F64 = trial.sigma_m_s**2 + scatter.alone(model, trial.amplitude_rad)
    return own


def beat_covariance(trial: TrialSpeeds, model: FishModel, scatter: Scatter) -> F64:
    """Covariance of measured minus modelled speeds, conditions known, (beats, beats)."""
    own = beat_variance(trial, model, scatter)
    noise: F64 = scatter.moving(trial.beats, trial.beat_s) + np.diag(own)
    return noise


def beat_sigma(trial: TrialSpeeds, model: FishModel, scatter: Scatter) -> F64:
    """Standard deviation of measured minus modelled speed per beat, conditions known."""
    sigma: F64 = np.sqrt(np.diag(beat_covariance(trial, model, scatter)))
    return sigma


def steepness(steady_m_s: F64) -> F64:
    """Of the steady speeds of beats: the larger of the last two changes, from rest, m/s."""
    change = np.abs(np.diff(steady_m_s, prepend=0.0))
    steepest: F64 = np.maximum(change, np.concatenate([[0.0], change[:-1]]))
    return steepest


_USUAL_TRIALS = 6.0  # what is usual counts as so many trials
_USUAL_BEATS = 40.0
_FREEDOM = 4.0  # of the t distribution that trials' conditions follow
_ODD_BEATS = 4.0  # times the expected mean square, from which on a trial's beats count less
_WEIGHT_MIN = 0.02
_MIN_M_S = 0.0002


def weights_of(conditions: F64, oddness: F64, scatter: Scatter) -> F64:
    """How much each trial counts, up to 1. ``conditions``: (flow, log gain) less what was expected
    of each trial, shape (trials, 2). ``oddness``: as of a ``Fit``."""
    usual = np.array([scatter.flow_m_s, scatter.gain])
    odd = np.sum((conditions / np.maximum(usual, 1e-9)) ** 2, axis=1)
    by_conditions = np.minimum((_FREEDOM + 2) / (_FREEDOM + odd), 1.0)
    by_beats = np.minimum(_ODD_BEATS / np.maximum(oddness, 1e-9), 1.0)
    weight: F64 = np.clip(by_conditions * by_beats, _WEIGHT_MIN, 1.0)
    return weight


def learned(
    trials: Sequence[TrialSpeeds],
    residual_m_s: Sequence[F64],
    conditions: F64,
    variance: F64,
    weights: F64,
    usual: Scatter,
) -> Scatter:
    """The scatter that a fit's answers show. ``conditions``: (start, flow, log gain) less what was
    expected, shape (trials, 3); ``variance``: what is not known of them, likewise."""
    known = np.array([usual.start_m_s, usual.flow_m_s, usual.gain])
    counts = np.column_stack([np.ones(len(weights)), weights, weights])
    squares = counts * (conditions**2 + np.minimum(variance, known**2) * [0, 1, 1])
    total = _USUAL_TRIALS * known**2 + squares.sum(axis=0)
    start, flow, gain = np.sqrt(total / (_USUAL_TRIALS + counts.sum(axis=0)))
    moves, alone = _of_beats(trials, residual_m_s, weights, usual)
    return replace(
        usual,
        start_m_s=float(start), flow_m_s=float(flow), gain=float(gain),
        moves_m_s=moves, model_m_s=alone,
    )  # fmt: skip


def _own_part(trials: Sequence[TrialSpeeds], residual_m_s: Sequence[F64]) -> list[F64]:
    """Residuals without what the trials of a reference have in common, which is no scatter."""
    found = [residual.copy() for residual in residual_m_s]
    groups: dict[tuple[int, int], list[int]] = {}
    for index, trial in enumerate(trials):
        groups.setdefault((trial.reference_crc, trial.beats), []).append(index)
    for (crc, _), group in groups.items():
        if not crc or len(group) < 2:
            continue
        together = np.array([residual_m_s[index] for index in group])
        count = np.isfinite(together).sum(axis=0)
        common = np.nansum(together, axis=0) / np.maximum(count, 1)
        wider = np.sqrt(count / np.maximum(count - 1, 1))
        for index in group:
            found[index] = (residual_m_s[index] - common) * wider
    return found


def _of_beats(
    trials: Sequence[TrialSpeeds], residual_m_s: Sequence[F64], weights: F64, usual: Scatter
) -> tuple[float, float]:
    """(moves_m_s, model_m_s) by the products of residuals with themselves and their neighbours."""
    kept = float(np.exp(-(trials[0].beat_s if trials else 1.0) / MOVES_S))
    own = _USUAL_BEATS * (usual.moves_m_s**2 + usual.model_m_s**2)
    next_to = _USUAL_BEATS * usual.moves_m_s**2 * kept
    beats = pairs = _USUAL_BEATS
    rows = zip(trials, _own_part(trials, residual_m_s), weights, strict=True)
    for trial, residual, weight in rows:
        seen = np.isfinite(residual)
        both = seen[1:] & seen[:-1]
        own += weight * float(np.sum(residual[seen] ** 2 - trial.sigma_m_s[seen] ** 2))
        next_to += weight * float(np.sum(residual[1:][both] * residual[:-1][both]))
        beats += weight * int(seen.sum())
        pairs += weight * int(both.sum())
    moves = np.sqrt(max(next_to / pairs / kept, _MIN_M_S**2))
    alone = np.sqrt(max(own / beats - moves**2, _MIN_M_S**2))
    return float(moves), float(alone)
