"""How likely a sample is reached, and the conditions on the gains that follow (chapters 2, 3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64


def reached_probability(
    times: ArrayLike, wanted: int, before: int, after: int, masses: Sequence[float]
) -> F64:
    """p(t), (2.5): the probability that a trial reaches sample t. Trials end at
    ``wanted - before`` … ``wanted + after`` with the probabilities ``masses``, N1 + N2 + 1 of them.
    """
    if len(masses) != before + after + 1:
        raise ValueError("one probability per possible end")
    tails = np.append(np.cumsum(np.asarray(masses, np.float64)[::-1])[::-1], 0.0)
    first = np.clip(np.asarray(times, np.int64) - (wanted - before), 0, len(masses))
    return np.where(first == 0, 1.0, tails[first])


def contraction(probability: ArrayLike, gain: ArrayLike) -> float:
    """sup |1 - p LCB|, (2.11) and (2.32), for one input and one output. ``probability`` and
    ``gain`` belong to the samples that the law corrects with: p(t+1), L C(t+1) B(t)."""
    return float(np.abs(1.0 - np.asarray(probability) * np.asarray(gain)).max())


def window_contraction(
    betas: Sequence[float], slopes: tuple[float, float], reached: ArrayLike
) -> list[float]:
    """eta_j of (3.13) and (3.36) for an input gain c'f_u anywhere in ``slopes`` and samples that
    are reached with the probabilities ``reached``, q(t)."""
    part = 1.0 / len(betas)
    q = np.asarray(reached, np.float64)
    return [
        float(max(np.max(np.abs(part - beta * slope) * q + (1.0 - q) * part) for slope in slopes))
        for beta in betas
    ]


def beta_bounds(
    trials: int, missed: float, slopes: tuple[float, float], rho: float
) -> tuple[float, float]:
    """(3.34): the beta_j that contract to ``rho`` over ``trials`` = m + 1 trials when the end is
    missed with a probability of at most ``missed``, alpha_2."""
    low, high = slopes
    share = trials * (1.0 - missed)
    return (1.0 - rho) / (share * low), (1.0 + rho - 2.0 * missed) / (share * high)


def rho_least(missed: float, slopes: tuple[float, float]) -> float:
    """The least rho with which (3.34) leaves any beta_j."""
    low, high = slopes
    return (high + 2.0 * missed * low - low) / (high + low)


def normal_reached(mean: float, deviation: float) -> Callable[[ArrayLike], F64]:
    """q(t) = 1 - F(t), (3.6), for normally distributed lengths."""
    from math import erfc, sqrt

    def reached(times: ArrayLike) -> F64:
        scaled = (np.atleast_1d(np.asarray(times, np.float64)) - mean) / (deviation * sqrt(2.0))
        return np.array([0.5 * erfc(x) for x in scaled])

    return reached
