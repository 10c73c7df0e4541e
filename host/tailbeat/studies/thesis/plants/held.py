"""The plants of chapter 3: one state, in continuous time, the input held over each step.

The examples of chapter 3 as tasks: plant, moving average (3.12), (3.43), lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.example import ExampleOptions, Prepared
from tailbeat.studies.thesis.learner import UNLIMITED, LearnerConfig
from tailbeat.studies.thesis.options import M_MAX, Span, last_iteration
from tailbeat.studies.thesis.series import LearningProblem, chance, prepared, uniform

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

    def respond(self, inputs: F64, iteration: int = 0) -> F64:
        """Outputs of inputs (series, samples), the same in every iteration. An input acts from its
        own sample on, so that the last one moves nothing."""
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


def example1_reference(t: F64) -> F64:
    return np.sin(2 * np.pi * t) + np.sin(2 * np.pi * t / 5) + np.sin(5 * np.pi * t)


def fish_rate(v: F64, u: F64) -> F64:
    """The fish, with a drag that brakes in either direction."""
    return u - FISH_DRAG * v * np.abs(v)


def fish_rate_printed(v: F64, u: F64) -> F64:
    """As printed: the drag of a fish that swims backwards accelerates it, and v escapes."""
    return u - FISH_DRAG * v * v


def fish_reference(t: F64) -> F64:
    """m/s; 0.06 at its peak, 25 s."""
    return 48.0 / 50.0**5 * t**2 * (t - 50.0) ** 2


def fish_exact_input(t: F64) -> F64:
    """u_d, m/s^2: negative where the reference falls faster than drag alone would let it."""
    slope = 48.0 / 50.0**5 * (2.0 * t * (t - 50.0) ** 2 + 2.0 * t**2 * (t - 50.0))
    return slope + FISH_DRAG * fish_reference(t) ** 2


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
    reference: Callable[[F64], F64]
    draw: Callable[[int, int], float]  # (seed, iteration) -> T_i
    m: int  # m + 1 trials are averaged
    beta: float  # of each of them
    kp: float = 0.0  # -L of (3.43)
    first_input: float = 0.0
    history: str = "zero"
    low: float = -UNLIMITED  # of the input
    iterations: int = 0  # the last one
    kept: tuple[int, ...] = ()  # iterations that figures show

    @property
    def trial(self) -> Span:
        return Span(self.duration, "s", _STEPS_MAX, _BUDGET)

    def times(self) -> F64:
        """Raises InputError for a step that makes no trial."""
        return np.arange(self.trial.steps(self.step) + 1, dtype=np.float64) * np.float64(self.step)

    def problem(self) -> LearningProblem:
        """The law: (3.12); (3.43) with ``kp``, which looks at the newest trial only."""
        times = self.times()
        part = share(self.m)
        law = LearnerConfig(
            samples=len(times), step=self.step, kp=self.kp, kd=1.0, low=self.low,
            past="window", history=self.history,
            weights=[(part, 1.0 if j == 0 else 0.0, self.beta) for j in range(self.m + 1)],
        )  # fmt: skip
        plant = HeldPlant(self.rate, self.step, self.method)
        reference = self.reference(times)
        return LearningProblem(times, reference, plant.respond, law, self.draw, self.first_input)


def prepare(setting: Moving, options: ExampleOptions) -> Prepared:
    """An example of the chapter. Another m shares the same total gain out among its trials, as 1/5
    and 1/3 do in the two examples, unless beta says otherwise."""
    m = setting.m if options.m is None else options.m
    beta = share(m) if options.beta is None else options.beta
    step = setting.step if options.step is None else options.step
    asked = replace(setting, step=step, m=m, beta=beta)
    last = last_iteration(options.iterations, setting.iterations)
    asked.trial.afford(asked.trial.steps(step), last)
    return prepared(
        asked.problem, options, last, "uniform", setting.kept, beta=beta, m=m, step=step
    )


EXAMPLE1_LENGTHS = NormalDist(2.0, 0.25)
FISH_LENGTHS = uniform(44.0, 58.0)  # s
_LEAST_CHANCE = 2.0**-60  # of which a normal distribution has a finite value


def _normal(seed: int, iteration: int) -> float:
    return max(0.0, EXAMPLE1_LENGTHS.inv_cdf(max(chance(seed, iteration), _LEAST_CHANCE)))


EXAMPLE1 = Moving(
    example1_rate, "euler", 0.01, 2.0, example1_reference, _normal,
    m=4, beta=1.0 / 5.0, iterations=40, kept=(0, 5, 10, 20),
)  # fmt: skip
FISH = Moving(
    fish_rate, "rk4", 0.05, 50.0, fish_reference, FISH_LENGTHS,
    m=2, beta=1.0 / 3.0, kp=1.0, first_input=0.05, iterations=30, kept=(0, 1, 5, 30),
)  # fmt: skip


def contraction(beta: float, trials: int, slopes: tuple[float, float], reached: ArrayLike) -> float:
    """eta_j of (3.13) and (3.36), the same for each of ``trials`` with the gain ``beta``, for an
    input gain c'f_u anywhere in ``slopes`` and samples that are reached with the probabilities
    ``reached``, q(t)."""
    part = 1.0 / trials
    q = np.asarray(reached, np.float64)
    return float(
        max(np.max(np.abs(part - beta * slope) * q + (1.0 - q) * part) for slope in slopes)
    )


def beta_bounds(
    trials: int, missed: float, slopes: tuple[float, float], rho: float
) -> tuple[float, float]:
    """(3.34): the beta_j that contract to ``rho`` over ``trials`` = m + 1 trials when the end is
    missed with a probability of at most ``missed``, alpha_2."""
    low, high = slopes
    share = trials * (1.0 - missed)
    return (1.0 - rho) / (share * low), (1.0 + rho - 2.0 * missed) / (share * high)


def rho_least(missed: float, slopes: tuple[float, float]) -> float:
    """The least rho with which (3.34) leaves any beta_j."""
    low, high = slopes
    return (high + 2.0 * missed * low - low) / (high + low)


def example1_reached() -> list[float]:
    """q(t) = 1 - F(t), (3.6), of example 1's samples."""
    mean = EXAMPLE1_LENGTHS.mean
    return [EXAMPLE1_LENGTHS.cdf(mean + (mean - t)) for t in EXAMPLE1.times()]
