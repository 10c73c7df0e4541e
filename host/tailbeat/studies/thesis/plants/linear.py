"""The plants of chapter 2: linear, in discrete time, one input and one output.

The examples of chapter 2 as tasks: plant, law (2.10), distribution of the lengths.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import ExampleOptions, Prepared
from tailbeat.studies.thesis.learner import LearnerConfig
from tailbeat.studies.thesis.options import last_iteration
from tailbeat.studies.thesis.series import LearningProblem, chance, prepared

LAST = 50  # T_d, samples
TIMES: NDArray[np.int64] = np.arange(LAST + 1)
# Of both examples. Its printed third term, sin(50 pi t), is 0 at whole t.
REFERENCE: F64 = np.sin(2 * np.pi * TIMES / 50) + np.sin(2 * np.pi * TIMES / 5)


def reached_probability(times: ArrayLike, earliest: int, masses: Sequence[float]) -> F64:
    """p(t), (2.5): the probability that a trial reaches sample t. Trials end at ``earliest``,
    ``earliest + 1``, … with the probabilities ``masses``."""
    tails = np.append(np.cumsum(np.asarray(masses, np.float64)[::-1])[::-1], 0.0)
    first = np.clip(np.asarray(times, np.int64) - earliest, 0, len(masses))
    return np.where(first == 0, 1.0, tails[first])


@dataclass(frozen=True)
class LinearPlant:
    """(2.1), (2.31): x(t+1) = A(t) x(t) + B u(t), y = C x. ``a``: (samples, states, states)."""

    a: F64
    b: F64
    c: F64

    def respond(self, inputs: F64, start: F64 | None = None) -> F64:
        """Outputs of inputs (series, samples) from the states ``start`` (series, states), or 0."""
        state = np.zeros((len(inputs), len(self.b))) if start is None else start
        outputs = np.empty_like(inputs)
        for t, a in enumerate(self.a):
            outputs[:, t] = state @ self.c
            state = state @ a.T + inputs[:, t, np.newaxis] * self.b
        return outputs

    @property
    def first_markov(self) -> float:
        """CB: what an input does to the next output."""
        return float(self.c @ self.b)

    def exact_input(self) -> F64:
        """u_d: the input that follows the reference exactly from the state 0; one sample less."""
        state = np.zeros(len(self.b))
        found = np.empty(LAST)
        for t in range(LAST):
            free = self.a[t] @ state
            found[t] = (REFERENCE[t + 1] - self.c @ free) / self.first_markov
            state = free + self.b * found[t]
        return found


def _example1() -> LinearPlant:
    """Example 1: CB = 1, zeros at 0.5 and 0.3."""
    a = np.array([[0.5, 0.0, 1.0], [0.15, 0.3, 0.0], [-0.75, 0.25, -0.25]])
    third = np.array([0.0, 0.0, 1.0])
    return LinearPlant(np.broadcast_to(a, (len(TIMES), 3, 3)), third, third)


def _example2() -> LinearPlant:
    """(2.37), as printed: CB = 0.1. Its inverse is unstable, frozen zeros up to -11.7."""
    a = np.zeros((len(TIMES), 3, 3))
    a[:, 0, 0], a[:, 0, 1] = 0.2 * np.exp(-TIMES / 100), -0.6
    a[:, 1, 1], a[:, 1, 2] = 0.5, np.sin(TIMES)
    a[:, 2, 2] = 0.7
    return LinearPlant(a, np.array([1.3, 0.5, 0.6]), np.array([-0.5, 1.5, 0.0]))


_START_STREAM = 1


@dataclass(frozen=True)
class Average:
    """An example of the chapter. ``masses``: probabilities of the lengths 50 - N … 50 + N."""

    plant: LinearPlant
    gain: float  # L
    masses: tuple[float, ...]

    @property
    def spread(self) -> int:
        return len(self.masses) // 2

    def draw(self, seed: int, iteration: int) -> float:
        """T_i in samples: a stream of its own per seed, a value of its own per iteration."""
        at = chance(seed, iteration)
        end = bisect(self._cumulated, at)
        return float(LAST - self.spread + min(end, 2 * self.spread))

    @cached_property
    def _cumulated(self) -> list[float]:
        return list(accumulate(self.masses))

    def reached(self) -> F64:
        """p(t), (2.5), of the reference's samples."""
        return reached_probability(TIMES, LAST - self.spread, self.masses)

    def condition(self) -> float:
        """sup |1 - p(t+1) L C B|, (2.11), (2.32)."""
        gain = self.gain * self.plant.first_markov
        return float(np.abs(1.0 - self.reached()[1:] * gain).max())

    def problem(self, past: str = "mean", random_start: Sequence[int] = ()) -> LearningProblem:
        """(2.10), or with ``past`` "last" the classic (2.3) with the same L. ``random_start``:
        seeds of series that begin in (0, 0, -1), (0, 0, 0) or (0, 0, 1)."""

        def respond(inputs: F64, iteration: int) -> F64:
            start = _random_start(random_start, iteration) if random_start else None
            return self.plant.respond(inputs, start)

        law = LearnerConfig(samples=LAST + 1, kp=self.gain, lead=1, past=past)
        return LearningProblem(TIMES.astype(np.float64), REFERENCE, respond, law, self.draw)


ITERATIONS = 80
KEPT = (0, 5, 20, 40)  # iterations that figures show


def prepare(setting: Average, options: ExampleOptions) -> Prepared:
    """An example of the chapter."""
    last = last_iteration(options.iterations, ITERATIONS)
    return prepared(setting.problem, options, last, "uniform", KEPT)


def _random_start(seeds: Sequence[int], iteration: int) -> F64:
    start = np.zeros((len(seeds), 3))
    start[:, 2] = [int(3 * chance(seed, iteration, _START_STREAM)) - 1 for seed in seeds]
    return start


def _uniform(spread: int) -> tuple[float, ...]:
    ends = 2 * spread + 1
    return (1.0 / ends,) * ends


# The thesis prints C(11, m) for the eleven lengths; only with C(10, m) do they sum to 1.
BINOMIAL = tuple(comb(10, m) * 0.5**10 for m in range(11))

EXAMPLE1 = Average(_example1(), 0.5, _uniform(5))
EXAMPLE1_N30 = replace(EXAMPLE1, masses=_uniform(30))
EXAMPLE2 = Average(_example2(), 2.0, BINOMIAL)
SUBSTITUTE = Average(replace(_example2(), c=np.array([0.0, 0.0, 1.0])), 1.0 / 3.0, BINOMIAL)
"""A and B of (2.37), its third state as the output: CB = 0.6, and a stable inverse."""
