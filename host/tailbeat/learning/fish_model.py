"""A fish in eight numbers: dv/dt = kappa*(f(t) - v*|v| - linear*v).

The thrust of an amplitude u is w = (slope*(b + bend*b**2))**2 with b = (u - dead zone)+; a share of
it follows with the time constant of the wake, all of it acts a delay after it was commanded. The
first four numbers describe any fish roughly; the shape, the other four, is 0 for one with quadratic
drag, a straight map and no memory, and a fit takes from it what trials show.

Solved exactly by host/native/drag_model.c. Speeds of a trial are over ground: over water plus the
flow. The thrust's ripple within a beat and the servo are left out; what beat means feel of them
goes into the numbers when they are fitted: on the simulated tank a 40 ms servo makes the slope 3 %
smaller, the dead zone 3 % larger and the delay 16 ms longer.

What the model learns from: one trial, as amplitudes and the speeds they gave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.core.trial_checks import counts
from tailbeat.core.trial_file import Trial

PARAMS = ("kappa_per_m", "slope_m_s_rad", "dead_zone_rad", "delay_s")
SHAPE = ("bend_per_rad", "linear_drag_m_s", "wake_share", "wake_s")
NUMBERS = PARAMS + SHAPE
BY_KAPPA, BY_DELAY, BY_START, BY_LINEAR, BY_SHARE, BY_WAKE_S = range(6)  # of drag_model.h


@dataclass(frozen=True)
class FishModel:
    """``kappa_per_m`` alpha/M, > 0. ``slope_m_s_rad`` root of the thrust over amplitude at the edge
    of ``dead_zone_rad``, > 0. ``delay_s`` from a beat's begin to its thrust, >= 0.
    ``bend_per_rad``: relative change of the slope; where negative the map has a summit.
    ``linear_drag_m_s``: the speed at which linear drag equals the quadratic, >= 0. ``wake_share``
    (0 to 1) of the thrust that follows with the time constant ``wake_s`` (> 0)."""

    kappa_per_m: float
    slope_m_s_rad: float
    dead_zone_rad: float
    delay_s: float
    bend_per_rad: float = 0.0
    linear_drag_m_s: float = 0.0
    wake_share: float = 0.0
    wake_s: float = 1.0

    def root(self, amplitude_rad: ArrayLike) -> F64:
        """Root of the thrust of an amplitude, m/s: what it would settle at without linear drag."""
        beyond = self._beyond(amplitude_rad)
        found: F64 = self.slope_m_s_rad * np.maximum(beyond + self.bend_per_rad * beyond**2, 0.0)
        return found

    def root_slope(self, amplitude_rad: ArrayLike) -> F64:
        """d root / d amplitude, m/s/rad; 0 in the dead zone."""
        beyond = self._beyond(amplitude_rad)
        slope = self.slope_m_s_rad * (1 + 2 * self.bend_per_rad * beyond)
        return np.where(self.root(amplitude_rad) > 0, slope, 0.0)

    def _beyond(self, amplitude_rad: ArrayLike) -> F64:
        found: F64 = np.maximum(
            np.asarray(amplitude_rad, dtype=np.float64) - self.dead_zone_rad, 0.0
        )
        return found

    def thrust(self, amplitude_rad: ArrayLike) -> F64:
        """w of an amplitude, m^2/s^2."""
        squared: F64 = self.root(amplitude_rad) ** 2
        return squared

    def strongest_rad(self, limit_rad: float) -> float:
        """The amplitude up to ``limit_rad`` with the most thrust."""
        summit = self.dead_zone_rad + self._summit()
        return min(limit_rad, summit)

    def _summit(self) -> float:
        return -0.5 / self.bend_per_rad if self.bend_per_rad < 0 else math.inf

    def amplitude_of_root(self, root_m_s: ArrayLike) -> F64:
        """The smallest amplitude of a root; the dead zone's edge for 0, the summit beyond it."""
        part = np.maximum(np.asarray(root_m_s, dtype=np.float64), 0.0) / self.slope_m_s_rad
        inside = np.maximum(1 + 4 * self.bend_per_rad * part, 0.0)
        beyond = np.minimum(2 * part / (1 + np.sqrt(inside)), self._summit())
        found: F64 = self.dead_zone_rad + beyond
        return found

    def steady_m_s(self, amplitude_rad: ArrayLike) -> F64:
        """The speed an amplitude settles at."""
        half = self.linear_drag_m_s / 2
        steady: F64 = np.sqrt(half**2 + self.thrust(amplitude_rad)) - half
        return steady

    def root_at(self, steady_m_s: ArrayLike) -> F64:
        """Root of the thrust that holds a steady speed."""
        speed = np.maximum(np.asarray(steady_m_s, dtype=np.float64), 0.0)
        root: F64 = np.sqrt(speed * (speed + self.linear_drag_m_s))
        return root

    def amplitude_rad(self, steady_m_s: ArrayLike) -> F64:
        """The smallest amplitude that settles at a speed; the dead zone's edge for 0."""
        return self.amplitude_of_root(self.root_at(steady_m_s))

    def straight(self, amplitude_rad: float) -> FishModel:
        """The fish in its first four numbers: the line through the steady speeds up to
        ``amplitude_rad`` that are above a third of the highest."""
        top = float(self.steady_m_s(self.strongest_rad(amplitude_rad)))
        if not top > 0:
            return self
        speed = np.linspace(top / 3, top, 9)
        offset, slope = np.polynomial.polynomial.polyfit(self.amplitude_rad(speed), speed, 1)
        dead_zone_rad = max(-float(offset / slope), 0.0)
        return FishModel(self.kappa_per_m, float(slope), dead_zone_rad, self.delay_s)

    def steady_slope(self, steady_m_s: ArrayLike) -> F64:
        """d steady speed / d amplitude at a steady speed, m/s/rad."""
        root = self.root_at(steady_m_s)
        by_root = 2 * root / (2 * np.asarray(steady_m_s, np.float64) + self.linear_drag_m_s)
        slope: F64 = by_root * self.root_slope(self.amplitude_of_root(root))
        return slope

    def beats(
        self,
        amplitude_rad: ArrayLike,
        beat_s: float,
        conditions: Conditions | None = None,
    ) -> F64:
        """Mean speed over ground per beat, m/s, shape (beats,)."""
        given = conditions or Conditions()
        w = given.gain**2 * self.thrust(amplitude_rad)
        distance, _, _ = self.distance(w, beat_s, given.start_m_s)
        mean: F64 = np.diff(distance) / beat_s + given.flow_m_s
        return mean

    def distance(
        self, w: F64, beat_s: float, start_m_s: float = 0.0, parts: int = 1, slopes: bool = False
    ) -> tuple[F64, F64 | None, F64 | None]:
        """(distance over water, its derivatives to w, those to kappa, delay, start, linear drag,
        wake share and wake time) at the ``beats * parts + 1`` ends of the parts of beats; None
        without ``slopes``. ``w``: thrust per beat, >= 0."""
        w = np.ascontiguousarray(w, dtype=np.float64)
        rows = len(w) * parts + 1
        distance = np.empty(rows)
        by_w = np.empty((rows, len(w))) if slopes else None
        by_model = np.empty((rows, 6)) if slopes else None
        self._solve(w, beat_s, start_m_s, parts, distance, by_w, by_model)
        return distance, by_w, by_model

    def distances(self, w: F64, beat_s: float, start_m_s: Sequence[float]) -> tuple[F64, F64, F64]:
        """``distance`` with slopes at the ends of beats, of trials with the thrusts ``w``, shape
        (trials, beats), and a start each: the same arrays, one after the other."""
        w = np.ascontiguousarray(w, dtype=np.float64)
        count, beats = w.shape
        distance = np.empty((count, beats + 1))
        by_w, by_model = np.empty((count, beats + 1, beats)), np.empty((count, beats + 1, 6))
        for row, start in enumerate(start_m_s):
            self._solve(w[row], beat_s, start, 1, distance[row], by_w[row], by_model[row])
        return distance, by_w, by_model

    def _solve(
        self,
        w: F64,
        beat_s: float,
        start_m_s: float,
        parts: int,
        distance: F64,
        by_w: F64 | None,
        by_model: F64 | None,
    ) -> None:
        def pointer(array: F64 | None) -> object:
            return ffi.NULL if array is None else ffi.from_buffer("double[]", array)

        model = ffi.new(
            "drag_model_t *",
            (self.kappa_per_m, self.delay_s, start_m_s, beat_s, self.linear_drag_m_s,
             self.wake_share, self.wake_s),
        )  # fmt: skip
        if not lib.drag_model_distance(
            model, pointer(w), len(w), parts, pointer(distance), pointer(by_w), pointer(by_model)
        ):
            raise InputError(
                f"the model makes no sense: {self}.",
                "Look at its numbers; identify the fish again.",
            )


