"""Speed from positions: a line fitted over one beat (live), and a smoother of a whole film.

Positions along the swim direction are a trend (acceleration is a Wiener process) plus the beat's
own ripple at once and twice the beat frequency, whose size drifts slowly, plus white noise; the
sizes of all four are those that make the film likeliest (ripplefilter.py). With 1 mm of noise at
25 frames/s a frame difference is 35 mm/s wrong, a line over one beat 0.7, this 0.2.
"""

from __future__ import annotations

import csv
import io
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera.speed.ripple_filter import (
    SEEN_AS,
    STATES,
    Candidates,
    Smoothed,
    forward,
    smooth,
)
from tailbeat.sensors.camera.tracking.track import BRIDGED_IN_A_ROW_MAX, Track

LOST_IN_A_ROW_MAX = 5
COVERAGE_MIN = 0.6
_SPAN_SLACK_FRAMES = 0.6
_SIGMA_MIN_M_S = 1e-5
_PLAUSIBLE_M_S = 1.0
_JUMP_M = 0.01  # ten times the noise of a good camera


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """Mean speed over a window of one beat whose middle is ``t_s``; ``sigma_m_s`` > 0."""

    t_s: float
    speed_m_s: float
    sigma_m_s: float


class BeatFit:
    """Feed it positions; it gives a speed for every frame that closes a whole beat.

    The window is one beat long by the frames' time stamps, both ends included (26 frames at
    25 frames/s), within 0.6 of a frame. Nothing comes out of a window with more than 5 frames
    missing in a row or with fewer than 60 % of its frames; a jump no fish can swim (somebody
    carried it back) begins a new window. With ``position_noise_m`` the standard
    deviation follows from it, otherwise from the scatter about the line.
    """

    def __init__(
        self, beat_s: float = 1.0, fps: float = 25.0, position_noise_m: float | None = None
    ) -> None:
        self._beat_s = beat_s
        self._frame_s = 1.0 / fps
        self._noise_m = position_noise_m
        self._frames_min = max(3, math.ceil(COVERAGE_MIN * (round(beat_s * fps) + 1)))
        self._window: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Forgets all positions."""
        self._window.clear()

    def add(self, t_s: float, x_m: float) -> SpeedSample | None:
        """Takes one position; frames that are not newer than the last are dropped."""
        window = self._window
        if not (math.isfinite(t_s) and math.isfinite(x_m)):
            return None
        if window and t_s <= window[-1][0]:
            return None
        if window and abs(x_m - window[-1][1]) > _PLAUSIBLE_M_S * (t_s - window[-1][0]) + _JUMP_M:
            window.clear()
        window.append((t_s, x_m))
        slack_s = _SPAN_SLACK_FRAMES * self._frame_s
        while t_s - window[0][0] > self._beat_s + slack_s:
            window.popleft()
        if len(window) < self._frames_min or t_s - window[0][0] < self._beat_s - slack_s:
            return None
        return self._fit()

    def _fit(self) -> SpeedSample | None:
        """Least squares about the middle; sums of about 26 terms are cheaper than keeping them."""
        window = self._window
        count = len(window)
        begin_s, x0 = window[0]
        gap_max_s = (LOST_IN_A_ROW_MAX + 1.5) * self._frame_s
        st = sx = stt = stx = sxx = last = 0.0
        for t_s, x_m in window:
            t = t_s - begin_s
            x = x_m - x0
            if t - last > gap_max_s:
                return None
            last = t
            st += t
            sx += x
            stt += t * t
            stx += t * x
            sxx += x * x
        vtt = stt - st * st / count
        vtx = stx - st * sx / count
        speed = vtx / vtt
        if self._noise_m is None:
            scatter = max(0.0, sxx - sx * sx / count - speed * vtx)
            variance = scatter / (count - 2)
        else:
            variance = self._noise_m**2
        sigma = max(math.sqrt(variance / vtt), _SIGMA_MIN_M_S)
        return SpeedSample(begin_s + last / 2, speed, sigma)


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
    ``direction_rad``: of the swim, against the tank's x. ``noise_m``: white noise of a position, as
    found. ``start_s``: begin of beat 0. ``outliers``: positions not believed.
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
    """Speeds of all of ``track``; of a swim that began at ``start_s`` (in the track's time,
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
        _Piece(t_s, along)
        for t_s, along in _unbroken(track.t_s[seen], way)
        if len(t_s) and t_s[-1] - t_s[0] >= 2 * beat_s
    ]
    if not pieces:
        raise InputError(
            f"{track.name or 'the film'} shows the fish for less than two beats on end",
            "Look at the track: light, focus, the marker's size in the picture.",
        )
    by, noise_m = _tune(max(pieces, key=lambda piece: len(piece.t_s)), beat_s)
    curves = [_curve(piece, by, noise_m, beat_s, begin_s, 1 / track.fps) for piece in pieces]
    return SpeedCurve(
        t_s=np.concatenate([curve[0] for curve in curves]),
        v_m_s=np.concatenate([curve[1] for curve in curves]),
        sigma_m_s=np.concatenate([curve[2] for curve in curves]),
        beat_s=beat_s,
        start_s=begin_s,
        direction_rad=direction_rad,
        noise_m=noise_m,
        outliers=sum(curve[3] for curve in curves),
    )


