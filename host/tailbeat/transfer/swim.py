"""The rule on a fish: amplitudes, one per beat, a dead zone and a delay between them and thrust.

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
from numpy.typing import ArrayLike, NDArray

from tailbeat.errors import InputError
from tailbeat.model.fishmodel import FishModel
from tailbeat.reference import Reference
from tailbeat.transfer.alike import Likeness
from tailbeat.transfer.beatcurve import BeatCurve, overlap
from tailbeat.transfer.rule import scaled_input

Array = NDArray[np.float64]

_GAUSS = np.polynomial.legendre.leggauss(3)  # exact for the square of a parabola


@dataclass(frozen=True)
class Transferred:
    """``amplitude_rad``: float32, one per beat of the new reference, within [0, limit].
    ``saturated_beats``: how many the limit holds back. ``share``: how far the fish comes by the
    model, over how far without the limit; 1 = the limit takes nothing."""

    amplitude_rad: NDArray[np.float32]
    saturated_beats: int
    share: float


def transfer(
    amplitude_rad: ArrayLike,
    old: Reference,
    new: Reference,
    by: Likeness,
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
    edges: Array = np.arange(new.beats + 1, dtype=np.float64) * per_beat
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
    wanted = np.where(square > 0, model.amplitude_rad(np.sqrt(np.maximum(square, 0.0))), still)
    return _limited(wanted.astype(np.float32), new, model, amplitude_max_rad)


def _thrust(learned: Array, old: Reference, speed: BeatCurve, model: FishModel) -> Array:
    """w1 per old beat, m^2/s^2; below 0 where the tail did not push and the reference falls faster
    than drag alone slows the fish."""
    begin: Array = np.arange(old.beats, dtype=np.float64) + model.delay_s / old.beat_s
    nodes, weights = _GAUSS
    within = begin[:, None] + (nodes + 1) / 2
    drag = (speed.at(within) ** 2) @ (weights / 2)
    gain = (speed.at(begin + 1) - speed.at(begin)) / (old.beat_s * model.kappa_per_m)
    needed = np.minimum(drag + gain, 0.0)
    pushed = learned > model.dead_zone_rad
    return np.where(pushed, model.steady_m_s(learned) ** 2, needed)


def _limited(
    wanted: NDArray[np.float32], new: Reference, model: FishModel, amplitude_max_rad: float
) -> Transferred:
    limit = np.float32(amplitude_max_rad)
    amplitude = np.clip(wanted, np.float32(0), limit)
    saturated = int(np.count_nonzero(wanted > limit))
    if not saturated:
        return Transferred(amplitude, 0, 1.0)
    free = float(model.beats(wanted, new.beat_s).sum())
    held = float(model.beats(amplitude, new.beat_s).sum())
    return Transferred(amplitude, saturated, held / free if free > 0 else 1.0)
