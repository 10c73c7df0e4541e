"""The plant of chapter 7's example (7.31): heat that is carried along and taken up, computed by
host/native/thesis/advection_plant.h.

The plants of chapter 3: one state, in continuous time, the input held over each step.

The examples of chapter 3 as tasks: plant, moving average (3.12), (3.43), lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Literal

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.cut import Outcome, Task, chance, swim
from tailbeat.studies.thesis.heat import CELLS, STEP, times
from tailbeat.studies.thesis.learner import UNLIMITED, LearnerConfig
from tailbeat.studies.thesis.limits import M_MAX, Span
from tailbeat.studies.thesis.native import load

Uptake = Literal["clip", "abs", "monod", "none"]
_UPTAKES: tuple[Uptake, ...] = ("clip", "abs", "monod", "none")  # as advection_uptake_t


class PlantFailed(ArithmeticError):
    """The plant could not be computed to the end of the trial."""


@dataclass(frozen=True)
class AdvectionPlant:
    """(7.31) with g = 1. ``uptake``: phi below v = 0, where the printed one has a pole: ``clip``
    phi(max(v, 0)), ``abs`` -mu*v/(K + abs(v)), ``monod`` as printed, ``none`` no phi at all."""

    step: float = STEP  # min
    uptake: Uptake = "clip"
    carried: float = 2.0  # varsigma
    uptake_max: float = 3.2  # mu_max
    half_at: float = 1.0  # K_s
    inflow: float = 1.0  # g
    cells: int = CELLS

    @property
    def time(self) -> F64:
        """Where the samples are, min."""
        return times(self.step)

    def output(self, values: F64) -> F64:
        """y of a trial.

        Raises:
            PlantFailed: when v jumps the pole of phi, or is not finite any more.
        """
        return self._run(values, None)

    def field(self, values: F64) -> F64:
        """v of a trial, one row per sample, one column per node. Raises as ``output``."""
        field = np.empty((len(self.time), self.cells + 1))
        self._run(values, field)
        return field

    def _run(self, values: F64, field: F64 | None) -> F64:
        native = load("double")
        samples = len(self.time)
        if np.shape(values) != (samples,):
            raise ValueError(f"{np.shape(values)} inputs for {samples} samples")
        plant = native.ffi.new(
            "advection_plant_t *",
            {
                "samples": samples,
                "cells": self.cells,
                "step": self.step,
                "carried": self.carried,
                "uptake_max": self.uptake_max,
                "half_at": self.half_at,
                "inflow": self.inflow,
                "uptake": _UPTAKES.index(self.uptake),
            },
        )
        out = np.empty(samples)

        def pointer(array: F64 | None) -> Any:
            if array is None:
                return native.ffi.NULL
            return native.ffi.cast("double *", native.ffi.from_buffer(array))

        given = np.ascontiguousarray(values, dtype=np.float64)
        done = native.lib.advection_plant_run(plant, pointer(given), pointer(out), pointer(field))
        if done < samples:
            raise PlantFailed(f"v cannot be computed beyond {done * self.step:.2f} min")
        return out


Rate = Callable[[F64, F64], F64]
"""(state, input) -> time derivative of the state."""
Method = Literal["euler", "rk4"]

FISH_DRAG = 31.2485  # alpha = mu/M, 1/m


@dataclass(frozen=True)
class HeldPlant:
    """x' = rate(x, u), y = x, x(0) = 0."""

    rate: Rate
    step: float
    method: Method

    def respond(self, inputs: F64) -> F64:
        """Outputs of inputs (series, samples). An input acts from its own sample on, so that the
        last one moves nothing."""
        advance = self._rk4 if self.method == "rk4" else self._euler
        state = np.zeros(len(inputs))
        outputs = np.empty_like(inputs)
        for k in range(inputs.shape[1]):
            outputs[:, k] = state
            state = advance(state, inputs[:, k])
        return outputs

    def _euler(self, state: F64, held: F64) -> F64:
        return state + self.step * self.rate(state, held)

    def _rk4(self, state: F64, held: F64) -> F64:
        half = 0.5 * self.step
        k1 = self.rate(state, held)
        k2 = self.rate(state + half * k1, held)
        k3 = self.rate(state + half * k2, held)
        k4 = self.rate(state + self.step * k3, held)
        return state + self.step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def example1_rate(x: F64, u: F64) -> F64:
    """Example 1; the input's slope 1 + cos(u)/2 lies in [0.5, 1.5]."""
    return 0.5 * np.cos(x) + u + 0.5 * np.sin(u)


