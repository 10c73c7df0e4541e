"""The laws that correct while the plant moves (host/native/thesis/feedback.h) on the plants of
chapters 4 and 5: whole series of trials, integrated in C in double, the laws in double or float.

What the figures of chapters 4 and 5 have in common.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis import picture, study
from tailbeat.studies.thesis.example import ExampleOptions, ExampleRun, Prepared
from tailbeat.studies.thesis.learner import Precision, load, pointer
from tailbeat.studies.thesis.ledger import SampledRun
from tailbeat.studies.thesis.options import Span, errors_beyond, last_iteration
from tailbeat.studies.thesis.picture import REFERENCE, Curve, Panel, Panels

Scheme = Literal["rk4", "held", "euler"]

SCHEMES: dict[Scheme, int] = {"rk4": 0, "held": 1, "euler": 2}
STATES = 2
STEPS_MAX = 200_000
_BUDGET, _BUDGET_SMOOTH = 300_000_000, 80_000_000  # tanh costs four times as much
NO_LIMIT = 1e30
TRACE_COLUMNS = ("t", "x1", "x2", "reference1", "reference2", "u1", "u2")
_REFERENCE = slice(3, 5)  # of these


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

    STRUCT: ClassVar[str] = "chapter4"
    ITERATIONS: ClassVar[int] = 100

    @property
    def trial(self) -> Span:
        """Of all trials, on their common axis."""
        budget = _BUDGET_SMOOTH if self.smooth else _BUDGET
        return Span(2.0 * np.pi, "s", STEPS_MAX, budget, typed="2*pi")


@dataclass(frozen=True)
class Chapter5:
    """``chapter5_t``. ``dead_zone``, ``theta_max``, ``input_max`` and ``softness`` are not the
    thesis's."""

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
    input_max: float = NO_LIMIT

    STRUCT: ClassVar[str] = "chapter5"
    ITERATIONS: ClassVar[int] = 50
    FIRST_STATE: ClassVar[tuple[float, float]] = (1.5, -0.4)

    @property
    def trial(self) -> Span:
        """Of all trials."""
        budget = _BUDGET_SMOOTH if self.smooth or self.uncertain else _BUDGET
        return Span(0.5, "s", STEPS_MAX, budget)


Case = TypeVar("Case", bound=Chapter4 | Chapter5)


def on(case: Case, steps: int, scheme: Scheme = "held", **changes: Any) -> Case:
    """The case on another grid, with other changes."""
    return replace(case, grid=TimeGrid(steps, scheme), **changes)


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
        return self._row(self.max_abs_error, trial)

    def variation(self, trial: int) -> list[float]:
        """Total variation of both inputs in ``trial``."""
        return self._row(self.input_variation, trial)

    def _row(self, rows: F64, trial: int) -> list[float]:
        found: list[float] = [np.nan] * STATES if trial > len(rows) else rows[trial - 1].tolist()
        return found

    def settled(self, first: int, last: int) -> float:
        """The largest error of trials ``first`` … ``last``; infinite when one diverged."""
        if len(self.max_abs_error) < last:
            return float("inf")
        return float(np.max(self.max_abs_error[first - 1 : last]))

    def largest(self, trial: int) -> float:
        """The larger of both errors; infinite when it diverged before."""
        return self.settled(trial, trial)

    def grows(self) -> bool:
        """Whether the errors have passed a minimum and risen well above it, or diverged."""
        if self.diverged is not None:
            return True
        worst = self._mean_of_ten()
        return bool(worst[-1] > _GROWTH * worst.min())

    def _mean_of_ten(self) -> F64:
        return np.convolve(self.max_abs_error.max(axis=1), np.full(10, 0.1), "valid")

    def sampled(self, step: float, shown: int) -> SampledRun:
        """For the standard of continuous-time theorems. Promised is that the errors fall: by 80 %
        up to trial ``shown``, and never well above their least."""
        falls = self.largest(shown) < 0.2 * self.largest(1)
        if len(self.max_abs_error) < 10:
            return SampledRun(step, falls, self.diverged)
        worst = self._mean_of_ten()
        risen = np.flatnonzero(worst > _GROWTH * np.minimum.accumulate(worst))
        return SampledRun(step, falls, int(risen[0]) + 10 if len(risen) else self.diverged)


_ROWS = ("max_abs_error", "input_variation", "max_abs_input", "max_estimate")
CHATTER = 10.0  # times the total variation of a smooth input
_GROWTH = 3.0  # times the smallest error so far, from where it is no scatter of the references


def prepare(setting: Chapter4 | Chapter5, options: ExampleOptions) -> Prepared:
    """An example of these chapters. In chapter 4 the step becomes the nearest that divides the
    trial, as no short number divides 2 pi.

    Raises:
        InputError: when the options make no sense, or take too long together.
    """
    trial = setting.trial
    last = last_iteration(options.iterations, setting.ITERATIONS, first=1)
    if options.step is not None:
        count = trial.nearest if isinstance(setting, Chapter4) else trial.steps
        setting = on(setting, count(options.step), setting.grid.scheme)
    trial.afford(setting.grid.steps, last)

    def run() -> ExampleRun:
        found = run_trials(setting, last, options.precision, traced={1, last})
        errors = found.max_abs_error
        return ExampleRun(
            np.arange(1, len(errors) + 1), errors, diverged=found.diverged, traces=found
        )

    return Prepared({"iterations": last, "step": trial.duration / setting.grid.steps}, run)


@cache
def other(setting: Chapter4 | Chapter5) -> LoopTrials:
    """The law to compare an example with, with a trace of the last trial."""
    return run_trials(setting, setting.ITERATIONS, traced={setting.ITERATIONS})


