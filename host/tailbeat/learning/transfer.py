"""A curve through means over beats, and its means over other beats.

Within a beat the curve is the parabola that has the beat's mean and the values at its two edges
(fourth order where neighbours allow it, as in the piecewise parabolic method, never beyond the
neighbouring means). What is between two instants is therefore kept: of a speed the distance, of a
thrust the impulse. The means over the curve's own beats come back bit for bit.

Whether one reference is a scaled copy of another: v2(t) = m*v1(s*t).

The exact rule on v' = -alpha*v*|v| + u.

Wanted is v2(t) = m*v1(s*t), m > 0. Then v2' = m*s*v1'(s*t), and the drag is m^2 times that of v1 at
s*t, which is u1 - v1' there; hence

    u2(t) = m^2*u1(s*t) + (m*s - m^2)*v1'(s*t)

for every alpha, which need not be known. With m = s the acceleration drops out: what was learned is
enough. Two transfers in a row are the one by both products. Chapter 4 maps time alone and leaves
the rest to its adaptation; here the drag's square is known, and so nothing is left.

The rule on a fish: amplitudes, one per beat, a dead zone and a delay between them and thrust.

The fish is dv/dt = kappa*(w(t - delay) - v*|v|), w = vss(amplitude)^2 (``model.fishmodel``). The
rule acts on the thrust where it arrives, and the result is commanded a delay earlier:

    w2(t) = m^2*w1(s*t + (s - 1)*delay) + (m*s - m^2)/kappa * v1'(s*(t + delay))

Per beat of the new reference: the mean of both terms, so that a beat's impulse is right. Between
beats w1 is a curve that keeps the impulse of every old beat, v1 one that keeps the distance of the
old reference. The old reference stands for v1 where it was tracked. Where the tail did not push (an
amplitude in the dead zone) it was perhaps not; but there it is known that no thrust was wanted, and
w1 is what the old reference would need by the model, if that is less than none. In a beat that
wants no thrust the amplitude stays what it was, as far as it is in the dead zone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.learning.fish_model import FishModel

_BUMP = 3.0  # times the mean: an edge of more would make the parabola of a beat fall below 0


class BeatCurve:
    """``mean``: float64, shape (beats,). Instants are counted in beats of the curve: beat k is
    [k, k + 1]. Before 0 the curve is 0; beyond the end it stays at ``end``."""

    def __init__(self, mean: F64, end: float | None = None) -> None:
        self.mean = np.asarray(mean, dtype=np.float64)
        self.edge = _edges(self.mean)
        self.end = float(self.edge[-1]) if end is None else end

    def at(self, instant: F64) -> F64:
        """The curve's value at instants of any shape."""
        k = np.clip(np.floor(instant).astype(int), 0, len(self.mean) - 1)
        x = np.clip(instant - k, 0.0, 1.0)
        left, right, mean = self.edge[k], self.edge[k + 1], self.mean[k]
        inside = left + (right - left) * x + 3 * (2 * mean - left - right) * x * (1 - x)
        late = np.where(instant > len(self.mean), self.end, inside)
        return np.asarray(np.where(instant < 0, 0.0, late))

    def means(self, instant: F64) -> F64:
        """Means between neighbours of rising instants, shape (n,) to (n - 1,)."""
        begin, end = instant[:-1, None], instant[1:, None]
        beat = np.arange(len(self.mean), dtype=np.float64)
        area = self._within(np.clip(end - beat, 0, 1)) - self._within(np.clip(begin - beat, 0, 1))
        last = len(self.mean)
        late = np.maximum(end[:, 0] - last, 0.0) - np.maximum(begin[:, 0] - last, 0.0)
        return np.asarray((area.sum(axis=1) + late * self.end) / np.diff(instant))

    def _within(self, x: F64) -> F64:
        """The integral over each beat from its begin to x of it; exactly its mean at 1."""
        left, right = self.edge[:-1], self.edge[1:]
        bend = self.mean * (3 * x**2 - 2 * x**3 - x)
        bend += left * (x**3 - 2 * x**2 + x) + right * (x**3 - x**2)
        return np.asarray(self.mean * x + bend)


def overlap(mean: F64, instant: F64) -> F64:
    """Means of a staircase: as ``BeatCurve.means``, with the last step going on for ever."""
    begin, end = instant[:-1, None], instant[1:, None]
    step = np.arange(len(mean), dtype=np.float64)
    upper = np.append(step[1:], np.inf)
    lower = np.append(-np.inf, step[1:])  # the first step holds before 0, too
    share = np.minimum(end, upper) - np.maximum(begin, lower)
    return np.asarray((np.maximum(share, 0.0) @ mean) / np.diff(instant))


def _edges(mean: F64) -> F64:
    """Values at the n + 1 edges of beats."""
    if len(mean) == 1:
        return np.repeat(mean, 2)
    inner = (mean[:-1] + mean[1:]) / 2
    if len(mean) > 3:
        inner[1:-1] = (7 * (mean[1:-2] + mean[2:-1]) - (mean[:-3] + mean[3:])) / 12
    inner = np.clip(inner, np.minimum(mean[:-1], mean[1:]), np.maximum(mean[:-1], mean[1:]))
    first = 1.5 * mean[0] - 0.5 * mean[1]
    last = 1.5 * mean[-1] - 0.5 * mean[-2]
    edge = np.concatenate([[first], inner, [last]])
    if np.all(mean >= 0):
        most = _BUMP * np.minimum(np.append(mean[0], mean), np.append(mean, mean[-1]))
        edge = np.clip(edge, 0.0, most)
    return edge


