"""The Theta function of chapter 7, (7.5)-(7.6): how heat given at one end of an insulated rod of
length 1 arrives along it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.thesis.arrays import Doubles

_TERMS = 60  # of either sum: far beyond double precision where it is used


def theta(x: float, t: ArrayLike, images: int | None = None) -> Doubles:
    """theta(x, t) for t > 0. ``images``: the sum (7.5) cut at abs(m) <= images, as in figures 7.1
    to 7.3; None = the whole of it."""
    time = np.asarray(t, dtype=np.float64)
    if images is not None:
        return _by_images(x, time, images)
    with np.errstate(under="ignore"):
        early, late = _by_images(x, time, _TERMS), _by_modes(x, time)
    return np.where(time < 0.5, early, late)


def _by_images(x: float, time: Doubles, images: int) -> Doubles:
    """(7.5): the heat kernel and its mirror images."""
    at = x + 2 * np.arange(-images, images + 1)
    with np.errstate(under="ignore"):
        kernels = np.exp(-(at**2) / (4 * time[..., None]))
    total: Doubles = kernels.sum(axis=-1) / np.sqrt(4 * np.pi * time)
    return total


def _by_modes(x: float, time: Doubles) -> Doubles:
    """(7.6): the same as a sum of cosines."""
    n = np.arange(1, _TERMS)
    modes = np.cos(n * np.pi * x) * np.exp(-((n * np.pi) ** 2) * time[..., None])
    total: Doubles = 0.5 + modes.sum(axis=-1)
    return total


def gain_for(lead: float) -> float:
    """-1 / (2 theta(1, lead)): the gain that (7.14) has contract best."""
    return float(-1 / (2 * theta(1.0, lead)))


def promised(gain: float, lead: float) -> float:
    """abs(1 + 2 * gain * theta(1, lead)): the factor per trial that theorem 7.1 promises."""
    return float(abs(1 + 2 * gain * theta(1.0, lead)))
