"""How large noise, jerk and ripple of a film are: those that make it likeliest."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.speed.ripplefilter import Candidates, forward

Floats = NDArray[np.float64]

_TUNING_PICTURES = 1500
_NOISE_MIN_M = 1e-6  # places of drawn or frozen pictures are exactly equal
# In units of the noise, of about a millimetre: from far below what matters to far above.
_JERK_RANGE, _RIPPLE_RANGE = (1e-2, 1e4), (1e-3, 30.0)
_RATIOS = (10.0, 10.0, 3.0, 3.0, 3.0, 1.6, 1.6, 1.25, 1.25)


def likeliest(t_s: Floats, way_m: Floats, beat_s: float) -> tuple[Candidates, float]:
    """Of ways at rising times, shape (pictures,): the parameters in units of the noise (one
    candidate), and the noise in metres, 1e-6 or more. From coarse to fine, three values of each at
    a time; the noise divides out (concentrated likelihood), and its first guess only sets the scale
    of the search."""
    stride = -(-len(t_s) // _TUNING_PICTURES)
    t_s, way_m = t_s[::stride], way_m[::stride]
    unit_m = _rough_noise_m(way_m)
    least = (_NOISE_MIN_M / unit_m) ** 2
    best = np.array([30.0, 0.3, 0.3])
    low, high = np.array([_JERK_RANGE, _RIPPLE_RANGE, _RIPPLE_RANGE]).T
    scale = 1.0
    for ratio in _RATIOS:
        around = np.array(list(product((1 / ratio, 1.0, ratio), repeat=3))) * best
        by = _candidates(np.clip(around, low, high))
        done = forward(t_s, way_m / unit_m, beat_s, by, keep=False)
        variance = done.chi2 / done.count
        noise = np.maximum(variance, least)
        loss = np.log(noise) + variance / noise + done.log_variance / done.count
        at = int(np.argmin(loss))
        best = np.clip(around[at], low, high)
        scale = math.sqrt(float(noise[at]))
    return _candidates(best[None, :]), unit_m * scale


def _candidates(rows: Floats) -> Candidates:
    return Candidates(rows[:, 0], rows[:, 1], rows[:, 2])


def _rough_noise_m(way_m: Floats) -> float:
    """From third differences, to which a swimming fish adds little."""
    third = np.diff(way_m, 3)
    rough = float(np.median(np.abs(third))) / 0.6745 / math.sqrt(20.0) if len(third) else 0.0
    return max(rough, 1e-5)
