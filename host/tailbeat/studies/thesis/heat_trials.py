"""Trial after trial on the plants of chapters 6 and 7, with the laws of firmware/ilc/learner.h."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import Options, Run
from tailbeat.studies.thesis.heat import HORIZON, STEP, TRIAL, reference
from tailbeat.studies.thesis.learner import Learner, LearnerConfig, LearnerRefused
from tailbeat.studies.thesis.limits import errors_beyond, last_iteration
from tailbeat.studies.thesis.native import Precision, load


class PlantFailed(ArithmeticError):
    """The plant could not be computed to the end of the trial."""


class Plant(Protocol):
    """From rest, one trial after the other; nothing is carried over."""

    @property
    def time(self) -> F64: ...

    def output(self, values: F64) -> F64: ...


def window(minutes: float, step: float) -> int:
    """N0 of (6.42) for a window of ``minutes``: it is the window that is kept when the step is
    another, as samples have no meaning of their own."""
    return max(1, round(minutes / step))


def lead_samples(minutes: float, step: float) -> float:
    """A lead in samples, whole or half.

    Raises:
        InputError: when it is negative, not a multiple of half a step, or longer than the trial.
    """
    halves = round(2 * minutes / step) if np.isfinite(minutes) and minutes >= 0 else -1
    if halves > 2 * round(HORIZON / step):
        raise InputError(
            f"a lead of {minutes:g} min is longer than the trial.",
            f"Give at most {HORIZON:g} min.",
        )
    if halves < 0 or abs(halves * step / 2 - minutes) > 1e-9 * max(1.0, minutes):
        raise InputError(
            f"a lead of {minutes:g} min is no multiple of half a step of {step:g} min.",
            f"Give one like {max(1, halves) * step / 2:g}, or another --step.",
        )
    return halves / 2


def asked(options: Options, usual: int) -> tuple[float, int]:
    """Step and last iteration of the options; ``usual`` where they say nothing of the latter.

    Raises:
        InputError: when they make no sense, or take too long together.
    """
    step = STEP if options.step is None else options.step
    last = last_iteration(options.iterations, usual)
    TRIAL.afford(TRIAL.steps(step), last)
    return step, last


def learn(
    plant: Plant,
    law: LearnerConfig,
    iterations: int,
    precision: Precision = "double",
    prepare: Callable[[F64], F64] | None = None,
) -> Run:
    """Iterations 0 (zero input) to ``iterations``. ``prepare``: what the law gets for the errors.

    Traces: ``time``, ``reference``, and of the last iteration ``input``, ``output``; ``first``, the
    output of iteration 0; ``rms``, the error's, per iteration.
    """
    learner = Learner(law, precision=precision)
    wanted = reference(plant.time)
    limit = errors_beyond(wanted)
    traces: dict[str, F64] = {"time": plant.time, "reference": wanted}
    worst: list[float] = []
    rms: list[float] = []
    diverged = None
    for iteration in range(iterations + 1):
        values = learner.input()
        try:
            output = plant.output(values)
            error = wanted - output
            if not np.max(np.abs(error)) <= limit:
                raise PlantFailed("no digit of the reference is left in the error")
            worst.append(float(np.max(np.abs(error))))
            rms.append(float(np.sqrt(np.mean(error**2))))
            traces |= {"input": values, "output": output}
            traces.setdefault("first", output)
            if iteration < iterations:
                learner.learn(error if prepare is None else prepare(error))
            study.tell(iteration + 1, iterations + 1)
        except PlantFailed:
            diverged = iteration
            break
        except LearnerRefused:
            diverged = iteration + 1
            break
    traces["rms"] = np.array(rms)
    return Run(np.arange(len(worst)), np.array(worst), diverged=diverged, traces=traces)


def zero_phase(values: F64, q_len: int) -> F64:
    """Q of (6.42) by law_zero_phase, renormalised at the ends; a new array."""
    native = load("double")
    given = np.ascontiguousarray(values, dtype=np.float64)
    out = np.empty_like(given)
    pointers = [native.ffi.cast("double *", native.ffi.from_buffer(a)) for a in (given, out)]
    native.lib.law_zero_phase(*pointers, len(given), q_len)
    return out


def slope(values: F64, step: float = STEP) -> F64:
    """The law's derivative: the forward difference, the last one repeated."""
    differences = np.diff(values) / step
    return np.append(differences, differences[-1])
