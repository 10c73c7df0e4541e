"""A Kalman filter and smoother over positions along the swim direction, and its likeliest model.

What is seen is the fish's way, noise that is correlated in time, and white noise:

* the way: place, speed, acceleration (a Wiener process, spectral density ``jerk`` squared) and two
  oscillators at once and twice the beat's frequency, each [in phase, in quadrature], stationary
  with standard deviations ``ripple`` and ``second`` and a correlation time of CORRELATION_BEATS;
* the drift: a first-order Gauss-Markov process of standard deviation ``drift`` and correlation
  time ``drift_s``: pixels, compression, blur, a lens that is not quite as calibrated.

Everything is in units of the white noise: it divides out, and its size follows from the
innovations. The sizes are those of the largest posterior density: the priors say that a position's
noise has a correlated part nearly as large as the white one, which a film of half a minute cannot
exclude; without it, sigmas were half of the errors.

Whether a film's time stamps are those of its pictures.

A program that drops pictures and writes the others 1/25 s apart makes a film whose clock runs slow:
all speeds are too high by the part that is missing. The places tell: over each hole the fish goes
twice as far, or three times, as from any other picture to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib

CORRELATION_BEATS = 4.0
STATES = 8
_FIRST, _SECOND, _DRIFT = 3, 5, 7
# Of the states: what is in a position, and the way that the fish makes from beat to beat. Its
# surge, which comes back with every beat, adds nothing to that; but waves that bend the light over
# the marker are taken for surge.
SEEN_AS = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0])
WAY_AS = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
# Before the first picture: anywhere (in units of the noise), at any speed of a fish.
_WAY_SPREAD, _SPEED_SPREAD, _RISE_SPREAD = 1e6, 1e3, 1e3


@dataclass(frozen=True)
class Models:
    """Parameters in units of the white noise, (n,): ``jerk`` in 1/s^2.5; ``ripple``, ``second``
    and ``drift`` as lengths; ``drift_s`` in s."""

    jerk: F64
    ripple: F64
    second: F64
    drift: F64
    drift_s: F64

    def oscillators(self, beat_s: float) -> tuple[tuple[int, F64, float], ...]:
        """First state, size and frequency of each."""
        return (_FIRST, self.ripple, 1 / beat_s), (_SECOND, self.second, 2 / beat_s)


def steps(dt_s: F64, beat_s: float, by: Models) -> tuple[F64, F64]:
    """Transitions and process noise over times (m,), shape (m, n, 8, 8) each."""
    shape = len(dt_s), len(by.jerk), STATES, STATES
    move, noise = np.zeros(shape), np.zeros(shape)
    d = dt_s[:, None]
    move[:, :, [0, 1, 2], [0, 1, 2]] = 1.0
    move[:, :, 0, 1] = move[:, :, 1, 2] = d
    move[:, :, 0, 2] = d**2 / 2
    wiener = np.array(
        [[d**5 / 20, d**4 / 8, d**3 / 6], [d**4 / 8, d**3 / 3, d**2 / 2], [d**3 / 6, d**2 / 2, d]]
    )
    noise[:, :, :3, :3] = by.jerk[:, None, None] ** 2 * wiener.transpose(2, 3, 0, 1)
    kept = np.exp(-d / (CORRELATION_BEATS * beat_s))
    for at, size, hz in by.oscillators(beat_s):
        angle = 2 * np.pi * hz * d
        move[:, :, at, at] = move[:, :, at + 1, at + 1] = kept * np.cos(angle)
        move[:, :, at, at + 1] = kept * np.sin(angle)
        move[:, :, at + 1, at] = -move[:, :, at, at + 1]
        noise[:, :, at, at] = noise[:, :, at + 1, at + 1] = size**2 * (1 - kept**2)
    kept = np.exp(-d / by.drift_s)
    move[:, :, _DRIFT, _DRIFT] = kept
    noise[:, :, _DRIFT, _DRIFT] = by.drift**2 * (1 - kept**2)
    return move, noise


def prior(beat_s: float, by: Models, first: float) -> tuple[F64, F64]:
    """Mean (n, 8) and covariance (n, 8, 8) at the first node."""
    count = len(by.jerk)
    mean = np.zeros((count, STATES))
    mean[:, 0] = first
    cov = np.zeros((count, STATES, STATES))
    for at, spread in enumerate((_WAY_SPREAD, _SPEED_SPREAD, _RISE_SPREAD)):
        cov[:, at, at] = spread**2
    for at, size, _ in by.oscillators(beat_s):
        cov[:, at, at] = cov[:, at + 1, at + 1] = size**2
    cov[:, _DRIFT, _DRIFT] = by.drift**2
    return mean, cov


@dataclass(frozen=True)
class Forward:
    """A filter pass: innovation^2/variance and log variance summed over what was seen, shape (n,).
    ``nodes``, of one model: mean and covariance of each node as predicted, and as filtered;
    ``moves`` (nodes - 1, 8, 8) between them."""

    chi2: F64
    log_variance: F64
    count: int
    nodes: tuple[F64, ...]
    moves: F64


@dataclass(frozen=True)
class Smoothed:
    """Shape (nodes, 8), (nodes, 8, 8); ``gain[k]`` (8, 8) takes node k+1's smoothing back to k."""

    mean: F64
    cov: F64
    gain: F64


