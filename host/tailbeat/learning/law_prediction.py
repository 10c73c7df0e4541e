"""What a law is expected to do over many trials, and what one more trial is expected to do, by
models of the identified set and the scatter of trials.

What a law does to small errors, by the linearised fish: ratios per iteration over frequency, and
the norm of one step in the input error.

Around a steady cruise the beat means follow the amplitudes by G. A step of the law turns errors of
frequency w into Q(w)*(1 - gain*z**lead*G(w)) times themselves, so a largest absolute value below 1
means that errors of every frequency shrink. Around a whole trial, in the amplitudes of its beats,
the same step is the matrix Q*(I - gain*S*G) with S the lead. Clipping amplitudes to what the tail
can do never takes two inputs further apart (thesis, Property 1), so its norm bounds the saturated
law, too, which no output error does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law, update
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.reference import BEATS_MAX, Reference
from tailbeat.learning.fish_model import SIGMA_M_S, Conditions, FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.scatter import Scatter, beat_sigma

_FISH = 40
_SEED = 1
_GAIN_STEP = 1e-3  # of the derivative to the gain
_HALF_NORMAL_MEAN = math.sqrt(2 / math.pi)
_DRAWS = 2000
_EFFECTIVE_BEATS = 10  # misfits of neighbouring beats go together: fewer than there are beats
_COMES_AGAIN = 0.8  # of what a model leaves out, in variance; the rest changes with the amplitudes
_ENDS = (3, 97)
_TINY = 1e-12


@dataclass(frozen=True)
class ExpectedSeries:
    """max|e| per iteration (0 = zero input), m/s, over models and noise: median and 90 % band."""

    median_m_s: F64
    low_m_s: F64
    high_m_s: F64


def expected_series(
    identified: Identified, reference: Reference, law: Law, iterations: int
) -> ExpectedSeries:
    """Simulated, not proved: the board's own law on models of the set in turn, every trial with a
    gain, flow and start speed of its own and noisy speeds. Without the rollback. Deterministic."""
    rng = np.random.default_rng(_SEED)
    sigma = _camera_sigma(identified)
    wanted = reference.speed_m_s.astype(np.float64)
    limit_rad = np.float32(law.amplitude_max_rad)
    largest = np.full((_FISH, iterations + 1), np.abs(wanted).max())
    for i, series in enumerate(largest):
        model = identified.models[i * len(identified.models) // _FISH]
        amplitude = first_amplitudes(law, wanted)
        for trial in range(1, iterations + 1):
            recorded = np.clip(amplitude, 0, limit_rad).astype(np.float64)
            speed = model.beats(recorded, reference.beat_s, identified.scatter.draw(rng))
            error = wanted - speed - rng.normal(0, sigma, len(wanted))
            series[trial] = np.abs(error).max()
            amplitude, _ = update(law, amplitude, error)
    low, median, high = np.percentile(largest, [5, 50, 95], axis=0)
    return ExpectedSeries(median, low, high)


def _camera_sigma(identified: Identified) -> float:
    seen = [trial.sigma_m_s[trial.measured] for trial in identified.trials]
    known = np.concatenate(seen) if seen else np.empty(0)
    return float(np.median(known)) if known.size else SIGMA_M_S


def next_ratio(
    identified: Identified, reference: Reference, trial: TrialSpeeds, amplitude_rad: F64
) -> tuple[float, float]:
    """90 % interval of (max|e| of the next trial with ``amplitude_rad``) / (that of ``trial``), by
    the models of the set and the scatter of trials.

    ``amplitude_rad``: as the tail will do it, one per beat. What ``trial`` differs from a model is
    divided into what will come again (the model's imperfection) and what was of that trial alone
    (its gain, flow, start and measurement) by how likely each is; models that explain the trial
    badly count less. A sigma that is not known is taken to be the others'. The ends are taken at 3
    and 97 %: the fish itself is never in the set.
    Deterministic. Raises InputError when no beat of ``trial`` was measured.
    """
    wanted = reference.speed_m_s.astype(np.float64)
    seen = trial.measured
    if not seen.any():
        raise InputError("the trial has no speed.", "Upload the speeds of the trial.")
    trial = _with_sigmas(trial)
    before = float(np.abs(wanted - trial.speed_m_s)[seen].max())
    rng = np.random.default_rng(_SEED)
    models = [identified.model, *identified.models]
    guesses = [_Guess.of(model, identified.scatter, trial) for model in models]
    likely = np.array([guess.log_likelihood for guess in guesses])
    share = np.exp((likely - likely.max()) / max(int(seen.sum()) / _EFFECTIVE_BEATS, 1.0))
    counts = rng.multinomial(_DRAWS, share / share.sum())
    ratios = np.concatenate(
        [
            np.abs(wanted - guess.next_speeds(amplitude_rad, trial, identified.scatter, n, rng))
            .max(axis=1)
            for guess, n in zip(guesses, counts, strict=True)
            if n
        ]
    ) / before  # fmt: skip
    low, high = np.percentile(ratios, _ENDS)
    return float(low), float(high)


def _with_sigmas(trial: TrialSpeeds) -> TrialSpeeds:
    """Unmeasured beats may have none; the next trial will measure them, too."""
    known = np.isfinite(trial.sigma_m_s)
    usual = float(np.median(trial.sigma_m_s[known])) if known.any() else SIGMA_M_S
    return replace(trial, sigma_m_s=np.where(known, trial.sigma_m_s, usual))


@dataclass(frozen=True)
class _Guess:
    """One model and what it makes of the measured trial. Variances per beat, (m/s)**2: ``repeats``
    of what comes again, ``alone`` of what does not beyond the conditions."""

    model: FishModel
    misfit_m_s: F64  # measured minus model, (seen,)
    conditions: F64  # beat means by a trial's own gain, start and flow, one sigma each, (beats, 3)
    repeats: F64
    alone: F64
    inverse: F64  # of the misfit's covariance, (seen, seen)
    log_likelihood: float

    @classmethod
    def of(cls, model: FishModel, scatter: Scatter, trial: TrialSpeeds) -> _Guess:
        seen = trial.measured
        speed, conditions = _conditions_part(model, scatter, trial.amplitude_rad, trial.beat_s)
        misfit = (trial.speed_m_s - speed)[seen]
        imperfect = _imperfection(model, scatter, trial, misfit, conditions)
        alone = trial.sigma_m_s**2 + (1 - _COMES_AGAIN) * imperfect
        repeats = _COMES_AGAIN * imperfect
        total = np.diag(repeats + alone) + conditions @ conditions.T
        inverse: F64 = np.linalg.inv(total[np.ix_(seen, seen)]).astype(np.float64)
        log_precision = float(np.linalg.slogdet(inverse)[1])
        likely = 0.5 * (log_precision - float(misfit @ inverse @ misfit))
        return cls(model, misfit, conditions, repeats, alone, inverse, likely)

    def next_speeds(
        self, amplitude_rad: F64, trial: TrialSpeeds, scatter: Scatter, count: int, rng: Generator
    ) -> F64:
        """Measured speeds of ``count`` possible next trials, shape (count, beats)."""
        beats, seen = len(self.repeats), trial.measured
        again = rng.standard_normal((count, beats)) * np.sqrt(self.repeats)
        own = self._own(self.conditions, count, rng)
        gap = self.misfit_m_s - (again + own)[:, seen]
        again[:, seen] += gap @ self.inverse * self.repeats[seen]
        speed, conditions = _conditions_part(self.model, scatter, amplitude_rad, trial.beat_s)
        following: F64 = speed + again + self._own(conditions, count, rng)
        return following

    def _own(self, conditions: F64, count: int, rng: Generator) -> F64:
        """What ``count`` trials have of their own, (count, beats), m/s."""
        beats = len(self.alone)
        noise = rng.standard_normal((count, beats)) * np.sqrt(self.alone)
        shared: F64 = rng.standard_normal((count, conditions.shape[1])) @ conditions.T
        return shared + noise


def _imperfection(
    model: FishModel, scatter: Scatter, trial: TrialSpeeds, misfit: F64, conditions: F64
) -> F64:
    """Variance per beat of what the model leaves out; more than usual when the trial shows it."""
    seen = trial.measured
    usual = beat_sigma(trial, model, scatter) ** 2 - trial.sigma_m_s**2
    explained = np.sum(trial.sigma_m_s[seen] ** 2) + np.sum(conditions[seen] ** 2)
    factor = (misfit @ misfit - explained) / max(float(np.sum(usual[seen])), _TINY)
    scaled: F64 = usual * max(1.0, float(factor))
    return scaled


def _conditions_part(
    model: FishModel, scatter: Scatter, amplitude_rad: F64, beat_s: float
) -> tuple[F64, F64]:
    """Beat means of a usual trial, and what they owe to a sigma of its gain, start and flow."""
    start = scatter.start_m_s * _HALF_NORMAL_MEAN
    speed = model.beats(amplitude_rad, beat_s, Conditions(start))
    more = model.beats(amplitude_rad, beat_s, Conditions(start, gain=1 + _GAIN_STEP))
    still = model.beats(amplitude_rad, beat_s)
    by_gain = (more - speed) / _GAIN_STEP * scatter.gain
    by_start = (speed - still) / _HALF_NORMAL_MEAN * math.sqrt(1 - _HALF_NORMAL_MEAN**2)
    by_flow = np.full(len(speed), scatter.flow_m_s)
    return speed, np.column_stack([by_gain, by_start, by_flow])


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
    derivative, taken after the begin of the trial is forgotten. Raises InputError for a speed of 0,
    around which the beat means do not follow small changes.
    """
    if not speed_m_s > 0:
        raise InputError("around standstill there is no response.", "Give a speed above 0.")
    lead_in = min(_settling_beats(model, speed_m_s, beat_s), BEATS_MAX - beats)
    root = float(model.root_at(speed_m_s))
    thrust = np.full(lead_in + beats, root**2)
    _, by_w, _ = model.distance(thrust, beat_s, start_m_s=speed_m_s, slopes=True)
    assert by_w is not None
    by_amplitude = 2 * root * float(model.root_slope(model.amplitude_of_root(root)))
    mean: F64 = np.diff(by_w[:, lead_in])[lead_in:] * by_amplitude / beat_s
    return mean


def _settling_beats(model: FishModel, speed_m_s: float, beat_s: float) -> int:
    forgotten = _FORGOTTEN / _decay_per_beat(model, speed_m_s, beat_s)
    return math.ceil(model.delay_s / beat_s + forgotten) + 1


def _decay_per_beat(model: FishModel, speed_m_s: float, beat_s: float) -> float:
    """The slower of drag and wake."""
    by_drag = model.kappa_per_m * (2 * speed_m_s + model.linear_drag_m_s) * beat_s
    return min(by_drag, beat_s / model.wake_s) if model.wake_share > 0 else by_drag


def frequency_response(model: FishModel, speed_m_s: float, beat_s: float) -> Complex:
    """G at FREQUENCIES, m/s/rad. What comes after the computed beats decays evenly, and is summed
    as a geometric series: a slow fish forgets in thousands of beats."""
    beats = min(_settling_beats(model, speed_m_s, beat_s), BEATS_MAX // 2)
    padded = np.zeros(2 * (len(FREQUENCIES) - 1) * _FOLDS)
    padded[:beats] = response(model, speed_m_s, beat_s, beats)
    kept_per_beat = math.exp(-_decay_per_beat(model, speed_m_s, beat_s))
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


def worst_ratio(plants: Complex, gain: float, lead_beats: float, q_len: int) -> F64:
    """|Q*(1 - gain*z**lead*G)| at FREQUENCIES, the worst of ``plants``."""
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


def lead_matrix(beats: int, lead_beats: float) -> F64:
    """S: what the law reads of the errors, shape (beats, beats); beyond the end the last error."""
    whole = math.floor(lead_beats)
    taps = (whole, whole) if lead_beats == whole else (whole, whole + 1)
    matrix = np.zeros((beats, beats))
    for k in range(beats):
        for tap in taps:
            matrix[k, min(k + tap, beats - 1)] += 0.5
    return matrix


def filter_matrix(beats: int, q_len: int) -> F64:
    """Q with its ends renormalised, as the law does it (firmware/ilc/law.h)."""
    apart = np.abs(np.subtract.outer(np.arange(beats), np.arange(beats)))
    weights = np.maximum(q_len - apart, 0).astype(np.float64)
    matrix: F64 = weights / weights.sum(axis=1, keepdims=True)
    return matrix


def trial_jacobian(model: FishModel, amplitude_rad: F64, beat_s: float) -> F64:
    """d beat means / d amplitudes around a trial from rest, shape (beats, beats), m/s/rad."""
    root = model.root(amplitude_rad)
    _, by_w, _ = model.distance(root**2, beat_s, slopes=True)
    assert by_w is not None
    jacobian: F64 = np.diff(by_w, axis=0) / beat_s * (2 * root * model.root_slope(amplitude_rad))
    return jacobian


def input_norm(
    model: FishModel,
    amplitude_rad: F64,
    beat_s: float,
    gain: float,
    lead_beats: float,
    q_len: int,
    beats: NDArray[np.bool_],
) -> float:
    """||Q(I - gain*S*G)||_2 of one step from errors of the amplitudes of ``beats`` alone to those
    of all beats; G around the trial of ``amplitude_rad``. One step puts errors into other beats,
    too, so it says nothing of the next one."""
    count = len(amplitude_rad)
    jacobian = trial_jacobian(model, amplitude_rad, beat_s)
    step = np.eye(count) - gain * lead_matrix(count, lead_beats) @ jacobian
    matrix = filter_matrix(count, q_len) @ step
    return float(np.linalg.norm(matrix[:, beats], 2)) if beats.any() else 1.0
