"""The speeds of a trial before it is executed: a mean, and how its beats scatter together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64

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