def _seen(track: Track) -> NDArray[np.bool_]:
    return np.asarray(track.seen() & np.isfinite(track.x_m) & np.isfinite(track.y_m))


def _cut(track: Track, begin_s: float, end_s: float) -> Track:
    inside = (track.t_s >= begin_s) & (track.t_s <= end_s)
    if not inside.any():
        raise InputError(
            f"the swim is not in {track.name or 'the film'}", "Is this the film of that trial?"
        )
    columns = ("t_s", "x_m", "y_m", "heading_rad", "quality", "state")
    return replace(track, **{name: getattr(track, name)[inside] for name in columns}, glow=None)


def _unbroken(t_s: F64, way: F64) -> Iterator[tuple[F64, F64]]:
    """Pieces in which the fish may have swum all the way."""
    dt, dx = np.diff(t_s), np.abs(np.diff(way))
    ends = np.flatnonzero(dx > _CARRIED_M_S * dt + _CARRIED_M) + 1
    return zip(np.split(t_s, ends), np.split(way, ends), strict=True)


@dataclass(frozen=True)
class _Piece:
    t_s: F64
    way_m: F64


def _tune(piece: _Piece, beat_s: float) -> tuple[Candidates, float]:
    """The likeliest parameters without the positions that they do not believe; wrong ones make the
    noise look larger, so in rounds."""
    for _ in range(_OUTLIER_ROUNDS):
        by, noise_m = likeliest(piece.t_s, piece.way_m, beat_s)
        _, believed = _smooth_without_outliers(piece.t_s, piece.way_m / noise_m, beat_s, by)
        if believed.all():
            break
        piece = _Piece(piece.t_s[believed], piece.way_m[believed])
    return by, noise_m


def _curve(
    piece: _Piece, by: Candidates, noise_m: float, beat_s: float, start_s: float, period_s: float
) -> tuple[F64, F64, F64, int]:
    """Times, speeds, sigmas, and how many positions were not believed."""
    step_s = beat_s / STEPS_PER_BEAT
    first = math.ceil((piece.t_s[0] - start_s) / step_s - 1e-6)
    last = math.floor((piece.t_s[-1] - start_s) / step_s + 1e-6)
    grid_s = start_s + np.arange(first, last + 1) * step_s
    t_s = np.concatenate([piece.t_s, grid_s])
    way = np.concatenate([piece.way_m / noise_m, np.full(len(grid_s), np.nan)])
    order = np.argsort(t_s, kind="stable")
    t_s, way = t_s[order], way[order]
    on_grid = np.flatnonzero(order >= len(piece.t_s))
    smoothed, believed = _smooth_without_outliers(t_s, way, beat_s, by)
    speed, sigma = _mean_speeds(smoothed, on_grid, beat_s)
    middle_s = grid_s[STEPS_PER_BEAT // 2 : len(grid_s) - STEPS_PER_BEAT // 2]
    known = _covered(t_s[believed], middle_s, beat_s, period_s)
    outliers = len(piece.t_s) - int(believed.sum())
    sigma_m_s = np.maximum(sigma[known] * noise_m, _SIGMA_MIN_M_S)
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
    """CSV with COLUMNS, whole or not at all; t_s counts from the begin of the swim, ``trial`` is
    its number, empty when the film is not paired with one (then t_s is the film's own time)."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    zero_s = curve.start_s if trial is not None else 0.0
    for t_s, speed, sigma in zip(curve.t_s, curve.v_m_s, curve.sigma_m_s, strict=True):
        rows.writerow(
            [
                f"{t_s - zero_s:.4f}",
                f"{speed:.6f}",
                f"{sigma:.6f}",
                f"{curve.beat_s:g}",
                "" if trial is None else trial,
            ]
        )
    write_whole(path, text.getvalue())
