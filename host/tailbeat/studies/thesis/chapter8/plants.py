"""The fish of chapter 8: plant (8.13), reference (8.31) and trials of the law (8.16) on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import THESIS_PLATEAU_M_S, thesis_speed
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.studies.thesis.learner import UNLIMITED, Learner, LearnerConfig, Precision
from tailbeat.studies.thesis.options import Span

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

    def __init__(self, step_s: float, lags: Lags | None = None) -> None:

        self.lags = lags or Lags()
        self._parts = math.ceil(step_s / _SUBSTEP_S - 1e-9) if self.lags != Lags() else 1
        self.step_s = step_s / self._parts
        self.config: Any = plant_config("thesis", {})

    def speeds(self, amplitude_rad: F64) -> tuple[F64, F64]:
        """(speed at the end of each sample, mean speed over it), m/s."""
        h1, h2 = self.thrust(self._tail(np.repeat(amplitude_rad, self._parts)))
        h1 = _lagged(h1, self.lags.thrust_s, self.step_s)
        speed, way = np.empty_like(h1), np.empty_like(h1)
        arrays = [ffi.from_buffer("double[]", a) for a in (h1, h2, speed, way)]
        lib.cruise_speeds(self.config, *arrays[:2], len(h1), self.step_s, *arrays[2:])
        mean = way.reshape(-1, self._parts).sum(axis=1) / (self._parts * self.step_s)
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
    from scipy.signal import lfilter

    keep = math.exp(-step_s / lag_s)
    return np.ascontiguousarray(lfilter([1 - keep], [1, -keep], values))


def wanted_at(t_s: F64) -> F64:
    """v_d of (8.31), m/s."""
    return thesis_speed(t_s)


def wanted_beats() -> F64:
    """Its mean over every beat, m/s, in double."""
    t = np.arange(BEATS + 1) * BEAT_S
    way = 2.25 / 40.0**4 * (t**5 / 5 - 20 * t**4 + 1600 * t**3 / 3)
    polynomial = np.diff(way) / BEAT_S
    plateau = (t[:-1] >= 10) & (t[:-1] < 30)
    return np.where(plateau, THESIS_PLATEAU_M_S, polynomial)


@dataclass(frozen=True)
class FishTask:
    """A series of trials. ``step_s`` None: one amplitude per beat, errors are beat means; else
    sampled control, u(k) held from t_k on and paired with e(k + ``pairing``), 1 as it must be, 0
    the trap. ``lead`` in samples more; ``q_len`` of Q; ``lags`` of the fish; ``remembered_sat``:
    whether what is stored is saturated first, as (8.16) has it. ``target``: factor on the
    reference, by iteration; ``length_beats``: of the trial, by iteration."""

    gain: float
    iterations: int
    step_s: float | None = None
    pairing: int = 1
    lead: float = 0.0
    q_len: int = 1
    tail: str = "error"
    lags: Lags | None = None
    remembered_sat: bool = True
    target: Callable[[int], float] | None = None
    length_beats: Callable[[int], float] | None = None
    precision: Precision = "double"

    def samples(self) -> int:
        """Raises InputError when no trial can be made of such steps."""
        return BEATS if self.step_s is None else TRIAL.steps(self.step_s)


@dataclass(frozen=True)
class FishTrial:
    """One iteration. Arrays by sample: ``t_s`` at which the speed is told (the middle of a beat,
    the end of a sample), the amplitude as applied, the speed and the error."""

    iteration: int
    t_s: F64
    amplitude_rad: F64
    speed_m_s: F64
    error_m_s: F64
    length_beats: float
    valid: int  # samples that the trial reached

    @property
    def max_abs_error_m_s(self) -> float:
        """Over the whole reference; beyond a cut the fish swims on virtually."""
        return float(np.max(np.abs(self.error_m_s)))

    @property
    def executed_max_abs_error_m_s(self) -> float:
        return float(np.max(np.abs(self.error_m_s[: self.valid]), initial=0.0))


def trials(task: FishTask) -> Iterator[FishTrial]:
    """Iterations 0 (no amplitude) to ``task.iterations``."""
    samples = task.samples()
    step = BEAT_S if task.step_s is None else task.step_s
    fish = CruisePlant(step, task.lags)
    learner = Learner(_config(task, samples, step), precision=task.precision)
    ends: F64 = step * np.arange(1, samples + 1, dtype=np.float64)
    beats = task.step_s is None
    wanted = wanted_beats() if beats else wanted_at(ends)
    for iteration in range(task.iterations + 1):
        amplitude = np.clip(learner.input(), 0.0, AMPLITUDE_MAX_RAD)
        at_end, mean = fish.speeds(amplitude)
        speed = mean if beats else at_end
        target = wanted * (task.target(iteration) if task.target else 1.0)
        error = target - speed
        length = task.length_beats(iteration) if task.length_beats else float(BEATS)
        valid = min(samples, math.floor(length * BEAT_S / step + 1e-9))
        told = ends - step / 2 if beats else ends
        yield FishTrial(iteration, told, amplitude, speed, error, length, valid)
        if task.pairing == 0:  # e(0) = 0: fish and reference start from rest
            learner.learn(np.r_[0.0, error[:-1]], valid)
        else:
            learner.learn(error, valid)


def _config(task: FishTask, samples: int, step: float) -> LearnerConfig:
    limits = (0.0, AMPLITUDE_MAX_RAD) if task.remembered_sat else (-UNLIMITED, UNLIMITED)
    return LearnerConfig(
        samples,
        step=step,
        kp=task.gain,
        lead=task.lead,
        q_len=task.q_len,
        tail=task.tail,
        low=limits[0],
        high=limits[1],
    )
