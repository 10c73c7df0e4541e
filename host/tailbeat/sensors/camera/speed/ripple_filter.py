"""The Kalman filter and smoother behind swimspeed.py.

State: way, speed, acceleration (a Wiener process, spectral density ``jerk`` squared), and two
oscillators at once and twice the beat's frequency, each [in phase, in quadrature], stationary with
standard deviations ``ripple`` and ``second`` and a correlation time of CORRELATION_BEATS. What is
seen is way + both in phase + white noise.

Everything is in units of the noise: it divides out, and its size follows from the innovations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64

STATES = 7
SEEN_AS = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0])
CORRELATION_BEATS = 4.0
# Before the first picture: anywhere (in units of the noise), at any speed of a fish.
_WAY_SPREAD, _SPEED_SPREAD, _RISE_SPREAD = 1e6, 1e3, 1e3


@dataclass(frozen=True)
class Candidates:
    """Parameters in units of the noise, arrays of shape (n,): ``jerk`` in 1/s^2.5, the ripples as
    lengths."""

    jerk: F64
    ripple: F64
    second: F64


@dataclass(frozen=True)
class Forward:
    """A filter pass: innovation^2/variance and log variance summed over what was seen, shape (n,),
    and for one candidate every node's states; (nodes, ...) or None."""

    chi2: F64
    log_variance: F64
    count: int
    predicted: F64 | None = None
    predicted_cov: F64 | None = None
    filtered: F64 | None = None
    filtered_cov: F64 | None = None
    innovation: F64 | None = None  # over its standard deviation; NaN where nothing was seen


@dataclass(frozen=True)
class Smoothed:
    """Shape (nodes, 7), (nodes, 7, 7); ``gain[k]`` (7, 7) takes node k+1's smoothing back to k."""

    mean: F64
    cov: F64
    gain: F64


def transition(dt_s: float, beat_s: float) -> F64:
    """Shape (7, 7)."""
    step = np.zeros((STATES, STATES))
    step[:3, :3] = np.array([[1, dt_s, dt_s**2 / 2], [0, 1, dt_s], [0, 0, 1]])
    kept = np.exp(-dt_s / (CORRELATION_BEATS * beat_s))
    for order in (1, 2):
        angle = 2 * np.pi * order * dt_s / beat_s
        cos, sin = kept * np.cos(angle), kept * np.sin(angle)
        at = 1 + 2 * order
        step[at : at + 2, at : at + 2] = np.array([[cos, sin], [-sin, cos]])
    return step


def process_noise(dt_s: float, beat_s: float, by: Candidates) -> F64:
    """Shape (n, 7, 7)."""
    noise = np.zeros((len(by.jerk), STATES, STATES))
    d = dt_s
    wiener = np.array(
        [
            [d**5 / 20, d**4 / 8, d**3 / 6],
            [d**4 / 8, d**3 / 3, d**2 / 2],
            [d**3 / 6, d**2 / 2, d],
        ]
    )
    noise[:, :3, :3] = (by.jerk**2)[:, None, None] * wiener
    lost = 1 - np.exp(-2 * dt_s / (CORRELATION_BEATS * beat_s))
    for at, size in ((3, by.ripple), (5, by.second)):
        noise[:, at, at] = noise[:, at + 1, at + 1] = size**2 * lost
    return noise


def prior(by: Candidates, first: float) -> tuple[F64, F64]:
    """Mean (n, 7) and covariance (n, 7, 7) at the first node."""
    count = len(by.jerk)
    mean = np.zeros((count, STATES))
    mean[:, 0] = first
    cov = np.zeros((count, STATES, STATES))
    cov[:, 0, 0] = _WAY_SPREAD**2
    cov[:, 1, 1] = _SPEED_SPREAD**2
    cov[:, 2, 2] = _RISE_SPREAD**2
    for at, size in ((3, by.ripple), (5, by.second)):
        cov[:, at, at] = cov[:, at + 1, at + 1] = size**2
    return mean, cov


def forward(t_s: F64, way: F64, beat_s: float, by: Candidates, keep: bool) -> Forward:
    """Filters nodes at rising ``t_s``, shape (nodes,); ``way`` NaN = nothing seen there."""
    steps = _Steps(beat_s, by)
    mean, cov = prior(by, float(way[np.isfinite(way)][0]))
    chi2, log_variance, count = np.zeros(len(by.jerk)), np.zeros(len(by.jerk)), 0
    kept: dict[str, list[F64]] = {"p": [], "P": [], "f": [], "F": [], "i": []}
    for k in range(len(t_s)):
        if k:
            step, noise = steps.of(t_s[k] - t_s[k - 1])
            mean = mean @ step.T
            cov = step @ cov @ step.T + noise
        if keep:
            kept["p"].append(mean[0])
            kept["P"].append(cov[0])
        score = np.nan
        if np.isfinite(way[k]):
            mean, cov, missed, variance = _see(mean, cov, float(way[k]))
            if count:  # the first only says where the way begins
                chi2 += missed**2 / variance
                log_variance += np.log(variance)
            count += 1
            score = missed[0] / np.sqrt(variance[0])
        if keep:
            kept["f"].append(mean[0])
            kept["F"].append(cov[0])
            kept["i"].append(np.asarray(score))
    states = [np.array(kept[name]) for name in "pPfFi"] if keep else [None] * 5
    return Forward(chi2, log_variance, count - 1, *states)


def _see(mean: F64, cov: F64, way: float) -> tuple[F64, F64, F64, F64]:
    across = cov @ SEEN_AS
    variance = across @ SEEN_AS + 1.0
    missed = way - mean @ SEEN_AS
    gain = across / variance[:, None]
    mean = mean + gain * missed[:, None]
    cov = cov - gain[:, :, None] * across[:, None, :]
    return mean, cov, missed, variance


class _Steps:
    """Transitions by their length, which few films have many of."""

    def __init__(self, beat_s: float, by: Candidates) -> None:
        self._beat_s = beat_s
        self._by = by
        self._known: dict[int, tuple[F64, F64]] = {}

    def of(self, dt_s: float) -> tuple[F64, F64]:
        microseconds = round(dt_s * 1e6)
        if microseconds not in self._known:
            dt = microseconds * 1e-6
            self._known[microseconds] = (
                transition(dt, self._beat_s),
                process_noise(dt, self._beat_s, self._by),
            )
        return self._known[microseconds]


def smooth(t_s: F64, beat_s: float, done: Forward) -> Smoothed:
    """Rauch, Tung and Striebel's pass over a kept filter pass."""
    assert done.filtered is not None and done.filtered_cov is not None
    assert done.predicted is not None and done.predicted_cov is not None
    steps = {dt: transition(dt * 1e-6, beat_s) for dt in {round(d * 1e6) for d in np.diff(t_s)}}
    moves = np.array([steps[round(d * 1e6)] for d in np.diff(t_s)])
    crossed = done.filtered_cov[:-1] @ moves.transpose(0, 2, 1)
    gain = np.linalg.solve(done.predicted_cov[1:], crossed.transpose(0, 2, 1)).transpose(0, 2, 1)
    mean, cov = done.filtered.copy(), done.filtered_cov.copy()
    for k in range(len(t_s) - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - done.predicted[k + 1])
        cov[k] += gain[k] @ (cov[k + 1] - done.predicted_cov[k + 1]) @ gain[k].T
    return Smoothed(mean, cov, gain)
