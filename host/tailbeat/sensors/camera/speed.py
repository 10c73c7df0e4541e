"""Speeds of a film: a Kalman filter and smoother over the positions along the swim direction.

State: way, speed, acceleration (a Wiener process, spectral density ``jerk`` squared), and two
oscillators at once and twice the beat's frequency, each [in phase, in quadrature], stationary with
standard deviations ``ripple`` and ``second`` and a correlation time of CORRELATION_BEATS. What is
seen is way + both in phase + white noise. Everything is in units of the noise: it divides out, and
its size follows from the innovations.

The sizes of all four are those of the largest likelihood. With 1 mm of noise at 25 frames/s a frame
difference is 35 mm/s wrong, a line over one beat (tracking/live.py) 0.7, this 0.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.csv import table_text
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera.tracking.track import BRIDGED_IN_A_ROW_MAX, Track

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
    """A filter pass: innovation^2/variance and log variance summed over what was seen, shape (n,).
    ``nodes``, of one candidate: mean and covariance of each node as predicted, and as filtered."""

    chi2: F64
    log_variance: F64
    count: int
    nodes: tuple[F64, ...] = ()


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
        [[d**5 / 20, d**4 / 8, d**3 / 6], [d**4 / 8, d**3 / 3, d**2 / 2], [d**3 / 6, d**2 / 2, d]]
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
    for at, spread in enumerate((_WAY_SPREAD, _SPEED_SPREAD, _RISE_SPREAD)):
        cov[:, at, at] = spread**2
    for at, size in ((3, by.ripple), (5, by.second)):
        cov[:, at, at] = cov[:, at + 1, at + 1] = size**2
    return mean, cov


def forward(t_s: F64, way: F64, beat_s: float, by: Candidates, keep: bool) -> Forward:
    """Filters nodes at rising ``t_s``, shape (nodes,); ``way`` NaN = nothing seen there."""
    steps: dict[int, tuple[F64, F64]] = {}  # by their length, which few films have many of
    mean, cov = prior(by, float(way[np.isfinite(way)][0]))
    chi2, log_variance, count = np.zeros(len(by.jerk)), np.zeros(len(by.jerk)), 0
    nodes: list[tuple[F64, ...]] = []
    for k in range(len(t_s)):
        if k:
            microseconds = round((t_s[k] - t_s[k - 1]) * 1e6)
            if microseconds not in steps:
                dt_s = microseconds * 1e-6
                steps[microseconds] = transition(dt_s, beat_s), process_noise(dt_s, beat_s, by)
            step, noise = steps[microseconds]
            mean = mean @ step.T
            cov = step @ cov @ step.T + noise
        predicted = mean, cov
        if np.isfinite(way[k]):
            mean, cov, missed, variance = _see(mean, cov, float(way[k]))
            if count:  # the first only says where the way begins
                chi2 += missed**2 / variance
                log_variance += np.log(variance)
            count += 1
        if keep:
            nodes.append(tuple(part[0] for part in (*predicted, mean, cov)))
    return Forward(chi2, log_variance, count - 1, tuple(map(np.array, zip(*nodes, strict=True))))


def _see(mean: F64, cov: F64, way: float) -> tuple[F64, F64, F64, F64]:
    across = cov @ SEEN_AS
    variance = across @ SEEN_AS + 1.0
    missed = way - mean @ SEEN_AS
    gain = across / variance[:, None]
    mean = mean + gain * missed[:, None]
    cov = cov - gain[:, :, None] * across[:, None, :]
    return mean, cov, missed, variance


def smooth(t_s: F64, beat_s: float, done: Forward) -> Smoothed:
    """Rauch, Tung and Striebel's pass over a kept filter pass, in its arrays."""
    predicted, predicted_cov, mean, cov = done.nodes
    steps = {dt: transition(dt * 1e-6, beat_s) for dt in {round(d * 1e6) for d in np.diff(t_s)}}
    moves = np.array([steps[round(d * 1e6)] for d in np.diff(t_s)])
    crossed = cov[:-1] @ moves.transpose(0, 2, 1)
    gain = np.linalg.solve(predicted_cov[1:], crossed.transpose(0, 2, 1)).transpose(0, 2, 1)
    for k in range(len(t_s) - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - predicted[k + 1])
        cov[k] += gain[k] @ (cov[k + 1] - predicted_cov[k + 1]) @ gain[k].T
    return Smoothed(mean, cov, gain)


COVERAGE_MIN = 0.6
SIGMA_MIN_M_S = 1e-5


