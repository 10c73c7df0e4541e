"""What a law does to small errors, by the linearised fish: ratios per iteration over frequency, and
the norm of one step in the input error.

Around a steady cruise the beat means follow the amplitudes by G. A step of the law turns errors of
frequency w into Q(w)*(1 - gain*z**lead*G(w)) times themselves, so a largest absolute value below 1
means that errors of every frequency shrink. Around a whole swim, in the amplitudes of its beats,
the same step is the matrix Q*(I - gain*S*G) with S the lead. Clipping amplitudes to what the tail
can do never takes two inputs further apart (thesis, Property 1), so its norm bounds the saturated
law, too, which no output error does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import BEATS_MAX, Reference
from tailbeat.learning.fish_model import FishModel

Complex = NDArray[np.complex128]

FREQUENCIES = np.linspace(0.0, 0.5, 201)  # cycles/beat
CRUISE = 0.5  # of the highest speed: what the certificate is stated for begins there
SLOW = 0.1  # ... and what else is looked at
_SPEEDS = 5
_FOLDS = 2  # the transform is this much finer than FREQUENCIES, so that it has room for the beats
_FORGOTTEN = 9.0  # exp(-9): what is left of a transient that has settled


def response(model: FishModel, speed_m_s: float, beat_s: float, beats: int = 64) -> F64:
    """Impulse response of beat means to the amplitude of one beat, at a steady speed, m/s/rad.

    Shape (beats,), the beat itself first; its sum is the map's slope. Exact: the model's own
    derivative, taken after the begin of the swim is forgotten. Raises InputError for a speed of 0,
    around which the beat means do not follow small changes.
    """
    if not speed_m_s > 0:
        raise InputError("around standstill there is no response.", "Give a speed above 0.")
    lead_in = min(_settling_beats(model, speed_m_s, beat_s), BEATS_MAX - beats)
    thrust = np.full(lead_in + beats, speed_m_s**2)
    _, by_w, _ = model.distance(thrust, beat_s, start_m_s=speed_m_s, slopes=True)
    assert by_w is not None
    by_amplitude = 2 * speed_m_s * model.slope_m_s_rad
    mean: F64 = np.diff(by_w[:, lead_in])[lead_in:] * by_amplitude / beat_s
    return mean


def _settling_beats(model: FishModel, speed_m_s: float, beat_s: float) -> int:
    decay_per_beat = 2 * model.kappa_per_m * speed_m_s * beat_s
    return math.ceil(model.delay_s / beat_s + _FORGOTTEN / decay_per_beat) + 1


def frequency_response(model: FishModel, speed_m_s: float, beat_s: float) -> Complex:
    """G at FREQUENCIES, m/s/rad. What comes after the computed beats decays evenly, and is summed
    as a geometric series: a slow fish forgets in thousands of beats."""
    beats = min(_settling_beats(model, speed_m_s, beat_s), BEATS_MAX // 2)
    padded = np.zeros(2 * (len(FREQUENCIES) - 1) * _FOLDS)
    padded[:beats] = response(model, speed_m_s, beat_s, beats)
    kept_per_beat = math.exp(-2 * model.kappa_per_m * speed_m_s * beat_s)
    delayed = np.exp(-2j * np.pi * FREQUENCIES)
    rest = padded[beats - 1] * kept_per_beat * delayed**beats / (1 - kept_per_beat * delayed)
    found: Complex = np.fft.rfft(padded)[::_FOLDS] + rest
    return found


def lead_response(lead_beats: float) -> Complex:
    """z**lead at FREQUENCIES; half a beat is the mean of its two neighbours, (1 + z)/2."""
    z: Complex = np.exp(2j * np.pi * FREQUENCIES)
    whole = z ** math.floor(lead_beats)
    return whole if lead_beats == math.floor(lead_beats) else whole * (1 + z) / 2


def filter_response(q_len: int) -> F64:
    """The zero-phase triangle of ``q_len`` at FREQUENCIES, away from the ends of the trial."""
    j = np.arange(1, q_len)
    sides = 2 * np.cos(2 * np.pi * np.outer(FREQUENCIES, j)) @ (q_len - j)
    weight: F64 = (q_len + sides) / q_len**2
    return weight


@dataclass(frozen=True)
class Plants:
    """G of every model at every speed. ``fast``: (models * speeds, frequencies), at the speeds the
    certificate is stated for; ``slow``: at lower ones. ``speeds_m_s``: the former's range."""

    fast: Complex
    slow: Complex
    speeds_m_s: tuple[float, float]
    slow_from_m_s: float

    def ratio(self, gain: float, lead_beats: float, q_len: int) -> F64:
        """|Q*(1 - gain*z**lead*G)| at FREQUENCIES, the worst of models and speeds."""
        return _worst(self.fast, gain, lead_beats, q_len)

    def slow_ratio(self, gain: float, lead_beats: float, q_len: int) -> F64:
        """The same at the lower speeds."""
        return _worst(self.slow, gain, lead_beats, q_len)


