"""The laws that correct while the plant moves (firmware/ilc/feedback.h) on the plants of chapters
4 and 5: whole series of trials, integrated in C in double, the laws in double or float.

What the figures of chapters 4 and 5 have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import (
    Claim,
    Example,
    ExampleOptions,
    ExampleRun,
    Figure,
    Study,
)
from tailbeat.studies.thesis.learner import Precision, load
from tailbeat.studies.thesis.options import Span, errors_beyond, last_iteration
from tailbeat.studies.thesis.picture import LINES, WANTED, legend, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Scheme = Literal["rk4", "held", "euler"]

SCHEMES: dict[Scheme, int] = {"rk4": 0, "held": 1, "euler": 2}
STATES = 2
STEPS_MAX = 200_000
_BUDGET, _BUDGET_SMOOTH = 300_000_000, 80_000_000  # tanh costs four times as much
NO_LIMIT = 1e30
TRACE_COLUMNS = ("t", "x1", "x2", "wanted1", "wanted2", "u1", "u2")
_WANTED = slice(3, 5)  # of these


@dataclass(frozen=True)
class TimeGrid:
    """How the continuous loop is computed, as ``loop_scheme_t``: ``rk4`` asks the law in every
    stage, ``held`` holds its input over a step, ``euler`` is Euler's rule. ``steps`` divide the
    common axis of all trials."""

    steps: int
    scheme: Scheme


@dataclass(frozen=True)
class Chapter4:
    """``chapter4_t``. ``dead_zone`` and ``lambda_max`` act on lambda's estimate and are not the
    thesis's."""

    grid: TimeGrid
    varying: bool = False
    smooth: bool = False
    block: bool = False
    epsilon: float = 0.1
    leak_eta: float = 1e-3
    leak_lambda: float = 1e-2
    dead_zone: float = 0.0
    lambda_max: float = NO_LIMIT

    DURATION = 2.0 * np.pi

    @property
    def trial(self) -> Span:
        budget = _BUDGET_SMOOTH if self.smooth else _BUDGET
        return Span(self.DURATION, "s", STEPS_MAX, budget, typed="2*pi")


@dataclass(frozen=True)
class Chapter5:
    """``chapter5_t``. ``dead_zone``, ``theta_max`` and ``softness`` are not the thesis's."""

    grid: TimeGrid
    uncertain: bool = False
    smooth: bool = False
    epsilon: float = 0.1
    bound: float = 2.0
    gain_theta: float = 1.0
    gain_eta: float = 4.0
    leak: float = 0.0
    beta_power: int = 4
    inverse_norm: bool = False
    softness: float = 0.0
    dead_zone: float = 0.0
    theta_max: float = NO_LIMIT

    DURATION = 0.5
    FIRST_STATE = (1.5, -0.4)

    @property
    def trial(self) -> Span:
        budget = _BUDGET_SMOOTH if self.smooth or self.uncertain else _BUDGET
        return Span(self.DURATION, "s", STEPS_MAX, budget)


@dataclass(frozen=True)
class LoopTrials:
    """What trials 1, 2, … gave, one row each. Shapes: (trials, 2); ``max_estimate``: (trials,
    estimates). ``diverged``: the trial that could not be computed to its end; it has no row.
    ``traces``: by trial, rows of ``TRACE_COLUMNS`` (t on the common axis)."""

    max_abs_error: F64
    input_variation: F64
    max_abs_input: F64
    max_estimate: F64
    diverged: int | None = None
    traces: dict[int, F64] = field(default_factory=dict)

    def error(self, trial: int) -> list[float]:
        """max |e| of both components in ``trial``; NaN when it diverged before."""
        if trial > len(self.max_abs_error):
            return [float("nan")] * STATES
        return [float(value) for value in self.max_abs_error[trial - 1]]

    def largest(self, trial: int) -> float:
        """The larger of both errors; infinite when it diverged before."""
        worst = max(self.error(trial))
        return worst if np.isfinite(worst) else float("inf")

    def variation(self, trial: int) -> list[float]:
        """Total variation of both inputs in ``trial``."""
        if trial > len(self.input_variation):
            return [float("nan")] * STATES
        return [float(value) for value in self.input_variation[trial - 1]]

    def settled(self, first: int, last: int) -> float:
        """The largest error of trials ``first`` … ``last``; infinite when one diverged."""
        if len(self.max_abs_error) < last:
            return float("inf")
        return float(np.max(self.max_abs_error[first - 1 : last]))