_TUNING_PICTURES = 1500
_NOISE_MIN_M = 1e-6  # places of drawn or frozen pictures are exactly equal
# In units of the noise, of about a millimetre: from far below what matters to far above.
_JERK_RANGE, _RIPPLE_RANGE = (1e-2, 1e4), (1e-3, 30.0)
_RATIOS = (10.0, 10.0, 3.0, 3.0, 3.0, 1.6, 1.6, 1.25, 1.25)


def likeliest(t_s: F64, way_m: F64, beat_s: float) -> tuple[Candidates, float]:
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


def _candidates(rows: F64) -> Candidates:
    return Candidates(rows[:, 0], rows[:, 1], rows[:, 2])


def _rough_noise_m(way_m: F64) -> float:
    """From third differences, to which a swimming fish adds little."""
    third = np.diff(way_m, 3)
    rough = float(np.median(np.abs(third))) / 0.6745 / math.sqrt(20.0) if len(third) else 0.0
    return max(rough, 1e-5)


STEPS_PER_BEAT = 10
COLUMNS = ("t_s", "v_m_s", "sigma_m_s", "window_s", "trial")

_WAY_MIN_M = 0.3
_OUTLIER_SIGMA = 5.0
_OUTLIER_ROUNDS = 3
# below what a speed.csv can tell
_CARRIED_M_S, _CARRIED_M = 1.0, 0.03  # nobody swims so; somebody carried the fish


@dataclass(frozen=True)
class SpeedCurve:
    """Mean speed along the swim direction over one beat around ``t_s``, arrays of shape (n,); times
    rise in steps of beat_s/STEPS_PER_BEAT from ``start_s`` (so the middle of beat k is start_s +
    (k + 0.5) beat_s, exactly one of them), less those without a speed (LOST pictures within the
    window: more than five in a row, or fewer than 60 % of them there).

    ``sigma_m_s``: one standard deviation, > 0, honest: it holds the noise found in this film and
    what the model cannot follow; not the calibration's scale, which is wrong for all samples alike,
    and a begin that is not exactly known only by ``with_begin_sigma``.
    ``direction_rad``: of the trial, against the tank's x. ``noise_m``: white noise of a position,
    as found. ``start_s``: begin of beat 0. ``outliers``: positions not believed.
    """

    t_s: F64
    v_m_s: F64
    sigma_m_s: F64
    beat_s: float
    start_s: float
    direction_rad: float
    noise_m: float
    outliers: int = 0

    def beats(self, count: int) -> tuple[F64, F64]:
        """Mean speed and sigma of beats 0..count-1, shape (count,); NaN = not measured."""
        speed, sigma = np.full(count, np.nan), np.full(count, np.nan)
        steps = (self.t_s - self.start_s) / self.beat_s * STEPS_PER_BEAT
        for k, step in enumerate(np.rint(steps).astype(int)):
            beat, within = divmod(step, STEPS_PER_BEAT)
            if within == STEPS_PER_BEAT // 2 and 0 <= beat < count:
                speed[beat], sigma[beat] = self.v_m_s[k], self.sigma_m_s[k]
        return speed, sigma

    def with_begin_sigma(self, sigma_s: float) -> SpeedCurve:
        """The same with sigmas that hold, too, that ``start_s`` is known within ``sigma_s`` only:
        where the speed rises or falls, a wrong begin gives a beat its neighbour's speed."""
        if len(self.t_s) < 2:
            return self
        rise_m_s2 = np.gradient(self.v_m_s, self.t_s)
        return replace(self, sigma_m_s=np.hypot(self.sigma_m_s, rise_m_s2 * sigma_s))


def swim_direction_rad(track: Track, beat_s: float = 1.0) -> float:
    """Where the fish swam, against the tank's x: from its mean place in the first beat to that in
    the last (a body sways with its tail) when that is 0.3 m or more, otherwise the tank's x (0)."""
    seen = _seen(track)
    if np.count_nonzero(seen) < 2:
        return 0.0
    t_s = track.t_s[seen]
    first = seen & (track.t_s < t_s[0] + beat_s - 0.5 / track.fps)
    last = seen & (track.t_s > t_s[-1] - beat_s + 0.5 / track.fps)
    dx = float(track.x_m[last].mean() - track.x_m[first].mean())
    dy = float(track.y_m[last].mean() - track.y_m[first].mean())
    return math.atan2(dy, dx) if math.hypot(dx, dy) >= _WAY_MIN_M else 0.0


