"""How the gain should fall along the iterations: noise learned at full gain stays in the input.

A law that corrects a part a of each trial's error leaves, in the end, a variance of a*r/(2 - a)
where r is the variance of what does not repeat. The Kalman filter along the iterations has the best
sequence: K = P/(P + r), P := (1 - K)*P, so that 1/K grows by 1 with each trial (Saab's gain ~ 1/k).
The board approximates it: the gain is divided by 1 + ILC_DECR_RATE*max(0, visits - ILC_DECR_FROM).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.learning.convergence import NoiseBand, Score, best_of, comparable, default_band

FLUCTUATION_MAX = 1.3  # times the noise of repeats
_SETTLED_MIN = 4  # trials
_FADE_MAX = 10.0
_FROM_MAX = 255
_INTERVAL_SIGMAS = 2 * 1.96


@dataclass(frozen=True)
class Fade:
    """``fade``, ``fade_from``: for ILC_DECR_RATE and ILC_DECR_FROM. ``kalman``, ``board``: shape
    (trials,), what the gain is multiplied by at each visit of a beat, by the Kalman filter and by
    the board."""

    fade: float
    fade_from: int
    kalman: F64
    board: F64


def fade_advice(
    noise_variance: float,
    start_variance: float,
    step: float = 1.0,
    walk_variance: float = 0.0,
    settled_after: int = 0,
    trials: int = 20,
) -> Fade:
    """ILC_DECR_RATE and ILC_DECR_FROM that come nearest to the Kalman filter's gains.

    Variances of a beat's error, (m/s)**2: ``noise_variance`` of what differs between repeats,
    ``start_variance`` of what is to be learned, ``walk_variance`` of how that wanders from trial to
    trial. ``step``: the part of the error that the law takes out at full gain, 0 to 1; the gain
    never rises. ``settled_after``: trials that the full gain is known to need, because of the dead
    zone or of limits. Raises InputError for variances below 0, or no noise.
    """
    if not (noise_variance > 0 and start_variance >= 0 and walk_variance >= 0 and 0 < step <= 1):
        raise InputError(
            "the variances for the gain's sequence make no sense.",
            "Give a noise above 0, nothing below 0, and a step in (0, 1].",
        )
    kalman = np.ones(trials)
    p = start_variance
    for k in range(trials):
        if k >= settled_after:
            kalman[k] = min(1.0, p / (p + noise_variance) / step)
        gain = kalman[k] * step
        p = (1 - gain) ** 2 * p + gain**2 * noise_variance + walk_variance
    falls = np.flatnonzero(kalman < 1.0)
    start = int(falls[0]) - 1 if falls.size else trials - 1
    fade_from = min(max(start, 0), _FROM_MAX)
    beyond = np.maximum(0, np.arange(trials) - fade_from)
    fade = _nearest(kalman, beyond)
    return Fade(fade, fade_from, kalman, 1 / (1 + fade * beyond))


def fluctuation(scores: Sequence[Score], band: NoiseBand | None = None) -> float | None:
    """Scatter of max|e| since the series settled, over that of repeats; None before four trials
    have. Settled: from the first judged trial that noise does not tell from the best."""
    scores = comparable(scores)
    best = best_of(scores)
    at = settled_after(scores, band)
    if best is None or at is None:
        return None
    settled = [score.max_abs_error_m_s for score in scores[at:] if score.judged]
    if len(settled) < _SETTLED_MIN:
        return None
    noise = sum((band or default_band(best.max_abs_error_m_s)).widths(best.max_abs_error_m_s))
    return float(np.std(settled, ddof=1)) / (noise / _INTERVAL_SIGMAS)


def settled_after(scores: Sequence[Score], band: NoiseBand | None = None) -> int | None:
    """Index of the first judged trial within noise of the best; None = none is judged."""
    scores = comparable(scores)
    best = best_of(scores)
    if best is None:
        return None
    _, up = (band or default_band(best.max_abs_error_m_s)).widths(best.max_abs_error_m_s)
    limit = best.max_abs_error_m_s + math.sqrt(2) * up
    return next(
        at for at, score in enumerate(scores) if score.judged and score.max_abs_error_m_s <= limit
    )


def repeat_variance(scores: Sequence[Score]) -> float | None:
    """Variance of a beat's error between repeats, mean over beats, (m/s)**2; None without any."""
    groups: dict[int, list[F64]] = {}
    for score in scores:
        if score.judged and score.error_m_s is not None:
            groups.setdefault(score.input_crc, []).append(score.error_m_s.astype(np.float64))
    repeats = [np.array(group) for group in groups.values() if len(group) > 1]
    if not repeats:
        return None
    found = [_scatter(group) for group in repeats]
    freedom = sum(count for _, count in found)
    return sum(squares for squares, _ in found) / freedom if freedom else None


def _scatter(group: F64) -> tuple[float, int]:
    """(sum of squares about each beat's mean, degrees of freedom) of repeats; NaN = no speed."""
    known = np.isfinite(group)
    times = known.sum(axis=0)
    mean = np.where(known, group, 0.0).sum(axis=0) / np.maximum(times, 1)
    squares = np.where(known, group - mean, 0.0) ** 2
    return float(squares.sum()), int(np.maximum(times - 1, 0).sum())


def _nearest(kalman: F64, beyond: NDArray[np.int64]) -> float:
    from scipy.optimize import minimize_scalar

    if not beyond.any():
        return 0.0

    def misfit(fade: float) -> float:
        return float(np.sum((1 / (1 + fade * beyond) - kalman) ** 2))

    found = minimize_scalar(misfit, bounds=(0.0, _FADE_MAX), method="bounded")
    return round(float(found.x), 3)