# Of the new reference's largest speed. Beat means hide what is within a beat: scaled copies (0.5 to
# 2 times as long) of a trapezoid with ramps of 2, 4, 8 beats fit to 4.2, 2.3, 1.2 %, the thesis's
# profile to 1.2 %; a cosine instead of the trapezoid misses by 7 % and more from 4 beats on.
TOLERANCE = 0.05
_GRID = 41
_ZOOMS = 5
_AS_GOOD = 1.05  # a factor that the durations give is kept while its misfit is no more than this
_TINY = 1e-4  # of the largest speed: misfits that are no more than rounding


@dataclass(frozen=True)
class Similarity:
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


def similarity(old: Reference, new: Reference) -> Similarity:
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
    return Similarity(m, s, float(np.abs(misfit).max()), fit.peak)


class _Fit:
    def __init__(self, old: Reference, new: Reference) -> None:
        self.curve = BeatCurve(old.speed_m_s.astype(np.float64))
        self.wanted = new.speed_m_s.astype(np.float64)
        self.peak = float(self.wanted.max())
        self.old, self.new = old, new

    def scaled(self, s: float) -> tuple[float, F64]:
        """m for a given s, and the misfit per beat."""
        edge: F64 = np.arange(self.new.beats + 1, dtype=np.float64)
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


def scaled_input(
    input_m_s2: ArrayLike,
    acceleration_m_s2: ArrayLike,
    magnitude: float,
    time_factor: float,
) -> F64:
    """u2(t), m/s^2, from u1 and v1' at ``time_factor``*t; arrays of one shape, or anything else in
    one unit (thrust and acceleration, both over alpha). ``magnitude`` m > 0."""
    thrust = magnitude**2 * np.asarray(input_m_s2, dtype=np.float64)
    push = magnitude * (time_factor - magnitude) * np.asarray(acceleration_m_s2, dtype=np.float64)
    return np.asarray(thrust + push)


_GAUSS = np.polynomial.legendre.leggauss(3)  # exact for the square of a parabola


@dataclass(frozen=True)
class Transferred:
    """``amplitude_rad``: float32, one per beat of the new reference, within [0, limit].
    ``saturated_beats``: how many the limit holds back. ``share``: how far the fish comes by the
    model, over how far without the limit; 1 = the limit takes nothing."""

    amplitude_rad: F32
    saturated_beats: int
    share: float


def transfer(
    amplitude_rad: ArrayLike,
    old: Reference,
    new: Reference,
    by: Similarity,
    model: FishModel,
    amplitude_max_rad: float,
) -> Transferred:
    """Amplitudes along ``new`` from those ``learned`` along ``old``, one per beat of it, rad.

    m = s = 1 gives those within the limit back bit for bit. Pure. Raises InputError for a number of
    amplitudes that is not the old reference's, or one that is not finite."""
    learned = np.asarray(amplitude_rad, dtype=np.float64)
    if learned.shape != (old.beats,) or not np.all(np.isfinite(learned)):
        raise InputError(
            f"{learned.size} amplitudes for {old.beats} beats of {old.name}, or not all finite.",
            "Give those of a whole trial along it.",
        )
    per_beat = by.time_factor * new.beat_s / old.beat_s
    delay = model.delay_s / old.beat_s
    edges: F64 = np.arange(new.beats + 1, dtype=np.float64) * per_beat
    sent = edges + (by.time_factor - 1) * delay
    felt = edges + by.time_factor * delay
    speed = BeatCurve(old.speed_m_s.astype(np.float64))
    thrust = _thrust(learned, old, speed, model)
    square = scaled_input(
        BeatCurve(thrust, end=float(thrust[-1])).means(sent),
        np.diff(speed.at(felt)) / (per_beat * old.beat_s * model.kappa_per_m),
        by.magnitude,
        by.time_factor,
    )
    still = np.minimum(overlap(np.minimum(learned, model.dead_zone_rad), sent), model.dead_zone_rad)
    wanted = np.where(square > 0, model.amplitude_of_root(np.sqrt(np.maximum(square, 0.0))), still)
    return _limited(wanted.astype(np.float32), new, model, amplitude_max_rad)


def _thrust(learned: F64, old: Reference, speed: BeatCurve, model: FishModel) -> F64:
    """w1 per old beat, m^2/s^2; below 0 where the tail did not push and the reference falls faster
    than drag alone slows the fish."""
    begin: F64 = np.arange(old.beats, dtype=np.float64) + model.delay_s / old.beat_s
    nodes, weights = _GAUSS
    within = begin[:, None] + (nodes + 1) / 2
    drag = (speed.at(within) ** 2) @ (weights / 2)
    gain = (speed.at(begin + 1) - speed.at(begin)) / (old.beat_s * model.kappa_per_m)
    needed = np.minimum(drag + gain, 0.0)
    pushed = learned > model.dead_zone_rad
    return np.where(pushed, model.thrust(learned), needed)


def _limited(
    wanted: F32, new: Reference, model: FishModel, amplitude_max_rad: float
) -> Transferred:
    limit = np.float32(amplitude_max_rad)
    amplitude = np.clip(wanted, np.float32(0), limit)
    saturated = int(np.count_nonzero(wanted > limit))
    if not saturated:
        return Transferred(amplitude, 0, 1.0)
    free = float(model.beats(wanted, new.beat_s).sum())
    held = float(model.beats(amplitude, new.beat_s).sum())
    return Transferred(amplitude, saturated, held / free if free > 0 else 1.0)