def swim_speed(
    track: Track,
    beat_s: float = 1.0,
    start_s: float | None = None,
    direction_rad: float | None = None,
    beats: int | None = None,
) -> SpeedCurve:
    """Speeds of all of ``track``; of a trial that began at ``start_s`` (in the track's time,
    timing/sync.py) and had so many ``beats`` only from three beats before it to three after it.

    ``start_s`` None = the first row's; ``direction_rad`` None = swim_direction_rad. Takes 1 s for
    40 s of film. Raises InputError when fewer than two beats were seen."""
    begin_s = float(track.t_s[0]) if start_s is None else start_s
    if start_s is not None and beats is not None:
        track = _cut(track, begin_s - 3 * beat_s, begin_s + (beats + 3) * beat_s)
    seen = _seen(track)
    if direction_rad is None:
        direction_rad = swim_direction_rad(track, beat_s)
    way = track.x_m[seen] * math.cos(direction_rad) + track.y_m[seen] * math.sin(direction_rad)
    pieces = [
        piece
        for piece in _unbroken(track.t_s[seen], way)
        if len(piece[0]) and piece[0][-1] - piece[0][0] >= 2 * beat_s
    ]
    if not pieces:
        raise InputError(
            f"{track.name or 'the film'} shows the fish for less than two beats on end",
            "Look at the track: light, focus, the marker's size in the picture.",
        )
    by, noise_m = _tune(max(pieces, key=lambda piece: len(piece[0])), beat_s)
    curves = [_curve(piece, by, noise_m, beat_s, begin_s, 1 / track.fps) for piece in pieces]
    *columns, outliers = zip(*curves, strict=True)
    t_s, v_m_s, sigma_m_s = map(np.concatenate, columns)
    return SpeedCurve(t_s, v_m_s, sigma_m_s, beat_s, begin_s, direction_rad, noise_m, sum(outliers))


def _seen(track: Track) -> NDArray[np.bool_]:
    return np.asarray(track.seen() & np.isfinite(track.x_m) & np.isfinite(track.y_m))


def _cut(track: Track, begin_s: float, end_s: float) -> Track:
    inside = (track.t_s >= begin_s) & (track.t_s <= end_s)
    if not inside.any():
        raise InputError(
            f"the trial is not in {track.name or 'the film'}", "Is this the film of that trial?"
        )
    columns = ("t_s", "x_m", "y_m", "heading_rad", "quality", "state")
    return replace(track, **{name: getattr(track, name)[inside] for name in columns}, patch=None)


_Piece = tuple[F64, F64]  # times and way, shape (pictures,) each


def _unbroken(t_s: F64, way_m: F64) -> Iterator[_Piece]:
    """Pieces in which the fish may have moved all the way."""
    dt, dx = np.diff(t_s), np.abs(np.diff(way_m))
    ends = np.flatnonzero(dx > _CARRIED_M_S * dt + _CARRIED_M) + 1
    return zip(np.split(t_s, ends), np.split(way_m, ends), strict=True)


def _tune(piece: _Piece, beat_s: float) -> tuple[Candidates, float]:
    """The likeliest parameters without the positions that they do not believe; wrong ones make the
    noise look larger, so in rounds."""
    t_s, way_m = piece
    for _ in range(_OUTLIER_ROUNDS):
        by, noise_m = likeliest(t_s, way_m, beat_s)
        _, believed = _smooth_without_outliers(t_s, way_m / noise_m, beat_s, by)
        if believed.all():
            break
        t_s, way_m = t_s[believed], way_m[believed]
    return by, noise_m


