"""The speeds of a trial before it is executed: a mean, and how its beats scatter together.

Why one or two trials in a row came out as they did: the likeliest of four explanations.

A regular trial; a spoilt one (its own gain or flow far off: a hand, a wave, a tangled cable); a
fish whose thrust is another one since (battery, fin), or a flow that stays; a fish of another shape
(ballast, another fish). Each says how trials' conditions and the model may be off, so each gives
the measured speeds a density; a wider one pays for its width. Two trials tell what one cannot:
spoilt ones are off each in its own way, a change is the same in both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import NUMBERS
from tailbeat.learning.scatter import STD_ABS, Scatter

_Z_90 = 1.6448536269514722  # 90 % of the standard normal lie within
_DRAWS = 600
# Trials have heavier tails than a normal distribution; this many degrees of freedom of a
# multivariate t, whose tests and draws they follow.
_FREEDOM = 8.0


@dataclass(frozen=True)
class Prediction:
    """Of the measured beats of a trial. ``covariance``: (beats, beats), (m/s)**2."""

    mean_m_s: F64
    covariance: F64

    def band(self) -> tuple[F64, F64]:
        """90 % of the measured speeds of a beat lie within (low, high), m/s."""
        spread = _Z_90 * np.sqrt(np.diag(self.covariance))
        return self.mean_m_s - spread, self.mean_m_s + spread

    def chance(self, speed_m_s: F64) -> float:
        """Probability of a trial at least as odd, over the measured beats; 1 = none was measured.
        By the F distribution that a multivariate t's squared distance follows."""
        from scipy.special import fdtrc

        seen = np.isfinite(speed_m_s)
        if not seen.any():
            return 1.0
        miss = (speed_m_s - self.mean_m_s)[seen]
        odd = float(miss @ np.linalg.solve(self.covariance[np.ix_(seen, seen)], miss))
        count = int(seen.sum())
        return float(fdtrc(count, _FREEDOM, odd / count))

    def max_abs_error(
        self, reference_m_s: F64, measured: NDArray[np.bool_] | None = None
    ) -> tuple[float, float, float]:
        """5 %, 50 % and 95 % quantile of a trial's max|e| over the ``measured`` beats (None = all),
        m/s; the same draws every time."""
        rng = np.random.default_rng(1)
        beats = len(self.mean_m_s)
        root = np.linalg.cholesky(self.covariance + 1e-18 * np.eye(beats))
        size = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, _DRAWS))
        draws = rng.standard_normal((_DRAWS, beats)) @ root.T * size[:, None]
        error = np.abs(reference_m_s - self.mean_m_s - draws)
        peak = (error if measured is None else error[:, measured]).max(axis=1)
        low, median, high = np.percentile(peak, (5, 50, 95))
        return float(low), float(median), float(high)


REGULAR, SPOILT, THRUST, SHAPE = "regular", "spoilt", "thrust", "shape"
# How often a trial is spoilt, and two trials are the first after a change. What follows the first
# may be from another day than the identification, or of another fish.
_SPOILT_PART = 0.05
# By it a fish of realistic scatter that loses 15 % of its thrust is told within two trials in 87 %
# of 30 cases, and 2 % of 210 trials of unchanged ones are called a change, which costs nothing.
_THRUST_PART = 0.25
_SHAPE_PART, _SHAPE_PART_FIRST = 0.01, 0.06

# How far a fish may be from the one that was identified, as standard deviations in the order of
# NUMBERS: the same fish on another day, or another one of its kind.
AGED = (0.05, 0.02, 0.005, 0.02, 0.02, 0.0005, 0.02, 0.1)
OTHER = (0.5, 0.2, 0.08, 0.25, 0.3, 0.003, 0.1, 0.3)
SPOILT_GAIN, SPOILT_FLOW_M_S = 0.12, 0.008
CHANGED_GAIN, CHANGED_FLOW_M_S = 0.08, 0.004

_COUNT = len(NUMBERS)


@dataclass(frozen=True)
class Expected:
    """A trial as it was expected. ``miss_m_s``: measured less expected, of the measured beats;
    ``by``: their derivatives by the model's numbers and (start, flow, log gain); ``noise``: their
    covariance with numbers and conditions known."""

    miss_m_s: F64
    by: F64
    noise: F64


