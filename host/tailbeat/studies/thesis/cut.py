"""Series of trials that are cut at lengths of their own: many series at a time, each with a learner
of its own in C, the plant of all of them in numpy."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import ExampleRun
from tailbeat.studies.thesis.learner import Learner, LearnerConfig, LearnerRefused, Precision
from tailbeat.studies.thesis.options import Length, errors_beyond, parse

Respond = Callable[[F64, int], F64]
"""Inputs (series, samples) and the iteration -> outputs (series, samples)."""

_BLOCK = 256  # draws at a time: a generator costs as much as a few hundred of them
_ROUNDING = 1e-9  # of the whole length: a sample at the very end was reached


@dataclass(frozen=True)
class LearningProblem:
    """What is learned, by which law, on which plant. ``draw``: (seed, iteration) -> length of that
    trial, the example's own distribution; ``times`` and lengths in one unit."""

    times: F64
    wanted: F64
    respond: Respond
    law: LearnerConfig
    draw: Callable[[int, int], float]
    first_input: float = 0.0

    def length(self, text: str | None, seed: int) -> Length:
        """The lengths that were asked for; by default the example's own."""
        return parse(text or "uniform", float(self.times[-1]), self.draw, seed)


@dataclass(frozen=True)
class SeriesOutcome:
    """Shapes (series, iterations), with NaN from the iteration on in which a series diverged
    (``diverged``, -1 = it did not): no digit of the wanted output was left in the error, or the
    plant escaped. ``kept``: iteration -> inputs and outputs (series, samples)."""

    max_abs_error: F64
    executed: F64
    lengths: F64
    diverged: NDArray[np.int64]
    kept: dict[int, tuple[F64, F64]] = field(default_factory=dict)

    def run(self, **traces: object) -> ExampleRun:
        """The first series as the run of an example."""
        diverged = int(self.diverged[0])
        end = self.max_abs_error.shape[1] if diverged < 0 else diverged
        return ExampleRun(
            iterations=np.arange(end),
            max_abs_error=self.max_abs_error[0, :end],
            executed=self.executed[0, :end],
            lengths=self.lengths[0, :end],
            diverged=None if diverged < 0 else diverged,
            traces={"kept": self.kept, **traces},
        )


def run_series(
    task: LearningProblem,
    lengths: Sequence[Length],
    iterations: int,
    precision: Precision = "double",
    keep: Collection[int] = (),
) -> SeriesOutcome:
    """Iterations 0 to ``iterations`` of one series per entry of ``lengths``. A sample is reached
    when its time is not beyond the trial's length; the plant goes on virtually to the end.

    Raises:
        LearnerRefused: when the law does not fit the trial.
    """
    return _SeriesRunner(task, lengths, iterations, precision).run(keep)


@lru_cache(maxsize=4096)
def _block(*key: int) -> F64:
    return np.random.default_rng(key).random(_BLOCK)


def chance(seed: int, iteration: int, stream: int = 0) -> float:
    """A uniformly distributed number in [0, 1) of its own for every seed, iteration and stream."""
    return float(_block(seed, stream, iteration // _BLOCK)[iteration % _BLOCK])


class _SeriesRunner:
    def __init__(
        self,
        task: LearningProblem,
        lengths: Sequence[Length],
        iterations: int,
        precision: Precision,
    ):
        samples = len(task.times)
        first = np.full(samples, task.first_input)
        self._task, self._lengths = task, lengths
        self._learners = [Learner(task.law, first, precision) for _ in lengths]
        self._limit = errors_beyond(task.wanted)
        shape = (len(lengths), iterations + 1)
        self._errors, self._executed = np.full(shape, np.nan), np.full(shape, np.nan)
        self._drawn = np.full(shape, np.nan)
        self._diverged = np.full(len(lengths), -1)
        self._inputs = np.zeros((len(lengths), samples))

    def run(self, keep: Collection[int]) -> SeriesOutcome:
        kept = {}
        for i in range(self._errors.shape[1]):
            alive = np.flatnonzero(self._diverged < 0)
            if not alive.size:
                break
            outputs = self._trial(i, alive)
            if i in keep:
                kept[i] = self._inputs.copy(), outputs
            study.tell(i + 1, self._errors.shape[1])
        return SeriesOutcome(self._errors, self._executed, self._drawn, self._diverged, kept)

    def _trial(self, i: int, alive: NDArray[np.int64]) -> F64:
        task = self._task
        for s in alive:
            self._inputs[s] = self._learners[s].input()
            self._drawn[s, i] = self._lengths[s](i)
        with np.errstate(over="ignore", invalid="ignore"):  # a plant may escape
            outputs = task.respond(self._inputs, i)
            errors = task.wanted - outputs
        until = self._drawn[:, i] + _ROUNDING * task.times[-1]
        reached = task.times <= until[:, np.newaxis]
        sizes = np.abs(errors)
        largest = sizes.max(axis=1)
        executed = np.where(reached, sizes, 0.0).max(axis=1)
        measured = np.where(reached, errors, np.nan)
        for s in alive:
            if not largest[s] <= self._limit:
                self._end(s, i)
                continue
            self._errors[s, i], self._executed[s, i] = largest[s], executed[s]
            try:
                self._learners[s].learn(measured[s])
            except LearnerRefused:
                self._end(s, i + 1)
        return outputs

    def _end(self, s: int | np.int64, i: int) -> None:
        self._diverged[s] = i
        self._inputs[s] = 0.0


def first_within(errors: F64, bound: float) -> F64:
    """Per series the first iteration with an error of at most ``bound``; infinite if none has."""
    within = errors <= bound
    return np.where(within.any(axis=1), within.argmax(axis=1), np.inf)


def stays_within(errors: F64, bound: float) -> F64:
    """Per series the iteration from which on no error is above ``bound``; infinite if the last
    one is."""
    above = ~(errors <= bound)
    last = errors.shape[1] - 1 - above[:, ::-1].argmax(axis=1)
    start = np.where(above.any(axis=1), last + 1.0, 0.0)
    return np.where(above[:, -1], np.inf, start)
