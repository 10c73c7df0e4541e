"""Speeds of a film: from a smoother over the positions along the swim direction (smoother.py).

With 1 mm of noise at 25 frames/s a frame difference is 35 mm/s wrong, a line over one beat
(tracking/live.py) 0.7, this 0.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.csv import table_text
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera.smoother import (
    SEEN_AS,
    STATES,
    WAY_AS,
    Models,
    Smoothed,
    check_stamps,
    forward,
    likeliest,
    smooth,
)
from tailbeat.sensors.camera.tracking.track import BRIDGED_IN_A_ROW_MAX, Track

COVERAGE_MIN = 0.6
SIGMA_MIN_M_S = 1e-5
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

    ``sigma_m_s``: one standard deviation, > 0: it holds the noise found in this film, correlated
    noise included, and what the model cannot follow; a begin that is not exactly known only by
    ``with_begin_sigma``, the calibration only by ``with_scale_sigma``.
    ``direction_rad``: of the trial, against the tank's x. ``noise_m``: white noise of a position,
    as found. ``start_s``: begin of beat 0. ``outliers``: positions
    not believed.
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

    def with_scale_sigma(self, scale_sigma: float) -> SpeedCurve:
        """The same with sigmas that hold, too, that lengths are right within that share only."""
        return replace(self, sigma_m_s=np.hypot(self.sigma_m_s, self.v_m_s * scale_sigma))


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
    40 s of film. Raises InputError when fewer than two beats were seen, and what check_times
    raises."""
    begin_s = float(track.t_s[0]) if start_s is None else start_s
    if start_s is not None and beats is not None:
        track = _cut(track, begin_s - 3 * beat_s, begin_s + (beats + 3) * beat_s)
    seen = _seen(track)
    if direction_rad is None:
        direction_rad = swim_direction_rad(track, beat_s)
    end_s = begin_s + (beats * beat_s if beats is not None else math.inf)
    check_times(track, direction_rad, begin_s, end_s)
    way = _way(track, direction_rad)[seen]
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


def check_times(
    track: Track, direction_rad: float, begin_s: float = -math.inf, end_s: float = math.inf
) -> None:
    """Raises InputError when pictures are missing from ``begin_s`` to ``end_s`` that the time
    stamps do not show (``check_stamps``). Before and after a trial there may be hands."""
    inside = _seen(track) & (track.t_s >= begin_s) & (track.t_s <= end_s)
    way = _way(track, direction_rad)[inside]
    check_stamps(track.t_s[inside], way, track.name or "the film")


def _way(track: Track, direction_rad: float) -> F64:
    return track.x_m * math.cos(direction_rad) + track.y_m * math.sin(direction_rad)


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


def _tune(piece: _Piece, beat_s: float) -> tuple[Models, float]:
    """The likeliest parameters without the positions that they do not believe; wrong ones make the
    noise look larger, so in rounds."""
    t_s, way_m = piece
    row = None
    for _ in range(_OUTLIER_ROUNDS):
        by, noise_m, row = likeliest(t_s, way_m, beat_s, row)
        _, believed = _smooth_without_outliers(t_s, way_m / noise_m, beat_s, by)
        if believed.all():
            break
        t_s, way_m = t_s[believed], way_m[believed]
    return by, noise_m


def _curve(
    piece: _Piece, by: Models, noise_m: float, beat_s: float, start_s: float, period_s: float
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
    t_s: F64, way: F64, beat_s: float, by: Models
) -> tuple[Smoothed, NDArray[np.bool_]]:
    way = way.copy()
    for _ in range(_OUTLIER_ROUNDS):
        done = forward(t_s, way, beat_s, by, keep=True)
        smoothed = smooth(done)
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
    way = (smoothed.mean[end] - smoothed.mean[begin]) @ WAY_AS
    chain = np.broadcast_to(np.eye(STATES), (count, STATES, STATES))
    for step in range(STEPS_PER_BEAT):
        chain = chain @ across[step : step + count]
    shared = np.einsum("i,kij,kjl,l->k", WAY_AS, chain, smoothed.cov[end], WAY_AS)
    own = np.einsum("i,kij,j->k", WAY_AS, smoothed.cov[begin] + smoothed.cov[end], WAY_AS)
    return way / beat_s, np.sqrt(np.maximum(own - 2 * shared, 0.0)) / beat_s


def _products(gain: F64, on_grid: NDArray[np.intp]) -> F64:
    """Of the gains from each node of the grid to the next, shape (grid - 1, 8, 8)."""
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