@dataclass(frozen=True)
class Explanation:
    """``kind``: of the last trial. ``chance``: of something at least as odd, if it is so.
    ``flow_m_s``, ``log_gain``: what the trials have in common beyond what was expected, for
    ``thrust``."""

    kind: str
    chance: float
    flow_m_s: float = 0.0
    log_gain: float = 0.0


@dataclass(frozen=True)
class _Hypothesis:
    """``spoilt``: which trials are."""

    kind: str
    log_prior: float
    spoilt: tuple[bool, ...]


def explain(
    trials: Sequence[Expected],
    model: F64,
    scatter: Scatter,
    level_variance: float,
    first: bool = False,
) -> Explanation:
    """The likeliest. ``model``: covariance of the numbers. ``level_variance``: of the log gain that
    was expected. ``first``: no trial came between the identification and these."""
    miss = np.concatenate([trial.miss_m_s for trial in trials])
    best, density = None, -math.inf
    for hypothesis in _hypotheses(len(trials), first):
        covariance = _covariance(trials, hypothesis, model, scatter, level_variance)
        odd = float(miss @ np.linalg.solve(covariance, miss))
        likely = hypothesis.log_prior - 0.5 * (odd + float(np.linalg.slogdet(covariance)[1]))
        if likely > density:
            best, density = (hypothesis, covariance), likely
    assert best is not None
    hypothesis, covariance = best
    chance = Prediction(np.zeros(len(miss)), covariance).chance(miss)
    if hypothesis.kind != THRUST:
        return Explanation(hypothesis.kind, chance)
    by = np.vstack([trial.by[:, _COUNT:] for trial in trials])
    shared = _shared(THRUST, level_variance)
    _, flow, gain = shared @ by.T @ np.linalg.solve(covariance, miss)
    return Explanation(THRUST, chance, float(flow), float(gain))


def _hypotheses(count: int, first: bool) -> list[_Hypothesis]:
    often = {SHAPE: _SHAPE_PART_FIRST if first else _SHAPE_PART}
    if count > 1:  # a single trial cannot tell another thrust from a spoilt trial
        often[THRUST] = _THRUST_PART
    regular = 1 - _SPOILT_PART - sum(often.values()) / count
    found = []
    for spoilt in product((False, True), repeat=count):
        log_prior = sum(math.log(_SPOILT_PART if odd else regular) for odd in spoilt)
        found.append(_Hypothesis(SPOILT if spoilt[-1] else REGULAR, log_prior, spoilt))
    for kind, part in often.items():
        found.append(_Hypothesis(kind, math.log(part), (False,) * count))
    return found


def _shared(kind: str, level_variance: float) -> F64:
    """Covariance of the (start, flow, log gain) that all the trials have."""
    shared = np.diag([0.0, 0.0, level_variance])
    if kind in (THRUST, SHAPE):
        shared += np.diag(np.square([0.0, CHANGED_FLOW_M_S, CHANGED_GAIN]))
    return shared


def _covariance(
    trials: Sequence[Expected],
    hypothesis: _Hypothesis,
    model: F64,
    scatter: Scatter,
    level_variance: float,
) -> F64:
    """Of all measured beats, by one hypothesis."""
    kind = hypothesis.kind
    numbers = model + np.diag(np.square(OTHER)) if kind == SHAPE else model
    by = np.vstack([trial.by for trial in trials])
    covariance = by[:, :_COUNT] @ numbers @ by[:, :_COUNT].T
    covariance += by[:, _COUNT:] @ _shared(kind, level_variance) @ by[:, _COUNT:].T
    at = 0
    for trial, spoilt in zip(trials, hypothesis.spoilt, strict=True):
        flow_m_s = SPOILT_FLOW_M_S if spoilt else scatter.flow_m_s
        gain = SPOILT_GAIN if spoilt else scatter.gain
        alone = trial.by[:, _COUNT:] * [STD_ABS * scatter.start_m_s, flow_m_s, gain]
        here = slice(at, at + len(alone))
        covariance[here, here] += trial.noise + alone @ alone.T
        at += len(alone)
    return np.asarray(covariance, dtype=np.float64)