def forward(t_s: F64, way: F64, beat_s: float, by: Models, keep: bool) -> Forward:
    """Filters nodes at rising ``t_s``, shape (nodes,); ``way`` NaN = nothing seen there."""
    lengths, which = np.unique(np.rint(np.diff(t_s) * 1e6), return_inverse=True)
    moves, noises = (one.swapaxes(0, 1).copy() for one in steps(lengths * 1e-6, beat_s, by))
    mean, cov = prior(beat_s, by, float(way[np.isfinite(way)][0]))
    kept = np.empty((len(t_s) if keep else 0, 2, STATES + STATES**2))
    nodes = np.ascontiguousarray(way), which.astype(np.int64), kept
    done = [_filtered(*nodes, *one) for one in zip(mean, cov, moves, noises, strict=True)]
    means, covs = kept[:, :, :STATES], kept[:, :, STATES:].reshape(-1, 2, STATES, STATES)
    return Forward(
        chi2=np.array([one.chi2 for one in done]),
        log_variance=np.array([one.log_variance for one in done]),
        count=done[0].seen - 1,  # the first only says where the way begins
        nodes=(means[:, 0], covs[:, 0], means[:, 1], covs[:, 1]),
        moves=moves[0, which] if keep else moves[0, :0],
    )


def _filtered(
    way: F64, which: NDArray[np.int64], kept: F64, mean: F64, cov: F64, moves: F64, noises: F64
) -> Any:
    """The way_filter_t of one model after all nodes (host/native/way_filter.h)."""
    done = ffi.new("way_filter_t *", (mean.tolist(), cov.ravel().tolist()))
    lib.way_filter_run(
        done, _doubles(way), len(way), _doubles(SEEN_AS), _doubles(moves), _doubles(noises),
        ffi.from_buffer("int64_t[]", which), _doubles(kept) if len(kept) else ffi.NULL,
    )  # fmt: skip
    return done


def _doubles(array: F64) -> object:
    return ffi.from_buffer("double[]", array)


def smooth(done: Forward) -> Smoothed:
    """Rauch, Tung and Striebel's pass over a kept filter pass, in its arrays."""
    predicted, predicted_cov, mean, cov = done.nodes
    crossed = cov[:-1] @ done.moves.transpose(0, 2, 1)
    gain = np.linalg.solve(predicted_cov[1:], crossed.transpose(0, 2, 1)).transpose(0, 2, 1)
    for k in range(len(mean) - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - predicted[k + 1])
        cov[k] += gain[k] @ (cov[k + 1] - predicted_cov[k + 1]) @ gain[k].T
    return Smoothed(mean, cov, np.asarray(gain, np.float64))


_TUNING_PICTURES = 1500
_NOISE_MIN_M = 1e-6  # places of drawn or frozen pictures are exactly equal
# Of the fields of Models; in units of the noise, of a tenth to one millimetre.
_LIMITS = np.log([(1e-2, 1e4), (1e-3, 30), (1e-3, 30), (1e-3, 30), (0.06, 1.0)])
# The middle and the spread of what is expected of drift and drift_s.
_DRIFT_EXPECTED, _DRIFT_SPREAD = np.log([0.7, 0.2]), 0.5
_JERKS, _DRIFTS, _RIPPLES = (3.0, 30.0, 300.0), (0.2, 1.0), (0.1, 1.0, 4.0)
_STEP = 1e-3
_ITERATIONS = 40