def _worst(plants: Complex, gain: float, lead_beats: float, q_len: int) -> F64:
    loops = plants * lead_response(lead_beats)
    squared = (1 - gain * loops.real) ** 2 + (gain * loops.imag) ** 2  # quicker than abs
    ratio: F64 = np.sqrt(squared.max(axis=0)) * np.abs(filter_response(q_len))
    return ratio


def plants_of(
    models: Sequence[FishModel], reference: Reference, amplitude_max_rad: float
) -> Plants:
    """At speeds from half the highest of the reference (or of the fish, if that is less) up to it;
    the slow ones reach down to a tenth."""
    reach = min(float(model.steady_m_s(amplitude_max_rad)) for model in models)
    top = min(float(np.max(reference.speed_m_s)), reach)
    if not top > 0:
        raise InputError(
            "there is no speed to design for: the reference asks for none, or the largest amplitude"
            " gives none.",
            "Look at the reference and at AMP_MAX_RAD, which must be above the dead zone.",
        )

    def at(fractions: F64) -> Complex:
        return np.array(
            [
                frequency_response(model, float(part * top), reference.beat_s)
                for model in models
                for part in fractions
            ]
        )

    slow = np.geomspace(SLOW, CRUISE, _SPEEDS)[:-1]
    fast = np.linspace(CRUISE, 1.0, _SPEEDS)
    return Plants(at(fast), at(slow), (CRUISE * top, top), SLOW * top)


def lead_matrix(beats: int, lead_beats: float, keep_tail: bool = False) -> F64:
    """S: what the law reads of the errors, shape (beats, beats). Beyond the end it is the last
    error, or nothing with ``keep_tail``."""
    whole = math.floor(lead_beats)
    taps = (whole, whole) if lead_beats == whole else (whole, whole + 1)
    matrix = np.zeros((beats, beats))
    for k in range(beats):
        if keep_tail and k + taps[1] > beats - 1:
            continue
        for tap in taps:
            matrix[k, min(k + tap, beats - 1)] += 0.5
    return matrix


def filter_matrix(beats: int, q_len: int) -> F64:
    """Q with its ends renormalised, as the law does it (firmware/ilc/law.h)."""
    apart = np.abs(np.subtract.outer(np.arange(beats), np.arange(beats)))
    weights = np.maximum(q_len - apart, 0).astype(np.float64)
    matrix: F64 = weights / weights.sum(axis=1, keepdims=True)
    return matrix


def swim_jacobian(model: FishModel, amplitude_rad: F64, beat_s: float) -> F64:
    """d beat means / d amplitudes around a swim from rest, shape (beats, beats), m/s/rad."""
    steady = model.steady_m_s(amplitude_rad)
    _, by_w, _ = model.distance(steady**2, beat_s, slopes=True)
    assert by_w is not None
    jacobian: F64 = np.diff(by_w, axis=0) / beat_s * (2 * steady * model.slope_m_s_rad)
    return jacobian


def input_norm(
    model: FishModel,
    amplitude_rad: F64,
    beat_s: float,
    gain: float,
    lead_beats: float,
    q_len: int,
    beats: NDArray[np.bool_],
    keep_tail: bool = False,
) -> float:
    """||Q(I - gain*S*G)||_2 of one step from errors of the amplitudes of ``beats`` alone to those
    of all beats; G around the swim of ``amplitude_rad``. One step puts errors into other beats,
    too, so it says nothing of the next one."""
    count = len(amplitude_rad)
    jacobian = swim_jacobian(model, amplitude_rad, beat_s)
    step = np.eye(count) - gain * lead_matrix(count, lead_beats, keep_tail) @ jacobian
    matrix = filter_matrix(count, q_len) @ step
    return float(np.linalg.norm(matrix[:, beats], 2)) if beats.any() else 1.0
