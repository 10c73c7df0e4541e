"""A scalar plant that is only locally Lipschitz, x' = theta(t) x^2 + u, over trials of random
length: an adaptive law whose convergence a composite energy function shows, and a law that is a
contraction. Not of the thesis: its section 9.2, item 1, asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import ExampleOptions, ExampleRun, Prepared
from tailbeat.studies.thesis.learner import LearnerConfig
from tailbeat.studies.thesis.options import last_iteration
from tailbeat.studies.thesis.series import LearningProblem, uniform

DURATION, SAMPLES = 2.0, 400  # s
STEP = DURATION / SAMPLES
STARTS: F64 = STEP * np.arange(SAMPLES, dtype=np.float64)  # of the samples, s
ITERATIONS = 120
LENGTHS = uniform(0.5 * DURATION, DURATION)  # of trials, s
_FEEDBACK, _LEARNING = 5.0, 0.3  # 1/s; gain of the estimate
_ESCAPED = 1e3


@dataclass(frozen=True)
class EscapeTask:
    """The reference goes up to about 1.25 ``height``. Both laws have the reference's slope and the
    same feedback of the error; theta is what they do not know."""

    height: float = 1.0

    def reference(self, time: F64) -> F64:
        """Of x; 0 at t = 0."""
        return self.height * np.asarray(np.sin(0.5 * np.pi * time) ** 2 + 0.25 * time)

    def known_push(self) -> F64:
        """What both laws put in beside -feedback * x: slope of the reference plus feedback times
        the reference, by sample."""
        now, after = self.reference(STARTS), self.reference(STARTS + STEP)
        return np.asarray((after - now) / STEP + _FEEDBACK * now)


def theta(time: F64) -> F64:
    """1/s."""
    return np.asarray(2.0 + np.sin(3.0 * np.pi * time))


@dataclass(frozen=True)
class EscapeSeries:
    """Shapes (series, iterations). ``errors``: max|e| over what each trial reached, infinite where
    the plant escaped; ``lengths`` in s."""

    errors: F64
    lengths: F64


def adaptive(task: EscapeTask, seeds: Sequence[int], iterations: int) -> EscapeSeries:
    """Input: what is known minus estimate * x^2. The estimate of a sample changes by -gain * x^2 *
    e in a trial that reaches it; else it stays."""
    estimate = np.zeros((len(seeds), SAMPLES))
    lengths = np.array([[LENGTHS(seed, i) for i in range(iterations)] for seed in seeds])
    errors = np.empty_like(lengths)
    wanted, known, unknown = task.reference(STARTS), task.known_push(), theta(STARTS)
    for i in range(iterations):
        reached = lengths[:, i, np.newaxis] > STARTS
        x, largest = np.zeros((2, len(seeds)))
        for k in range(SAMPLES):
            error, square = reached[:, k] * (wanted[k] - x), x * x
            largest = np.maximum(largest, np.abs(error))
            estimate[:, k] -= _LEARNING * square * error
            push = known[k] - _FEEDBACK * x + (unknown[k] - estimate[:, k]) * square
            x = np.minimum(x + STEP * push, _ESCAPED)
        errors[:, i] = np.where(largest < _ESCAPED / 2, largest, np.inf)
    return EscapeSeries(errors, lengths)


def contraction(task: EscapeTask, gain: float) -> LearningProblem:
    """The P-type law with a lead of one sample, u(k) + gain * e(k + 1), 1/s. On a globally
    Lipschitz plant it contracts in a weighted norm for ``gain * STEP`` between 0 and 2."""
    ends, known, unknown = STARTS + STEP, task.known_push(), theta(STARTS)

    def respond(inputs: F64, iteration: int) -> F64:
        x = np.zeros(len(inputs))
        outputs = np.empty_like(inputs)
        for k in range(SAMPLES):
            x = x + STEP * (unknown[k] * x * x + known[k] - _FEEDBACK * x + inputs[:, k])
            outputs[:, k] = x
        return outputs

    law = LearnerConfig(SAMPLES, step=STEP, kp=gain)
    return LearningProblem(ends, task.reference(ends), respond, law, LENGTHS)


def prepare(task: EscapeTask, options: ExampleOptions) -> Prepared:
    """The adaptive law, trials of random length."""
    last = last_iteration(options.iterations, ITERATIONS)

    def run() -> ExampleRun:
        found = adaptive(task, [options.seed], last + 1)
        escaped = np.flatnonzero(~np.isfinite(found.errors[0]))
        end = int(escaped[0]) if len(escaped) else last + 1
        return ExampleRun(
            np.arange(end), found.errors[0, :end], lengths=found.lengths[0, :end],
            diverged=end if len(escaped) else None, traces=found,
        )  # fmt: skip

    return Prepared({"iterations": last, "seed": options.seed}, run)