def _curve(
    piece: _Piece, by: Candidates, noise_m: float, beat_s: float, start_s: float, period_s: float
) -> tuple[F64, F64, F64, int]:
    """Times, speeds, sigmas, and how many positions were not believed."""
    seen_s, way_m = piece
    step_s = beat_s / STEPS_PER_BEAT
    first = math.ceil((seen_s[0] - start_s) / step_s - 1e-6)
    last = math.floor((seen_s[-1] - start_s) / step_s + 1e-6)
    grid_s = start_s + np.arange(first, last + 1) * step_s
    t_s = np.concatenate([seen_s, grid_s])
    way = np.concatenate([way_m / noise_m, np.full(len(grid_s), np.nan)])
    order = np.argsort(t_s, kind="stable")
    t_s, way = t_s[order], way[order]
    on_grid = np.flatnonzero(order >= len(seen_s))
    smoothed, believed = _smooth_without_outliers(t_s, way, beat_s, by)
    speed, sigma = _mean_speeds(smoothed, on_grid, beat_s)
    middle_s = grid_s[STEPS_PER_BEAT // 2 : len(grid_s) - STEPS_PER_BEAT // 2]
    known = _covered(t_s[believed], middle_s, beat_s, period_s)
    outliers = len(seen_s) - int(believed.sum())
    sigma_m_s = np.maximum(sigma[known] * noise_m, SIGMA_MIN_M_S)
    return middle_s[known], speed[known] * noise_m, sigma_m_s, outliers


def _smooth_without_outliers(
    t_s: F64, way: F64, beat_s: float, by: Candidates
) -> tuple[Smoothed, NDArray[np.bool_]]:
    way = way.copy()
    for _ in range(_OUTLIER_ROUNDS):
        done = forward(t_s, way, beat_s, by, keep=True)
        smoothed = smooth(t_s, beat_s, done)
        # What is left behind the smoother is narrower than the noise, so this is generous.
        wrong = np.abs(way - smoothed.mean @ SEEN_AS) > _OUTLIER_SIGMA
        if not wrong.any():
            break
        way[wrong] = np.nan
    return smoothed, np.isfinite(way)


def _mean_speeds(smoothed: Smoothed, on_grid: NDArray[np.intp], beat_s: float) -> tuple[F64, F64]:
    """Over a beat: the way between two nodes of the grid, with its sigma by their covariance,
    cov(i, j) = gain[i] ... gain[j-1] cov[j]."""
    across = _products(smoothed.gain, on_grid)
    count = len(on_grid) - STEPS_PER_BEAT
    begin, end = on_grid[:count], on_grid[STEPS_PER_BEAT:]
    way = (smoothed.mean[end] - smoothed.mean[begin]) @ SEEN_AS
    chain = np.broadcast_to(np.eye(STATES), (count, STATES, STATES))
    for step in range(STEPS_PER_BEAT):
        chain = chain @ across[step : step + count]
    shared = np.einsum("i,kij,kjl,l->k", SEEN_AS, chain, smoothed.cov[end], SEEN_AS)
    own = np.einsum("i,kij,j->k", SEEN_AS, smoothed.cov[begin] + smoothed.cov[end], SEEN_AS)
    return way / beat_s, np.sqrt(np.maximum(own - 2 * shared, 0.0)) / beat_s


def _products(gain: F64, on_grid: NDArray[np.intp]) -> F64:
    """Of the gains from each node of the grid to the next, shape (grid - 1, 7, 7)."""
    found = np.empty((max(len(on_grid) - 1, 0), STATES, STATES))
    for at in range(len(found)):
        product_ = np.eye(STATES)
        for k in range(on_grid[at], on_grid[at + 1]):
            product_ = product_ @ gain[k]
        found[at] = product_
    return found


def _covered(t_s: F64, middle_s: F64, beat_s: float, period_s: float) -> NDArray[np.bool_]:
    """Which windows saw enough of the fish, for the rate the film has there: in dim light a phone
    takes half as many pictures."""
    known = np.zeros(len(middle_s), dtype=bool)
    for k, middle in enumerate(middle_s):
        begin, end = middle - beat_s / 2, middle + beat_s / 2
        about = t_s[(t_s >= begin - beat_s / 2) & (t_s <= end + beat_s / 2)]
        if len(about) < 3:
            continue
        period = max(float(np.median(np.diff(about))), period_s)
        inside = about[(about >= begin - period) & (about <= end + period)]
        gaps = np.diff(np.concatenate([[begin - period / 2], inside, [end + period / 2]]))
        enough = np.sum((inside >= begin) & (inside <= end)) >= COVERAGE_MIN * beat_s / period
        known[k] = enough and gaps.max() <= (BRIDGED_IN_A_ROW_MAX + 1.5) * period
    return known


def write_speeds(curve: SpeedCurve, path: Path, trial: int | None = None) -> None:
    """CSV with COLUMNS, whole or not at all; t_s counts from the begin of the trial, ``trial`` is
    its number, empty when the film is not paired with one (then t_s is the film's own time)."""
    zero_s = curve.start_s if trial is not None else 0.0
    rows = (
        (f"{t_s - zero_s:.4f}", f"{speed:.6f}", f"{sigma:.6f}", f"{curve.beat_s:g}", trial)
        for t_s, speed, sigma in zip(curve.t_s, curve.v_m_s, curve.sigma_m_s, strict=True)
    )
    write_whole(path, table_text(COLUMNS, rows))