def asked(
    setting: Chapter4 | Chapter5, options: ExampleOptions, iterations: int
) -> tuple[Chapter4 | Chapter5, int]:
    """The example with the grid of the options, or its own, and the last iteration. In chapter 4
    the step becomes the nearest that divides the trial, as no short number divides 2 pi.

    Raises:
        InputError: when they make no sense, or take too long together.
    """
    trial = setting.trial
    last = last_iteration(options.iterations, iterations, first=1)
    if options.step is not None:
        count = trial.nearest if isinstance(setting, Chapter4) else trial.steps
        setting = replace(setting, grid=TimeGrid(count(options.step), setting.grid.scheme))
    trial.afford(setting.grid.steps, last)
    return setting, last


def settings(
    setting: Chapter4 | Chapter5, iterations: int, options: ExampleOptions
) -> dict[str, int | float]:
    """What ``run_example`` uses."""
    setting, last = asked(setting, options, iterations)
    return {"iterations": last, "step": setting.trial.duration / setting.grid.steps}


def run_example(
    setting: Chapter4 | Chapter5, options: ExampleOptions, iterations: int
) -> ExampleRun:
    """An example with its own grid and ``iterations`` where the options leave them open.
    ``traces["trials"]`` are the ``Trials``, with traces of the first and the last one.

    Raises:
        InputError: as ``asked``.
    """
    setting, last = asked(setting, options, iterations)
    trials = run_trials(setting, last, options.precision, traced={1, last})
    return ExampleRun(
        iterations=np.arange(1, len(trials.max_abs_error) + 1),
        max_abs_error=trials.max_abs_error,
        diverged=trials.diverged,
        traces={"trials": trials},
    )


def example(
    chapter: int,
    iterations: int,
    id: str,
    title: str,
    law: str,
    setting: Chapter4 | Chapter5,
    claims: Callable[[Study], list[Claim]],
    figures: Callable[[Study, Path], list[Figure]],
    weight: float,
) -> Example:
    """An example of these chapters; they differ in what is set, claimed and drawn."""
    return Example(
        id=id, chapter=chapter, title=title, law=law, knows=frozenset({"step", "iterations"}),
        run=partial(run_example, setting, iterations=iterations), claims=claims, figures=figures,
        weight=weight, settings=partial(settings, setting, iterations),
    )  # fmt: skip


def trials_of(run: ExampleRun) -> LoopTrials:
    """What ``run_example`` keeps beside the errors."""
    trials = run.traces["trials"]
    assert isinstance(trials, LoopTrials)
    return trials


def run_trials(
    example: Chapter4 | Chapter5,
    iterations: int,
    precision: Precision = "double",
    traced: Collection[int] = (),
) -> LoopTrials:
    """Trials 1 … ``iterations`` with estimates that begin at zero; ends early where the loop cannot
    be computed any more, or no digit of what trial 1 wanted is left in the error. Pure; costs about
    0.3 µs per law, estimate and step."""
    loop = _Loop(example, precision)
    reports: list[tuple[list[float], ...]] = []
    traces: dict[int, F64] = {}
    diverged: int | None = None
    limit = 0.0
    for trial in range(1, iterations + 1):
        trace = loop.trace() if trial in traced or trial == 1 else None
        report = loop.trial(trial, trace)
        if report is not None and trial == 1 and trace is not None:
            limit = errors_beyond(trace[:, _WANTED])
        if report is None or not max(report[0]) <= limit:
            diverged = trial
            break
        reports.append(report)
        if trial in traced and trace is not None:
            traces[trial] = trace
        study.tell(trial, iterations)
    columns = [
        np.array([report[column] for report in reports], dtype=np.float64).reshape(
            len(reports), width
        )
        for column, width in enumerate((STATES, STATES, STATES, loop.estimates))
    ]
    return LoopTrials(columns[0], columns[1], columns[2], columns[3], diverged, traces)