def likeliest(
    t_s: F64, way_m: F64, beat_s: float, begin: F64 | None = None
) -> tuple[Models, float, F64]:
    """Of ways at rising times, shape (pictures,): the model (one), the white noise in metres, 1e-6
    or more, and the row of logarithms, which may be the next search's ``begin``. The noise divides
    out (concentrated likelihood); its first guess only sets the scale."""
    stride = -(-len(t_s) // _TUNING_PICTURES)
    t_s, way_m = t_s[::stride], way_m[::stride]
    unit_m = _rough_noise_m(way_m)

    def noise_and_loss(rows: F64) -> tuple[F64, F64]:
        done = forward(t_s, way_m / unit_m, beat_s, Models(*np.exp(rows).T), keep=False)
        variance = done.chi2 / max(done.count, 1)
        noise = np.maximum(variance, (_NOISE_MIN_M / unit_m) ** 2)
        fit = done.count * (np.log(noise) + variance / noise) + done.log_variance
        off = (rows[:, 3:] - _DRIFT_EXPECTED) / _DRIFT_SPREAD
        return np.sqrt(noise), (fit + (off**2).sum(axis=1)) / 2

    if begin is None:
        begins = [(j, r, r, d, 0.2) for j, d, r in product(_JERKS, _DRIFTS, _RIPPLES)]
        rows = np.log(begins)
        begin = rows[np.argmin(noise_and_loss(rows)[1])]
    row = _descend(lambda rows: noise_and_loss(rows)[1], begin)
    noise, _ = noise_and_loss(row[None])
    return Models(*np.exp(row[None]).T), unit_m * float(noise[0]), row


def _descend(loss: Callable[[F64], F64], begin: F64) -> F64:
    """The row of logarithms with the least ``loss``, which takes several at a time."""
    from scipy.optimize import minimize

    def with_slope(at: F64) -> tuple[float, F64]:
        values = loss(np.vstack([at, at + _STEP * np.eye(len(at))]))
        return float(values[0]), (values[1:] - values[0]) / _STEP

    found = minimize(
        with_slope, np.clip(begin, *_LIMITS.T), jac=True, method="L-BFGS-B", bounds=_LIMITS,
        options={"maxiter": _ITERATIONS, "ftol": 3e-7},
    )  # fmt: skip
    return np.asarray(found.x)


def _rough_noise_m(way_m: F64) -> float:
    """From third differences, to which a swimming fish adds little."""
    third = np.diff(way_m, 3)
    rough = float(np.median(np.abs(third))) / 0.6745 / math.sqrt(20.0) if len(third) else 0.0
    return max(rough, 1e-5)


HOLES_MIN = 3
_NEIGHBOURS = 11  # steps among which the usual one is looked for
_CLEAR = 5.0  # standard deviations of a step, that one picture's way is longer than
_WHOLE = 0.35  # how far a step may be from a whole number of pictures
_PICTURES_MAX = 8  # that a hole may lack
_FISH_M_S = 0.3  # what is faster is carried
_BACKWARD = 4  # as many times as there are steps that are too short


def check_stamps(t_s: F64, way_m: F64, name: str) -> None:
    """Raises InputError when pictures are missing between time stamps that do not show it.

    Parameters
    ----------
    t_s, way_m
        Times in s and positions along the swim direction in m of the pictures in which the fish was
        seen, shape (pictures,).
    name
        Of the film, for the message.
    """
    holes, lacking, steps = _holes(t_s, way_m)
    if holes < HOLES_MIN:
        return
    period_s = float(np.median(np.diff(t_s)))
    raise InputError(
        f"{name} lacks pictures, and its time stamps do not show it. At {holes} of {steps} steps"
        f" the fish jumps {lacking / holes:.1f} pictures further, while the stamps stay "
        f"{period_s * 1e3:.0f} ms apart. Speeds would be {lacking / steps:.0%} too high",
        "Record with the camera's own time stamps, for example: tailbeat trial run --video, or "
        "ffmpeg with -use_wallclock_as_timestamps 1 and -fps_mode passthrough.",
    )


def _holes(t_s: F64, way_m: F64) -> tuple[int, int, int]:
    """Steps that are too long by whole pictures, these pictures, and how many steps tell; no holes
    when steps are too short about as often: then places or times are merely noisy."""
    if len(t_s) < 3 * _NEIGHBOURS:
        return 0, 0, 0
    dt_s, step_m = np.diff(t_s), np.diff(way_m)
    edge = _NEIGHBOURS // 2
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(step_m / dt_s, edge, mode="edge"), _NEIGHBOURS
    )
    usual_m_s = np.median(around, axis=1)
    excess_m, picture_m = step_m - usual_m_s * dt_s, usual_m_s * np.median(dt_s)
    sigma_m = 1.4826 * float(np.median(np.abs(excess_m)))
    swims = np.abs(usual_m_s) < _FISH_M_S
    clear = swims & (np.abs(picture_m) > max(_CLEAR * sigma_m, 1e-9))
    pictures = excess_m[clear] / picture_m[clear]
    whole = np.rint(pictures)
    exact = (np.abs(pictures - whole) < _WHOLE) & (np.abs(whole) <= _PICTURES_MAX)
    forward, backward = exact & (whole >= 1), exact & (whole <= -1)
    if np.count_nonzero(forward) <= _BACKWARD * np.count_nonzero(backward):
        return 0, 0, int(clear.sum())
    return int(forward.sum()), int(whole[forward].sum()), int(clear.sum())
