"""The examples of chapter 2 as tasks: plant, law (2.10), distribution of the lengths."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import comb

import numpy as np

from tailbeat.thesis.arrays import Doubles
from tailbeat.thesis.chapter2 import plants as linear
from tailbeat.thesis.chapter2.plants import LAST, TIMES, WANTED, LinearPlant
from tailbeat.thesis.conditions import contraction, reached_probability
from tailbeat.thesis.cut import Outcome, Task, chance, swim
from tailbeat.thesis.learner import LearnerConfig

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

    def reached(self) -> Doubles:
        """p(t), (2.5), of the wanted samples."""
        return reached_probability(TIMES, LAST, self.spread, self.spread, self.masses)

    def condition(self) -> float:
        """sup |1 - p(t+1) L C B|, (2.11), (2.32)."""
        return contraction(self.reached()[1:], self.gain * self.plant.first_markov)

    def law(self, past: str = "mean") -> LearnerConfig:
        """(2.10), or with ``past`` "last" the classic (2.3) with the same L."""
        return LearnerConfig(samples=LAST + 1, kp=self.gain, lead=1, past=past)

    def task(self, past: str = "mean", random_start: tuple[int, ...] = ()) -> Task:
        """``random_start``: seeds of series that begin in (0, 0, -1), (0, 0, 0) or (0, 0, 1)."""

        def respond(inputs: Doubles, iteration: int) -> Doubles:
            start = _random_start(random_start, iteration) if random_start else None
            return self.plant.respond(inputs, start)

        return Task(TIMES.astype(np.float64), WANTED, respond, self.law(past), self.draw)

    def swim(
        self,
        seeds: range,
        iterations: int,
        past: str = "mean",
        random_start: bool = False,
        keep: Collection[int] = (),
    ) -> Outcome:
        """One series per seed, of random lengths."""
        task = self.task(past, tuple(seeds) if random_start else ())
        return swim(task, [task.length(None, seed) for seed in seeds], iterations, keep=keep)


def _random_start(seeds: tuple[int, ...], iteration: int) -> Doubles:
    start = np.zeros((len(seeds), 3))
    start[:, 2] = [int(3 * chance(seed, iteration, _START_STREAM)) - 1 for seed in seeds]
    return start


def _uniform(spread: int) -> tuple[float, ...]:
    ends = 2 * spread + 1
    return (1.0 / ends,) * ends


# The thesis prints C(11, m) for the eleven lengths; only with C(10, m) do they sum to 1.
BINOMIAL = tuple(comb(10, m) * 0.5**10 for m in range(11))

EXAMPLE1 = Average(linear.example1(), 0.5, _uniform(5))
EXAMPLE1_N30 = replace(EXAMPLE1, masses=_uniform(30))
EXAMPLE2 = Average(linear.example2(), 2.0, BINOMIAL)
SUBSTITUTE = Average(linear.example2_substitute(), 1.0 / 3.0, BINOMIAL)