class _Loop:
    """The C loop of one example with its bank of estimates and its state."""

    def __init__(self, example: Chapter4 | Chapter5, precision: Precision) -> None:
        native = load(precision)
        self._ffi, self._lib = native.ffi, native.lib
        self._steps = example.grid.steps
        fields = asdict(example)
        fields["grid"] = {"scheme": SCHEMES[example.grid.scheme], "steps": self._steps}
        self._in_chapter4 = isinstance(example, Chapter4)
        kind = "chapter4_t *" if self._in_chapter4 else "chapter5_t *"
        self._example = self._ffi.new(kind, fields)
        count = self._lib.chapter4_estimates if self._in_chapter4 else self._lib.chapter5_estimates
        self.estimates = int(count(self._example))
        number = "double" if precision == "double" else "float"
        self._bank = self._ffi.new(f"{number}[]", (self._steps + 1) * self.estimates)
        first = (0.0, 0.0) if isinstance(example, Chapter4) else example.FIRST_STATE
        self._state = self._ffi.new("double[]", list(first))
        self._report = self._ffi.new("loop_report_t *")

    def trace(self) -> F64:
        return np.empty((self._steps + 1, len(TRACE_COLUMNS)))

    def trial(self, trial: int, trace: F64 | None) -> tuple[list[float], ...] | None:
        rows: Any = self._ffi.NULL
        if trace is not None:
            rows = self._ffi.cast("double *", self._ffi.from_buffer(trace))
        if self._in_chapter4:
            result = self._lib.chapter4_trial(self._example, trial, self._bank, rows, self._report)
        else:
            result = self._lib.chapter5_trial(
                self._example, self._state, self._bank, rows, self._report
            )
        if result != self._lib.FEEDBACK_OK:
            return None
        report = self._report
        return (
            list(report.max_abs_error),
            list(report.input_variation),
            list(report.max_abs_input),
            list(report.max_estimate)[: self.estimates],
        )


_POINTS = 1250  # of states, which move slowly


def errors(path: Path, name: str, series: dict[str, LoopTrials], caption: str) -> Figure:
    """max|e| of both states over the trials; one panel per state."""
    with picture(path, panels=2) as panels:
        for state, axes in enumerate(panels):
            for line, (label, trials) in enumerate(series.items()):
                values = trials.max_abs_error[:, state]
                axes.plot(range(1, len(values) + 1), values, label=label, **LINES[line])
            axes.set_yscale("log")
            axes.set_xlabel("iteration i")
            axes.set_ylabel(f"max|e_{state + 1}(t)|")
            legend(axes)
    return Figure(path, name, caption)


def states(path: Path, name: str, trials: LoopTrials, caption: str) -> Figure:
    """Both states and their references in the trials that were kept; one panel per state."""
    with picture(path, panels=2 * len(trials.traces), across=False) as panels:
        rows = iter(panels)
        for trial, trace in sorted(trials.traces.items()):
            for state in range(2):
                _state(next(rows), thinned(trace), trial, state)
    return Figure(path, name, caption)


def _state(axes: Axes, trace: F64, trial: int, state: int) -> None:
    axes.plot(trace[:, 0], trace[:, 3 + state], label="reference", **WANTED)
    axes.plot(trace[:, 0], trace[:, 1 + state], label=f"trial {trial}", **LINES[0])
    axes.set_ylabel(f"x_{state + 1}")
    _time(axes, trace)
    legend(axes)


def inputs(path: Path, name: str, series: dict[str, F64], caption: str) -> Figure:
    """Both inputs of several traces, one panel per trace and input."""
    with picture(path, panels=2 * len(series), across=False) as panels:
        rows = iter(panels)
        for channel in range(2):
            for label, trace in series.items():
                axes = next(rows)
                axes.plot(trace[:, 0], trace[:, 5 + channel], label=label, color="0.15", lw=0.8)
                axes.set_ylabel(f"u_{channel + 1}")
                _time(axes, trace)
                legend(axes)
    return Figure(path, name, caption)


def _time(axes: Axes, trace: F64) -> None:
    axes.set_xlabel("t")
    axes.set_xlim(0.0, trace[-1, 0])


def thinned(trace: F64) -> F64:
    """Every so many rows, few enough to draw; the last one is among them."""
    return trace[:: -max(1, len(trace) // _POINTS)][::-1]
