"""The fish of chapter 8: plant (8.13), reference (8.31) and trials of the law (8.16) on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from tailbeat.core.arrays import F64
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import THESIS_PLATEAU_M_S, thesis_speed
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.studies.thesis.example import ExampleOptions, Prepared
from tailbeat.studies.thesis.learner import UNLIMITED, LearnerConfig
from tailbeat.studies.thesis.options import Span, last_iteration, length_settings
from tailbeat.studies.thesis.series import LearningProblem, always, prepared

AMPLITUDE_MAX_RAD = math.pi / 4
DURATION_S = 40.0
BEAT_S = 1.0
BEATS = 40
TABLE_8_1 = ((math.pi / 4, 0.12762), (7 * math.pi / 36, 0.09282), (5 * math.pi / 36, 0.05117))
TRIAL = Span(DURATION_S, "s", steps_max=65_535, budget=1_000_000_000)
_SUBSTEP_S = 0.01  # finer ones move the slow growth of badly paired laws by a few percent


@dataclass(frozen=True)
class Lags:
    """What the thesis leaves out between command and speed: dead time and a first-order servo on
    the amplitude, a first-order build-up of the thrust."""

    dead_time_s: float = 0.0
    servo_s: float = 0.0
    thrust_s: float = 0.0


class CruisePlant:
    """The plant (8.13), from rest, its amplitude held for samples of ``step_s``. The step is exact
    for thrust held within it; what lags is held for ``_SUBSTEP_S`` at most."""

    def __init__(self, step_s: float, lags: Lags = Lags()) -> None:
        self.lags = lags
        self._parts = math.ceil(step_s / _SUBSTEP_S - 1e-9) if self.lags != Lags() else 1
        self.step_s = step_s / self._parts
        self.config: Any = plant_config("thesis", {})

    def speeds(self, amplitude_rad: F64) -> tuple[F64, F64]:
        """(speed at the end of each sample, mean speed over it), m/s."""
        h1, h2 = self.thrust(self._tail(np.repeat(amplitude_rad, self._parts)))
        h1 = _lagged(h1, self.lags.thrust_s, self.step_s)
        speed, distance = np.empty_like(h1), np.empty_like(h1)
        arrays = [ffi.from_buffer("double[]", a) for a in (h1, h2, speed, distance)]
        lib.cruise_speeds(self.config, *arrays[:2], len(h1), self.step_s, *arrays[2:])
        mean = distance.reshape(-1, self._parts).sum(axis=1) / (self._parts * self.step_s)
        return speed[self._parts - 1 :: self._parts], mean

    def thrust(self, amplitude_rad: F64) -> tuple[F64, F64]:
        """H1, N, and H2, kg/m, of (8.5)-(8.10)."""
        amplitude = np.ascontiguousarray(amplitude_rad, np.float64)
        h1, h2 = np.empty_like(amplitude), np.empty_like(amplitude)
        arrays = [ffi.from_buffer("double[]", a) for a in (amplitude, h1, h2)]
        lib.cruise_thrust(self.config, arrays[0], len(amplitude), *arrays[1:])
        return h1, h2

    def steady_m_s(self, amplitude_rad: F64) -> F64:
        """The speed at which thrust and drag balance."""
        h1, h2 = self.thrust(amplitude_rad)
        return np.asarray(np.sqrt(h1 / (self.config.drag_kg_m + h2)))

    def _tail(self, amplitude_rad: F64) -> F64:
        delay = round(self.lags.dead_time_s / self.step_s)
        delayed = np.r_[np.zeros(delay), amplitude_rad][: len(amplitude_rad)]
        return _lagged(delayed, self.lags.servo_s, self.step_s)


def _lagged(values: F64, lag_s: float, step_s: float) -> F64:
    """First order, from 0, exact for values held within a step."""
    if lag_s <= 0:
        return np.ascontiguousarray(values)
    keep = math.exp(-step_s / lag_s)
    return np.ascontiguousarray(lfilter([1 - keep], [1, -keep], values))


def reference_beats() -> F64:
    """The mean of (8.31) over every beat, m/s, in double."""
    t = np.arange(BEATS + 1) * BEAT_S
    distance = 2.25 / 40.0**4 * (t**5 / 5 - 20 * t**4 + 1600 * t**3 / 3)
    polynomial = np.diff(distance) / BEAT_S
    plateau = (t[:-1] >= 10) & (t[:-1] < 30)
    return np.where(plateau, THESIS_PLATEAU_M_S, polynomial)


@dataclass(frozen=True)
class FishTask:
    """The law (8.16) on the fish. ``step_s`` None: one amplitude per beat, errors are beat means;
    else sampled control, u(k) held from t_k on and paired with e(k + ``pairing``), 1 as it must be,
    0 the trap. ``lead`` in samples more; ``q_len`` of Q; ``lags`` of the fish; ``remembered_sat``:
    whether what is stored is saturated first, as (8.16) has it. ``target``: factor on the
    reference, by iteration. ``first_input``: of iteration 0, rad."""

    gain: float
    step_s: float | None = None
    pairing: int = 1
    lead: float = 0.0
    q_len: int = 1
    tail: str = "error"
    lags: Lags = Lags()
    remembered_sat: bool = True
    target: Callable[[int], float] = always
    first_input: float | F64 = 0.0

    def problem(self) -> LearningProblem:
        """Iteration 0 has no amplitude. Beyond a cut the fish swims on virtually.

        Raises:
            InputError: when no trial can be made of such steps.
        """
        beats = self.step_s is None
        step = BEAT_S if self.step_s is None else self.step_s
        fish = CruisePlant(step, self.lags)
        ends: F64 = step * np.arange(1, trial_samples(self.step_s) + 1, dtype=np.float64)

        def respond(inputs: F64, iteration: int) -> F64:
            both = [fish.speeds(applied(one)) for one in inputs]
            return np.stack([mean if beats else at_end for at_end, mean in both])

        return LearningProblem(
            ends, reference_beats() if beats else thesis_speed(ends), respond,
            self._law(len(ends), step), draw, taught=None if self.pairing else _before,
            target=self.target, first_input=self.first_input,
        )  # fmt: skip

    def _law(self, samples: int, step: float) -> LearnerConfig:
        low, high = (0.0, AMPLITUDE_MAX_RAD) if self.remembered_sat else (-UNLIMITED, UNLIMITED)
        return LearnerConfig(
            samples, step=step, kp=self.gain, lead=self.lead, q_len=self.q_len, tail=self.tail,
            low=low, high=high,
        )  # fmt: skip


def feedback_input(proportional: float, integral: float) -> F64:
    """Amplitudes of a PI controller in its one trial, one per beat: it sees the mean speed of the
    beat before. Gains in rad/(m/s), the second per beat."""
    fish, wanted = CruisePlant(BEAT_S), reference_beats()
    inputs, total, speed = np.zeros(BEATS), 0.0, 0.0
    for k in range(BEATS):
        error = wanted[k] - speed
        total += integral * error
        inputs[k] = np.clip(proportional * error + total, 0.0, AMPLITUDE_MAX_RAD)
        speed = float(fish.speeds(inputs[: k + 1])[1][-1])
    return inputs


def trial_samples(step_s: float | None) -> int:
    """Raises InputError when no trial can be made of such steps."""
    return BEATS if step_s is None else TRIAL.steps(step_s)


def applied(input_rad: F64) -> F64:
    """The amplitude that an input comes to."""
    return np.clip(input_rad, 0.0, AMPLITUDE_MAX_RAD)


def _before(error: F64) -> F64:
    """The error before each sample; the first is 0: fish and reference start from rest."""
    return np.append(0.0, error[:-1])


ITERATIONS = 20
_SHORTEST, _LONGEST = 20, 50  # beats of a trial that is cut at random


def draw(seed: int, iteration: int) -> float:
    """Beats of a trial, U(20, 50), whatever was drawn before; beyond 40 it is a full one."""
    random = np.random.default_rng((seed, iteration))
    return float(random.integers(_SHORTEST, _LONGEST, endpoint=True))


def prepare(gain: float, options: ExampleOptions) -> Prepared:
    """An example of the chapter. A step of None: one amplitude per beat."""
    last = last_iteration(options.iterations, ITERATIONS)
    TRIAL.afford(trial_samples(options.step), last)
    task = FishTask(gain, step_s=options.step)
    lengths = length_settings(options, "full")
    return prepared(task.problem, options, last, whole=BEATS, step=options.step, **lengths)
