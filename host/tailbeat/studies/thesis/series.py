"""Trial after trial with the laws of host/native/thesis/learner.h: many series at a time, each with
a learner of its own in C, the plant of all of them in numpy. Trials may be cut at random."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import ExampleOptions, ExampleRun, Prepared
from tailbeat.studies.thesis.learner import Learner, LearnerConfig, LearnerRefused, Precision
from tailbeat.studies.thesis.options import Length, errors_beyond, length_settings, parse
from tailbeat.studies.thesis.picture import LINES, Curve, Panel

Respond = Callable[[F64, int], F64]
"""Inputs (series, samples) and the iteration -> outputs (series, samples)."""

_BLOCK = 256  # draws at a time: a generator costs as much as a few hundred of them
_ROUNDING = 1e-9  # of the whole length: a sample at the very end was reached


def full(seed: int, iteration: int) -> float:
    """The length of trials that are never cut."""
    return np.inf


def always(iteration: int) -> float:
    """The reference as it is in every iteration."""
    return 1.0


@dataclass(frozen=True)
class LearningProblem:
    """What is learned, by which law, on which plant. ``draw``: (seed, iteration) -> length of that
    trial, the example's own distribution; ``times`` and lengths in one unit. ``taught``: errors of
    a trial -> what the law gets for them. ``target``: iteration -> factor on the reference.
    ``first_input``: of iteration 0, one for all samples or one each."""

    times: F64
    reference: F64
    respond: Respond
    law: LearnerConfig
    draw: Callable[[int, int], float] = full
    first_input: float | F64 = 0.0
    taught: Callable[[F64], F64] | None = None
    target: Callable[[int], float] = always

    def run(
        self,
        iterations: int,
        lengths: Sequence[Length] = (lambda iteration: np.inf,),
        precision: Precision = "double",
        keep: Collection[int] = (),
    ) -> SeriesOutcome:
        """Iterations 0 to ``iterations`` of one series per entry of ``lengths``, by default of one
        uncut series. A sample is reached when its time is not beyond the trial's length; the plant
        goes on virtually to the end.

        Raises:
            LearnerRefused: when the law does not fit the trial.
        """
        return _SeriesRunner(self, lengths, iterations, precision).run(keep)

    def series(
        self, seeds: Iterable[int], iterations: int, keep: Collection[int] = ()
    ) -> SeriesOutcome:
        """One series per seed, of random lengths."""
        return self.run(iterations, [partial(self.draw, seed) for seed in seeds], keep=keep)

    def uncut(self, iterations: int) -> F64:
        """Errors of a series of full trials."""
        errors: F64 = self.run(iterations).max_abs_error[0]
        return errors


@dataclass(frozen=True)
class SeriesOutcome:
    """Shapes (series, iterations), with NaN from the iteration on in which a series diverged
    (``diverged``, -1 = it did not): no digit of the reference was left in the error, or the
    plant escaped. ``kept``: iteration -> inputs and outputs (series, samples); the last one that
    could be computed is always among them."""

    problem: LearningProblem
    max_abs_error: F64
    executed: F64
    lengths: F64
    diverged: NDArray[np.int64]
    kept: dict[int, tuple[F64, F64]] = field(default_factory=dict)

    def example_run(self, cut: bool) -> ExampleRun:
        """The first series as the run of an example. ``cut``: whether its trials may be."""
        diverged = int(self.diverged[0])
        end = self.max_abs_error.shape[1] if diverged < 0 else diverged
        return ExampleRun(
            iterations=np.arange(end),
            max_abs_error=self.max_abs_error[0, :end],
            executed=self.executed[0, :end] if cut else None,
            lengths=self.lengths[0, :end] if cut else None,
            diverged=None if diverged < 0 else diverged,
            traces=self,
        )

    def trial(self, iteration: int | None = None) -> tuple[F64, F64]:
        """Input and output of the first series in a kept iteration, by default the last one."""
        inputs, outputs = self.kept[max(self.kept) if iteration is None else iteration]
        return inputs[0], outputs[0]


def prepared(
    problem: Callable[[], LearningProblem],
    options: ExampleOptions,
    last: int,
    usual: str | None = None,
    keep: Collection[int] = (),
    whole: float | None = None,
    **settings: Any,
) -> Prepared:
    """An example that is one series. ``usual``: lengths where the options name none; None = uncut.
    ``whole``: length of a full trial, by default the last sample's time. ``settings``: beside
    iterations and lengths."""
    text = options.lengths or usual
    if usual is not None:
        settings |= length_settings(options, usual)

    def run() -> ExampleRun:
        made = problem()
        end = float(made.times[-1]) if whole is None else whole
        length = parse(text or "full", end, made.draw, options.seed)
        return made.run(last, [length], options.precision, keep).example_run(text is not None)

    return Prepared({"iterations": last, **settings}, run)


@lru_cache(maxsize=4096)
def _block(*key: int) -> F64:
    return np.random.default_rng(key).random(_BLOCK)


def chance(seed: int, iteration: int, stream: int = 0) -> float:
    """A uniformly distributed number in [0, 1) of its own for every seed, iteration and stream."""
    return float(_block(seed, stream, iteration // _BLOCK)[iteration % _BLOCK])


def uniform(shortest: float, longest: float) -> Callable[[int, int], float]:
    """Lengths that are uniformly distributed: (seed, iteration) -> length."""
    return lambda seed, iteration: shortest + (longest - shortest) * chance(seed, iteration)


class _SeriesRunner:
    def __init__(
        self,
        problem: LearningProblem,
        lengths: Sequence[Length],
        iterations: int,
        precision: Precision,
    ):
        samples = len(problem.times)
        first = np.full(samples, problem.first_input)
        self._problem, self._lengths = problem, lengths
        self._learners = [Learner(problem.law, first, precision) for _ in lengths]
        self._limit = errors_beyond(problem.reference)
        self._errors, self._executed, self._drawn = np.full(
            (3, len(lengths), iterations + 1), np.nan
        )
        self._diverged = np.full(len(lengths), -1)
        self._inputs = np.zeros((len(lengths), samples))

    def run(self, keep: Collection[int]) -> SeriesOutcome:
        kept: dict[int, tuple[F64, F64]] = {}
        count = self._errors.shape[1]
        for i in range(count):
            alive = np.flatnonzero(self._diverged < 0)
            if not alive.size:
                break
            trial = self._trial(i, alive, learns=i + 1 < count)
            if np.isfinite(self._errors[:, i]).any():
                kept = {n: one for n, one in kept.items() if n in keep} | {i: trial}
            study.report_progress(i + 1, count)
        return SeriesOutcome(
            self._problem, self._errors, self._executed, self._drawn, self._diverged, kept
        )

    def _trial(self, i: int, alive: NDArray[np.int64], learns: bool) -> tuple[F64, F64]:
        problem = self._problem
        for s in alive:
            self._inputs[s] = self._learners[s].input()
            self._drawn[s, i] = self._lengths[s](i)
        inputs = self._inputs.copy()
        with np.errstate(over="ignore", invalid="ignore"):  # a plant may escape
            outputs = problem.respond(inputs, i)
            errors = problem.reference * problem.target(i) - outputs
        until = self._drawn[:, i] + _ROUNDING * problem.times[-1]
        reached = problem.times <= until[:, np.newaxis]
        sizes = np.abs(errors)
        largest = sizes.max(axis=1)
        executed = np.where(reached, sizes, 0.0).max(axis=1)
        for s in alive:
            if not largest[s] <= self._limit:
                self._end(s, i)
                continue
            self._errors[s, i], self._executed[s, i] = largest[s], executed[s]
            taught = errors[s] if problem.taught is None else problem.taught(errors[s])
            try:
                if learns:
                    self._learners[s].learn(np.where(reached[s], taught, np.nan))
            except LearnerRefused:
                self._end(s, i + 1)
        return inputs, outputs

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


def error_profiles(found: SeriesOutcome, iterations: Sequence[int], time: str, name: str) -> Panel:
    """Errors over a trial of the first series in those of these iterations that were kept, each as
    far as the trial got; a dot ends it."""
    times, reference = found.problem.times, found.problem.reference
    curves = []
    for i, style in zip((one for one in iterations if one in found.kept), LINES, strict=False):
        until = min(float(found.lengths[0, i]), float(times[-1]))
        reached = times <= until
        error = (reference - found.trial(i)[1])[reached]
        end = {"marker": "o", "markevery": [len(error) - 1], "ms": 8}
        curves.append(Curve(times[reached], error, f"iteration {i}", style | end))
    return Panel(curves, {"xlabel": time, "ylabel": name})