def example1_wanted(t: F64) -> F64:
    return np.sin(2 * np.pi * t) + np.sin(2 * np.pi * t / 5) + np.sin(5 * np.pi * t)


def fish_rate(v: F64, u: F64) -> F64:
    """The fish, with a drag that brakes in either direction."""
    return u - FISH_DRAG * v * np.abs(v)


def fish_rate_printed(v: F64, u: F64) -> F64:
    """As printed: the drag of a fish that swims backwards accelerates it, and v escapes."""
    return u - FISH_DRAG * v * v


def fish_wanted(t: F64) -> F64:
    """m/s; 0.06 at its peak, 25 s."""
    return 48.0 / 50.0**5 * t**2 * (t - 50.0) ** 2


def fish_wanted_input(t: F64) -> F64:
    """u_d, m/s^2: negative where the wanted speed falls faster than drag alone would let it."""
    slope = 48.0 / 50.0**5 * (2.0 * t * (t - 50.0) ** 2 + 2.0 * t**2 * (t - 50.0))
    return slope + FISH_DRAG * fish_wanted(t) ** 2


_STEPS_MAX = 65_534  # a learner's samples, less one
_BUDGET = 20_000_000


def share(m: int) -> float:
    """Of each trial in an average over m + 1."""
    if not 0 <= m <= M_MAX:
        raise InputError(f"m = {m} is out of range.", f"Give one from 0 to {M_MAX}.")
    return 1.0 / (m + 1)


@dataclass(frozen=True)
class Moving:
    """An example of the chapter. The derivative is the forward difference of the samples; a cut
    trial has none across its end. ``history``: what stands for the trials before the first."""

    rate: Rate
    method: Method
    step: float  # of integration and control
    duration: float
    wanted: Callable[[F64], F64]
    draw: Callable[[int, int], float]  # (seed, iteration) -> T_i
    m: int  # m + 1 trials are averaged
    beta: float  # of each of them
    kp: float = 0.0  # -L of (3.43)
    first_input: float = 0.0
    history: str = "zero"
    low: float = -UNLIMITED  # of the input

    @property
    def trial(self) -> Span:
        return Span(self.duration, "s", _STEPS_MAX, _BUDGET)

    def times(self) -> F64:
        """Raises InputError for a step that makes no trial."""
        return np.arange(self.trial.steps(self.step) + 1, dtype=np.float64) * np.float64(self.step)

    def law(self) -> LearnerConfig:
        """(3.12); (3.43) with ``kp``, which looks at the newest trial only."""
        part = share(self.m)
        return LearnerConfig(
            samples=len(self.times()), step=self.step, kp=self.kp, kd=1.0, low=self.low,
            past="window", history=self.history,
            weights=[(part, 1.0 if j == 0 else 0.0, self.beta) for j in range(self.m + 1)],
        )  # fmt: skip

    def task(self) -> Task:
        times = self.times()
        plant = HeldPlant(self.rate, self.step, self.method)

        def respond(inputs: F64, _: int) -> F64:
            return plant.respond(inputs)

        return Task(times, self.wanted(times), respond, self.law(), self.draw, self.first_input)

    def swim(self, seeds: Sequence[int], iterations: int, keep: tuple[int, ...] = ()) -> Outcome:
        """One series per seed, of random lengths."""
        task = self.task()
        return swim(task, [task.length(None, seed) for seed in seeds], iterations, keep=keep)


EXAMPLE1_LENGTHS = NormalDist(2.0, 0.25)
FISH_EARLIEST_S, FISH_LATEST_S = 44.0, 58.0
_LEAST_CHANCE = 2.0**-60  # of which a normal distribution has a finite value


def _normal(seed: int, iteration: int) -> float:
    return max(0.0, EXAMPLE1_LENGTHS.inv_cdf(max(chance(seed, iteration), _LEAST_CHANCE)))


def _uniform(seed: int, iteration: int) -> float:
    return FISH_EARLIEST_S + (FISH_LATEST_S - FISH_EARLIEST_S) * chance(seed, iteration)


EXAMPLE1 = Moving(
    example1_rate, "euler", 0.01, 2.0, example1_wanted, _normal,
    m=4, beta=1.0 / 5.0,
)  # fmt: skip
FISH = Moving(
    fish_rate, "rk4", 0.05, 50.0, fish_wanted, _uniform,
    m=2, beta=1.0 / 3.0, kp=1.0, first_input=0.05,
)  # fmt: skip
