"""Why one or two trials in a row came out as they did: the likeliest of four explanations.

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

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import NUMBERS
from tailbeat.learning.prediction import Prediction
from tailbeat.learning.scatter import STD_ABS, Scatter

REGULAR, SPOILT, THRUST, SHAPE = "regular", "spoilt", "thrust", "shape"
KINDS = (REGULAR, SPOILT, THRUST, SHAPE)
USUAL = (0.93, 0.05, 0.01, 0.01)  # how often each comes, in the order of KINDS
FIRST = (0.84, 0.08, 0.02, 0.06)  # of the first trial since an identification

# How far a fish may be from the one that was identified, as standard deviations in the order of
# NUMBERS: the same fish on another day, or another one of its kind.
AGED = (0.05, 0.02, 0.005, 0.02, 0.02, 0.0005, 0.02, 0.1)
OTHER = (0.5, 0.2, 0.08, 0.25, 0.3, 0.003, 0.1, 0.3)
SPOILT_GAIN, SPOILT_FLOW_M_S = 0.12, 0.008
CHANGED_GAIN, CHANGED_FLOW_M_S = 0.10, 0.006

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
    """``chance``: of something at least as odd, if it is so. ``flow_m_s``, ``log_gain``: what the
    trials have in common beyond what was expected, for ``thrust``."""

    kind: str
    chance: float
    flow_m_s: float = 0.0
    log_gain: float = 0.0


def explain(
    trials: Sequence[Expected],
    model: F64,
    scatter: Scatter,
    level_variance: float,
    often: Sequence[float] = USUAL,
) -> Explanation:
    """The likeliest. ``model``: covariance of the numbers. ``level_variance``: of the log gain that
    was expected."""
    miss = np.concatenate([trial.miss_m_s for trial in trials])
    likely, found = [], []
    for kind, part in zip(KINDS, often, strict=True):
        covariance = _covariance(trials, kind, model, scatter, level_variance)
        each = len(trials) if kind in (REGULAR, SPOILT) else 1
        odd = float(miss @ np.linalg.solve(covariance, miss))
        density = -0.5 * (odd + float(np.linalg.slogdet(covariance)[1]))
        likely.append(density + each * math.log(part))
        found.append(covariance)
    best = int(np.argmax(likely))
    kind, covariance = KINDS[best], found[best]
    chance = Prediction(np.zeros(len(miss)), covariance).chance(miss)
    if kind != THRUST:
        return Explanation(kind, chance)
    shared = _shared(kind, level_variance)
    by = np.vstack([trial.by[:, _COUNT:] for trial in trials])
    _, flow, gain = shared @ by.T @ np.linalg.solve(covariance, miss)
    return Explanation(kind, chance, float(flow), float(gain))


def _shared(kind: str, level_variance: float) -> F64:
    """Covariance of the (start, flow, log gain) that all the trials have."""
    shared = np.diag([0.0, 0.0, level_variance])
    if kind in (THRUST, SHAPE):
        shared += np.diag(np.square([0.0, CHANGED_FLOW_M_S, CHANGED_GAIN]))
    return shared


def _covariance(
    trials: Sequence[Expected], kind: str, model: F64, scatter: Scatter, level_variance: float
) -> F64:
    """Of all measured beats, by one explanation."""
    spoilt = kind == SPOILT
    flow_m_s = SPOILT_FLOW_M_S if spoilt else scatter.flow_m_s
    gain = SPOILT_GAIN if spoilt else scatter.gain
    own = [STD_ABS * scatter.start_m_s, flow_m_s, gain]
    numbers = model + np.diag(np.square(OTHER)) if kind == SHAPE else model
    by = np.vstack([trial.by for trial in trials])
    covariance = by[:, :_COUNT] @ numbers @ by[:, :_COUNT].T
    covariance += by[:, _COUNT:] @ _shared(kind, level_variance) @ by[:, _COUNT:].T
    at = 0
    for trial in trials:
        alone = trial.by[:, _COUNT:] * own
        here = slice(at, at + len(alone))
        covariance[here, here] += trial.noise + alone @ alone.T
        at += len(alone)
    return np.asarray(covariance, dtype=np.float64)
