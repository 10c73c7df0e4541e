"""What can be computed: iterations, steps, both of them together, and up to which errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError

ITERATIONS_MAX = 10_000
M_MAX = 15  # of the moving average; a learner's window holds one trial more
STEPS_MIN = 2  # of a trial


def last_iteration(asked: int | None, usual: int, first: int = 0) -> int:
    """``asked``, or ``usual`` when None. ``first``: of the example, 0 or 1.

    Raises:
        InputError: when it is before the first, or beyond ``ITERATIONS_MAX``.
    """
    last = usual if asked is None else asked
    if not first <= last <= ITERATIONS_MAX:
        raise InputError(
            f"{last} is not the last of iterations that can be run.",
            f"Give {first} to {ITERATIONS_MAX}.",
        )
    return last


def errors_beyond(wanted: F64) -> float:
    """Errors above this are divergence: no digit of what was wanted is left in them."""
    return float(np.max(np.abs(wanted)) / np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Span:
    """The time of a trial, which steps divide. ``steps_max``: of a trial. ``budget``: steps of all
    trials together that take about ten minutes, measured; at least ``STEPS_MIN`` in each of
    ``ITERATIONS_MAX``. ``typed``: the duration as ``--step`` takes it, where it is no short
    number."""

    duration: float
    unit: str
    steps_max: int
    budget: int
    typed: str = ""

    def steps(self, step: float) -> int:
        """Of ``step`` in a trial.

        Raises:
            InputError: when they are no whole number to a part in 1e9, or too few or too many.
        """
        count = self.nearest(step)
        if abs(count * step - self.duration) > 1e-9 * self.duration:
            raise self._no_step(f"does not divide {self._text} {self.unit}", step, count)
        return count

    def nearest(self, step: float) -> int:
        """The number of steps of the length nearest to ``step`` that divides a trial.

        Raises:
            InputError: when they are too few or too many.
        """
        parts = self.duration / step if step > 0.0 else math.nan
        if not math.isfinite(parts):
            raise self._no_step("is none", step, self.steps_max)
        if round(parts) > self.steps_max:
            raise self._no_step("is too short", step, self.steps_max)
        if round(parts) < STEPS_MIN:
            raise self._no_step("is too long", step, STEPS_MIN)
        return round(parts)

    def afford(self, steps: int, iterations: int) -> None:
        """Raises InputError, with what would fit, when so many trials of so many steps would take
        more than some ten minutes."""
        if steps * iterations <= self.budget:
            return
        step = f", or --step {self._text}/{self.budget // iterations} or longer"
        raise InputError(
            f"{iterations} iterations of {steps} steps would take more than some ten minutes.",
            f"Give --iterations {self.budget // steps} or fewer{step}.",
        )

    @property
    def _text(self) -> str:
        return self.typed or f"{self.duration:g}"

    def _no_step(self, why: str, step: float, like: int) -> InputError:
        like = min(max(like, STEPS_MIN), self.steps_max)
        return InputError(
            f"a step of {step:g} {self.unit} {why}.",
            f"Give --step {self._text}/N, N from {STEPS_MIN} to {self.steps_max}, "
            f"like {self._text}/{like}.",
        )
