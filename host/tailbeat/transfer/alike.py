"""Whether one reference is a scaled copy of another: v2(t) = m*v1(s*t)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.reference import Reference
from tailbeat.transfer.beatcurve import BeatCurve

Array = NDArray[np.float64]

# Of the new reference's largest speed. Beat means hide what is within a beat: scaled copies (0.5 to
# 2 times as long) of a trapezoid with ramps of 2, 4, 8 beats fit to 4.2, 2.3, 1.2 %, the thesis's
# profile to 1.2 %; a cosine instead of the trapezoid misses by 7 % and more from 4 beats on.
TOLERANCE = 0.05
_GRID = 41
_ZOOMS = 5
_AS_GOOD = 1.05  # a factor that the durations give is kept while its misfit is no more than this
_TINY = 1e-4  # of the largest speed: misfits that are no more than rounding


@dataclass(frozen=True)
class Likeness:
    """``magnitude`` m and ``time_factor`` s (> 1: the new one is over sooner) by least squares over
    beats. ``residual_m_s``: largest misfit of a beat of the new reference; ``peak_m_s``: its
    largest speed."""

    magnitude: float
    time_factor: float
    residual_m_s: float
    peak_m_s: float

    @property
    def alike(self) -> bool:
        """Whether the misfit is within the tolerance, 5 % of the largest speed."""
        return self.residual_m_s <= TOLERANCE * self.peak_m_s


def likeness(old: Reference, new: Reference) -> Likeness:
    """The best m and s. Raises InputError when one of the two is zero throughout."""
    for reference in (old, new):
        if not np.any(reference.speed_m_s > 0):
            raise InputError(
                f"the reference {reference.name} is zero throughout.",
                "Take one along which the fish swims.",
            )
    fit = _Fit(old, new)
    plain = old.duration_s / new.duration_s
    best = fit.best()
    usual, found = fit.rms(plain), fit.rms(best)
    s = plain if usual <= _AS_GOOD * found + _TINY * fit.peak else best
    m, misfit = fit.scaled(s)
    return Likeness(m, s, float(np.abs(misfit).max()), fit.peak)


class _Fit:
    def __init__(self, old: Reference, new: Reference) -> None:
        self.curve = BeatCurve(old.speed_m_s.astype(np.float64))
        self.wanted = new.speed_m_s.astype(np.float64)
        self.peak = float(self.wanted.max())
        self.old, self.new = old, new

    def scaled(self, s: float) -> tuple[float, Array]:
        """m for a given s, and the misfit per beat."""
        edge: Array = np.arange(self.new.beats + 1, dtype=np.float64)
        shape = self.curve.means(edge * (s * self.new.beat_s / self.old.beat_s))
        power = float(shape @ shape)
        m = float(shape @ self.wanted) / power if power > 0 else 0.0
        return m, self.wanted - m * shape

    def rms(self, s: float) -> float:
        """Of the misfit."""
        return float(np.sqrt(np.mean(self.scaled(s)[1] ** 2)))

    def best(self) -> float:
        """s within what whole beats leave open: a begun one counts."""
        old, new = self.old, self.new
        low = max(old.duration_s - old.beat_s, old.duration_s / 2) / (new.duration_s + new.beat_s)
        high = (old.duration_s + old.beat_s) / max(new.duration_s - new.beat_s, new.beat_s / 2)
        s = low
        for _ in range(_ZOOMS):
            grid = np.linspace(low, high, _GRID)
            s = float(grid[np.argmin([self.rms(value) for value in grid])])
            step = (high - low) / (_GRID - 1)
            low, high = s - step, s + step
        return s
