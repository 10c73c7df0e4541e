"""What a law is expected to do over many trials, and what one more trial is expected to do, by
models of the identified set and the scatter of swims."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law, update
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.reference import Reference
from tailbeat.learning.fish_model import SIGMA_M_S, Conditions, FishModel, Swim
from tailbeat.learning.fit import Scatter, beat_sigma
from tailbeat.learning.identification import Identified

_SWIMMERS = 40
_SEED = 1
_GAIN_STEP = 1e-3  # of the derivative to the gain
_HALF_NORMAL_MEAN = math.sqrt(2 / math.pi)
_DRAWS = 2000
_EFFECTIVE_BEATS = 10  # misfits of neighbouring beats go together: fewer than there are beats
_COMES_AGAIN = 0.8  # of what a model leaves out, in variance; the rest changes with the amplitudes
_ENDS = (3, 97)
_TINY = 1e-12


@dataclass(frozen=True)
class Series:
    """max|e| per iteration (0 = zero input), m/s, over models and noise: median and 90 % band."""

    median_m_s: F64
    low_m_s: F64
    high_m_s: F64


def expected_series(
    identified: Identified, reference: Reference, law: Law, iterations: int
) -> Series:
    """Simulated, not proved: the board's own law on models of the set in turn, every swim with a
    gain, flow and start speed of its own and noisy speeds. Without the rollback. Deterministic."""
    rng = np.random.default_rng(_SEED)
    sigma = _camera_sigma(identified)
    models = _spread(identified, _SWIMMERS)
    rows = [_learn(m, identified.scatter, reference, law, iterations, sigma, rng) for m in models]
    low, median, high = np.percentile(rows, [5, 50, 95], axis=0)
    return Series(median, low, high)


def _set_of(identified: Identified) -> list[FishModel]:
    return [identified.model, *identified.models]


def _spread(identified: Identified, count: int) -> list[FishModel]:
    """``count`` models, spread over the set."""
    models = identified.models or [identified.model]
    return [models[i * len(models) // count] for i in range(count)]


def _camera_sigma(identified: Identified) -> float:
    seen = [swim.sigma_m_s[swim.measured] for swim in identified.swims]
    known = np.concatenate(seen) if seen else np.empty(0)
    return float(np.median(known)) if known.size else SIGMA_M_S


def draw_conditions(scatter: Scatter, rng: Generator) -> Conditions:
    """How one swim differs from the others."""
    return Conditions(
        start_m_s=abs(rng.normal(0, scatter.start_m_s)),
        flow_m_s=rng.normal(0, scatter.flow_m_s),
        gain=max(rng.normal(1, scatter.gain), 0.0),
    )


def _learn(
    model: FishModel,
    scatter: Scatter,
    reference: Reference,
    law: Law,
    iterations: int,
    sigma_m_s: float,
    rng: Generator,
) -> F64:
    wanted = reference.speed_m_s.astype(np.float64)
    amplitude = first_amplitudes(law, wanted)
    worst = [float(np.abs(wanted).max())]
    for _ in range(iterations):
        recorded = np.clip(amplitude, 0, np.float32(law.amplitude_max_rad)).astype(np.float64)
        speed = model.beats(recorded, reference.beat_s, draw_conditions(scatter, rng))
        error = wanted - speed - rng.normal(0, sigma_m_s, len(wanted))
        worst.append(float(np.abs(error).max()))
        amplitude, _ = update(law, amplitude, error)
    return np.array(worst)


def next_ratio(
    identified: Identified, reference: Reference, swim: Swim, amplitude_rad: F64
) -> tuple[float, float]:
    """90 % interval of (max|e| of the next trial with ``amplitude_rad``) / (that of ``swim``), by
    the models of the set and the scatter of swims.

    ``amplitude_rad``: as the tail will do it, one per beat. What ``swim`` differs from a model is
    divided into what will come again (the model's imperfection) and what was of that swim alone
    (its gain, flow, start and measurement) by how likely each is; models that explain the swim
    badly count less. A sigma that is not known is taken to be the others'. The ends are taken at 3
    and 97 %: the fish itself is never in the set.
    Deterministic. Raises InputError when no beat of ``swim`` was measured.
    """
    wanted = reference.speed_m_s.astype(np.float64)
    seen = swim.measured
    if not seen.any():
        raise InputError("no beat of the swim has a speed.", "Upload the speeds of the trial.")
    swim = _with_sigmas(swim)
    before = float(np.abs(wanted - swim.speed_m_s)[seen].max())
    rng = np.random.default_rng(_SEED)
    guesses = [_Guess.of(model, identified.scatter, swim) for model in _set_of(identified)]
    likely = np.array([guess.log_likelihood for guess in guesses])
    share = np.exp((likely - likely.max()) / max(int(seen.sum()) / _EFFECTIVE_BEATS, 1.0))
    counts = rng.multinomial(_DRAWS, share / share.sum())
    ratios = np.concatenate(
        [
            np.abs(wanted - guess.next_speeds(amplitude_rad, swim, identified.scatter, n, rng))
            .max(axis=1)
            for guess, n in zip(guesses, counts, strict=True)
            if n
        ]
    ) / before  # fmt: skip
    low, high = np.percentile(ratios, _ENDS)
    return float(low), float(high)


def _with_sigmas(swim: Swim) -> Swim:
    """Unmeasured beats may have none; the next swim will measure them, too."""
    known = np.isfinite(swim.sigma_m_s)
    usual = float(np.median(swim.sigma_m_s[known])) if known.any() else SIGMA_M_S
    return replace(swim, sigma_m_s=np.where(known, swim.sigma_m_s, usual))


@dataclass(frozen=True)
class _Guess:
    """One model and what it makes of the measured swim. Variances per beat, (m/s)**2: ``repeats``
    of what comes again, ``alone`` of what does not beyond the conditions."""

    model: FishModel
    misfit_m_s: F64  # measured minus model, (seen,)
    conditions: F64  # beat means by a swim's own gain, start and flow, one sigma each, (beats, 3)
    repeats: F64
    alone: F64
    inverse: F64  # of the misfit's covariance, (seen, seen)
    log_likelihood: float

    @classmethod
    def of(cls, model: FishModel, scatter: Scatter, swim: Swim) -> _Guess:
        seen = swim.measured
        speed, conditions = _conditions_part(model, scatter, swim.amplitude_rad, swim.beat_s)
        misfit = (swim.speed_m_s - speed)[seen]
        imperfect = _imperfection(model, scatter, swim, misfit, conditions)
        alone = swim.sigma_m_s**2 + (1 - _COMES_AGAIN) * imperfect
        repeats = _COMES_AGAIN * imperfect
        total = np.diag(repeats + alone) + conditions @ conditions.T
        inverse: F64 = np.linalg.inv(total[np.ix_(seen, seen)]).astype(np.float64)
        log_precision = float(np.linalg.slogdet(inverse)[1])
        likely = 0.5 * (log_precision - float(misfit @ inverse @ misfit))
        return cls(model, misfit, conditions, repeats, alone, inverse, likely)

    def next_speeds(
        self, amplitude_rad: F64, swim: Swim, scatter: Scatter, count: int, rng: Generator
    ) -> F64:
        """Measured speeds of ``count`` possible next swims, shape (count, beats)."""
        beats, seen = len(self.repeats), swim.measured
        again = rng.standard_normal((count, beats)) * np.sqrt(self.repeats)
        own = self._own(self.conditions, count, rng)
        gap = self.misfit_m_s - (again + own)[:, seen]
        again[:, seen] += gap @ self.inverse * self.repeats[seen]
        speed, conditions = _conditions_part(self.model, scatter, amplitude_rad, swim.beat_s)
        following: F64 = speed + again + self._own(conditions, count, rng)
        return following

    def _own(self, conditions: F64, count: int, rng: Generator) -> F64:
        """What ``count`` swims have of their own, (count, beats), m/s."""
        beats = len(self.alone)
        noise = rng.standard_normal((count, beats)) * np.sqrt(self.alone)
        shared: F64 = rng.standard_normal((count, conditions.shape[1])) @ conditions.T
        return shared + noise


def _imperfection(
    model: FishModel, scatter: Scatter, swim: Swim, misfit: F64, conditions: F64
) -> F64:
    """Variance per beat of what the model leaves out; more than usual when the swim shows it."""
    seen = swim.measured
    usual = beat_sigma(swim, model, scatter) ** 2 - swim.sigma_m_s**2
    explained = np.sum(swim.sigma_m_s[seen] ** 2) + np.sum(conditions[seen] ** 2)
    factor = (misfit @ misfit - explained) / max(float(np.sum(usual[seen])), _TINY)
    scaled: F64 = usual * max(1.0, float(factor))
    return scaled


def _conditions_part(
    model: FishModel, scatter: Scatter, amplitude_rad: F64, beat_s: float
) -> tuple[F64, F64]:
    """Beat means of a usual swim, and what they owe to a sigma of its gain, start and flow."""
    start = scatter.start_m_s * _HALF_NORMAL_MEAN
    speed = model.beats(amplitude_rad, beat_s, Conditions(start))
    more = model.beats(amplitude_rad, beat_s, Conditions(start, gain=1 + _GAIN_STEP))
    still = model.beats(amplitude_rad, beat_s)
    by_gain = (more - speed) / _GAIN_STEP * scatter.gain
    by_start = (speed - still) / _HALF_NORMAL_MEAN * math.sqrt(1 - _HALF_NORMAL_MEAN**2)
    by_flow = np.full(len(speed), scatter.flow_m_s)
    return speed, np.column_stack([by_gain, by_start, by_flow])
