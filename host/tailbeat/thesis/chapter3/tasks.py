"""The examples of chapter 3 as tasks: plant, moving average (3.12), (3.43), lengths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from tailbeat.errors import InputError
from tailbeat.thesis.arrays import Doubles
from tailbeat.thesis.chapter3 import plants as continuous
from tailbeat.thesis.chapter3.plants import HeldPlant, Method, Rate
from tailbeat.thesis.cut import Outcome, Task, chance, swim
from tailbeat.thesis.learner import UNLIMITED, LearnerConfig
from tailbeat.thesis.limits import M_MAX, Span

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
    wanted: Callable[[Doubles], Doubles]
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

    def times(self) -> Doubles:
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

        def respond(inputs: Doubles, _: int) -> Doubles:
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
    continuous.example1_rate, "euler", 0.01, 2.0, continuous.example1_wanted, _normal,
    m=4, beta=1.0 / 5.0,
)  # fmt: skip
FISH = Moving(
    continuous.fish_rate, "rk4", 0.05, 50.0, continuous.fish_wanted, _uniform,
    m=2, beta=1.0 / 3.0, kp=1.0, first_input=0.05,
)  # fmt: skip