def pair(both: Sequence[float] | F64, form: str = ".4g") -> str:
    """Two numbers in a sentence."""
    return f"{both[0]:{form}} and {both[1]:{form}}"


def sampled(
    setting: Chapter4 | Chapter5, periods: Mapping[int, int]
) -> tuple[dict[int, LoopTrials], str]:
    """Series with the input held, by their steps a trial, and how they went. ``periods``: steps ->
    trials."""
    found = {n: run_trials(on(setting, n), last) for n, last in periods.items()}
    words = [
        f"{n} steps: not computable from trial {trials.diverged} on"
        if trials.diverged is not None
        else f"{n} steps: {trials.largest(periods[n]):.3g} at trial {periods[n]}"
        for n, trials in found.items()
    ]
    return found, "; ".join(words)


def run_trials(
    setting: Chapter4 | Chapter5,
    iterations: int,
    precision: Precision = "double",
    traced: Collection[int] = (),
) -> LoopTrials:
    """Trials 1 … ``iterations`` with estimates that begin at zero; ends early where the loop cannot
    be computed any more, or no digit of what trial 1's reference was is left in the error. Pure;
    costs about 0.3 µs per law, estimate and step."""
    loop = _Loop(setting, precision)
    rows = {name: np.zeros((iterations, STATES)) for name in _ROWS[:-1]}
    rows[_ROWS[-1]] = np.zeros((iterations, loop.estimates))
    traces: dict[int, F64] = {}
    done, limit = 0, 0.0
    for trial in range(1, iterations + 1):
        trace = None
        if trial in traced or trial == 1:
            trace = np.empty((setting.grid.steps + 1, len(TRACE_COLUMNS)))
        computed = loop.trial(trial, trace)
        if trial == 1 and trace is not None:
            limit = errors_beyond(trace[:, _REFERENCE])
        if not computed or not max(loop.report.max_abs_error) <= limit:
            break
        for name, column in rows.items():
            column[trial - 1] = list(getattr(loop.report, name))[: column.shape[1]]
        if trial in traced and trace is not None:
            traces[trial] = trace
        done = trial
        study.report_progress(trial, iterations)
    diverged = None if done == iterations else done + 1
    columns = {name: column[:done] for name, column in rows.items()}
    return LoopTrials(**columns, diverged=diverged, traces=traces)


class _Loop:
    """The C loop of one example with its bank of estimates and its state."""

    def __init__(self, setting: Chapter4 | Chapter5, precision: Precision) -> None:
        self._native = load(precision)
        ffi, lib = self._native.ffi, self._native.lib
        grid = {"scheme": SCHEMES[setting.grid.scheme], "steps": setting.grid.steps}
        self._setting = ffi.new(f"{setting.STRUCT}_t *", asdict(setting) | {"grid": grid})
        self._run = getattr(lib, f"{setting.STRUCT}_trial")
        self.estimates = int(getattr(lib, f"{setting.STRUCT}_estimates")(self._setting))
        self._bank = ffi.new(f"{precision}[]", (setting.grid.steps + 1) * self.estimates)
        self._state = None
        if isinstance(setting, Chapter5):
            self._state = ffi.new("double[]", setting.FIRST_STATE)
        self.report = ffi.new("loop_report_t *")

    def trial(self, trial: int, trace: F64 | None) -> bool:
        """Whether it could be computed; ``report`` is of it."""
        where = trial if self._state is None else self._state
        rows = pointer(self._native, trace)
        result = self._run(self._setting, where, self._bank, rows, self.report)
        return bool(result == self._native.lib.FEEDBACK_OK)


_POINTS = 1250  # of states, which move slowly


def errors(series: Mapping[str, LoopTrials]) -> Panels:
    """max|e| of both states over the trials; one panel per state."""
    return Panels(
        [
            picture.errors(
                {name: trials.max_abs_error[:, state] for name, trials in series.items()},
                first=1, ylabel=rf"$\max_t\,|e_{{i,{state + 1}}}(t)|$",
            )
            for state in range(STATES)
        ]
    )  # fmt: skip


def states(trials: LoopTrials, state: int) -> Panels:
    """A state and its reference in the trials that were kept, one panel each."""
    panels = []
    for trial, whole in sorted(trials.traces.items()):
        trace = thinned(whole)
        curves = [
            Curve(trace[:, 0], trace[:, 3 + state], "reference", REFERENCE),
            Curve(trace[:, 0], trace[:, 1 + state], f"iteration {trial}"),
        ]
        panels.append(_over_time(trace, f"$x_{state + 1}$", curves))
    return Panels(panels, across=False)


def is_smooth(trials: LoopTrials, trial: int) -> bool:
    """Whether the inputs of the last trial vary by less than ten times the largest of them."""
    variation = trials.variation(trial)
    largest = CHATTER * float(np.max(trials.max_abs_input[-1]))
    return bool(np.all(np.isfinite(variation)) and max(variation) < largest)


def input_of(trials: LoopTrials, trial: int, channel: int) -> Panel:
    """An input in a trial that was kept."""
    trace = trials.traces[trial]
    curve = Curve(trace[:, 0], trace[:, 5 + channel], f"iteration {trial}", _CHATTER_LINE)
    return _over_time(trace, f"$u_{channel + 1}$", [curve])


_CHATTER_LINE: dict[str, Any] = {"color": "0.15", "lw": 0.8}


def _over_time(trace: F64, name: str, curves: list[Curve]) -> Panel:
    return Panel(curves, {"ylabel": name, "xlabel": "$t$", "xlim": (0.0, trace[-1, 0])})


def thinned(trace: F64) -> F64:
    """Every so many rows, few enough to draw; the last one is among them."""
    return trace[:: -max(1, len(trace) // _POINTS)][::-1]