@dataclass(frozen=True)
class Conditions:
    """What differs from trial to trial: the speed over water at its begin (>= 0), the flow along
    the tank, and a factor on the root of the thrust (battery, temperature)."""

    start_m_s: float = 0.0
    flow_m_s: float = 0.0
    gain: float = 1.0


SIGMA_M_S = 0.001  # of a beat's speed that tells none


@dataclass(frozen=True)
class TrialSpeeds:
    """All arrays have one value per beat. ``amplitude_rad``: as the tail did it (saturated; 0 where
    the trial was over). ``speed_m_s``: measured over ground, NaN = not measured. ``sigma_m_s``: its
    standard deviation, the measurement's alone. ``reference_crc``, ``trial``: 0 = unknown.
    ``swum_beats``: how many were executed before an early end; None = all."""

    amplitude_rad: F64
    speed_m_s: F64
    sigma_m_s: F64
    beat_s: float = 1.0
    reference_crc: int = 0
    trial: int = 0
    iteration: int = 0
    battery_v: float | None = None
    swum_beats: int | None = None

    @property
    def beats(self) -> int:
        """Length of the trial."""
        return len(self.amplitude_rad)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Beats that have a speed."""
        return np.isfinite(self.speed_m_s)

    def error_m_s(self, wanted_m_s: ArrayLike) -> F32:
        """Reference less speed; NaN = not measured."""
        error: F32 = (np.asarray(wanted_m_s, np.float64) - self.speed_m_s).astype(np.float32)
        return error

    def judged(self, wanted_m_s: ArrayLike) -> bool:
        """Whether it was executed to its end with enough beats measured (``trial_checks``)."""
        return counts(self.error_m_s(wanted_m_s), self.swum_beats is None)


def trial_speeds(trial: Trial) -> TrialSpeeds:
    """From a trial's file. Beats after an early end have amplitude 0 and no speed."""
    beats = trial.beats
    recorded = np.arange(len(beats.applied_rad)) < trial.executed_beats
    amplitude = np.where(recorded & np.isfinite(beats.applied_rad), beats.applied_rad, 0.0)
    speed = np.where(recorded, beats.speed_m_s, np.nan).astype(np.float64)
    known = np.isfinite(beats.sigma_m_s) & (beats.sigma_m_s > 0)
    sigma = np.where(known, beats.sigma_m_s, SIGMA_M_S).astype(np.float64)
    volts = [volt for _, volt in trial.battery_v]
    return TrialSpeeds(
        amplitude_rad=amplitude.astype(np.float64),
        speed_m_s=speed,
        sigma_m_s=sigma,
        beat_s=trial.beat_s,
        reference_crc=trial.reference_crc,
        trial=trial.number,
        iteration=trial.iteration,
        battery_v=float(np.mean(volts)) if volts else None,
        swum_beats=None if recorded.all() else trial.executed_beats,
    )


def last_input(trials: Sequence[TrialSpeeds], beats: int) -> F64:
    """The amplitudes that were executed last, beat by beat, by ``trials`` of one reference: what
    lies beyond an early end is of an earlier trial, NaN where no trial came so far."""
    amplitude = np.full(beats, np.nan)
    for trial in trials:
        end = beats if trial.swum_beats is None else trial.swum_beats
        amplitude[:end] = trial.amplitude_rad[:end]
    return amplitude
