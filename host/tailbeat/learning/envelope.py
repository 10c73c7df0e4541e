"""How far amplitudes carry a fish, and one that is as strong as may still be believed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import Conditions, FishModel
from tailbeat.learning.fit import Scatter

PESSIMISM = 2.0  # sigmas
_COAST_S = 5.0  # after the last beat, until somebody is at the fish


def speeds(
    model: FishModel, amplitude_rad: ArrayLike, beat_s: float, given: Conditions | None = None
) -> F64:
    """Mean speed over ground per beat, m/s: of ``amplitude_rad`` and then of the coast after it,
    shape (beats + some,)."""
    coast = np.zeros(max(1, round(_COAST_S / beat_s)))
    amplitude = np.concatenate([np.asarray(amplitude_rad, dtype=np.float64), coast])
    return model.beats(amplitude, beat_s, given)


def way(
    model: FishModel, amplitude_rad: ArrayLike, beat_s: float, given: Conditions | None = None
) -> float:
    """Way over ground until the coast after the last beat is over, m."""
    return float(np.sum(speeds(model, amplitude_rad, beat_s, given))) * beat_s


def farthest(
    model: FishModel, covariance: F64, scatter: Scatter, amplitude_rad: ArrayLike, beat_s: float
) -> tuple[FishModel, Conditions]:
    """The most probable of the fish and days that travel ``PESSIMISM`` sigmas too far.

    Of all (log kappa, log slope, dead zone, delay, gain, flow) at that distance from the best, in
    units of what is known of them, the one straight up the slope of the way. ``covariance``: 4 x 4
    of the first four.
    """
    centre = _as_vector(model)
    whole = np.zeros((6, 6))
    whole[:4, :4] = covariance
    whole[4, 4], whole[5, 5] = scatter.gain**2, scatter.flow_m_s**2
    sigma = np.sqrt(np.diag(whole))

    def way_of(x: F64) -> float:
        fish, day = _from_vector(x)
        return way(fish, amplitude_rad, beat_s, day)

    slope = np.zeros(6)
    for i in np.flatnonzero(sigma > 0):
        step = np.zeros(6)
        step[i] = sigma[i]
        slope[i] = (way_of(centre + step) - way_of(centre - step)) / (2 * sigma[i])
    spread = math.sqrt(float(slope @ whole @ slope))
    if spread == 0:
        return model, Conditions()
    return _from_vector(centre + PESSIMISM * (whole @ slope) / spread)


def _as_vector(model: FishModel) -> F64:
    return np.array(
        [
            math.log(model.kappa_per_m),
            math.log(model.slope_m_s_rad),
            model.dead_zone_rad,
            model.delay_s,
            1.0,
            0.0,
        ]
    )


def _from_vector(x: F64) -> tuple[FishModel, Conditions]:
    kappa, slope, dead, delay, gain, flow = map(float, x)
    model = FishModel(math.exp(kappa), math.exp(slope), max(dead, 0.0), max(delay, 0.0))
    return model, Conditions(gain=max(gain, 0.0), flow_m_s=flow)
