"""Figures 2.2 to 2.10."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.report.style import ACCENT, Axes
from tailbeat.studies.thesis.chapter2 import EX1, EX1_N30, EX2, EX2_SUBSTITUTE
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import REFERENCE, Curve, Panel, errors
from tailbeat.studies.thesis.plants import linear
from tailbeat.studies.thesis.series import SeriesOutcome, error_profiles
from tailbeat.studies.thesis.study import Study

_SEEDS = range(1, 101)
_LAST = 80
_SHOWN = (10, 20, 40, 80)
_BAND = "median, 80 % of 100 seeds (grey)"


@figure(
    EX1, "2.2", "probability that a trial gets to t, T_d = 10, N_1 = 3, N_2 = 2, equally likely"
    " lengths. The thesis shows it as a table of the lengths.",
)  # fmt: skip
def _reached(study: Study) -> Panel:
    times = np.arange(13)
    likely = linear.reached_probability(times, 10 - 3, (1 / 6,) * 6)

    def stems(axes: Axes) -> None:
        axes.vlines(times, 0.0, likely, color=ACCENT, lw=2.4)
        axes.plot(times, likely, "o", ms=9, color=ACCENT)

    return Panel([], {"xlabel": "$t$", "ylabel": "$p(t)$", "ylim": (0.0, 1.08)}, more=stems)


@figure(EX1, "2.3", "reference y_d with desired trial length 50.")
def _reference(study: Study) -> Panel:
    curve = Curve(linear.TIMES, linear.REFERENCE)
    return Panel([curve], {"xlabel": "$t$", "ylabel": "$y_d$"})


def _spread(setting: linear.Average) -> F64:
    """Errors of many series of random lengths."""
    return setting.problem().series(_SEEDS, _LAST).max_abs_error


@figure(EX1, "2.4", "largest error over the iterations, N_1 = N_2 = 5. The text: 1.801 to 0.0098.")
def _errors_n5(study: Study) -> Panel:
    full = study.run(lengths="full", iterations=_LAST).max_abs_error
    starts = f"it starts at 1.801; from u_0 = 0 and x_0 = 0 it is max|y_d| = {full[0]:.4f}."
    return errors(
        {"uncut trials": full}, band=(_BAND, _spread(study.setting)), levels=[0.0098],
        contradicts="" if abs(full[0] - 1.801) < 5e-4 else starts,
    )  # fmt: skip


@figure(EX1, "2.5", "errors of iterations 10, 20, 40 and 80 over a trial; dots end the trials.")
def _profiles(study: Study) -> Panel:
    return _error_profiles(study.setting.problem().series([1], _LAST, keep=_SHOWN), _SHOWN)


def _error_profiles(found: SeriesOutcome, iterations: Sequence[int]) -> Panel:
    return error_profiles(found, iterations, "$t$", "$e_i(t)$")


@figure(EX1_N30, "2.6", "largest error over the iterations, N_1 = N_2 = 30. The text: to 0.0097.")
def _errors_n30(study: Study) -> Panel:
    narrow = np.median(_spread(linear.EXAMPLE1), axis=0)
    return errors({"N = 5: median": narrow}, band=(_BAND, _spread(study.setting)), levels=[0.0097])


def _random_start(study: Study, past: str) -> SeriesOutcome:
    problem = study.setting.problem(past, _SEEDS)
    found: SeriesOutcome = problem.series(_SEEDS, _LAST, keep=range(_LAST + 1))
    return found


@figure(
    EX1, "2.7", "largest expected error over the iterations, random initial state: the mean of 100"
    " series.",
)  # fmt: skip
def _expectation(study: Study) -> Panel:
    kept = _random_start(study, "mean").kept
    means = [
        float(np.abs(linear.REFERENCE - kept[i][1].mean(axis=0)).max()) for i in range(_LAST + 1)
    ]
    return errors({"": means}, ylabel=r"$\max_t\,|E\{e_i(t)\}|$")


@figure(EX1, "2.8", "errors over a trial by (2.10), random initial state; dots end the trials.")
def _average_profiles(study: Study) -> Panel:
    return _error_profiles(_random_start(study, "mean"), _SHOWN)


@figure(
    EX1, "2.9", "errors over a trial by the scheme of [24], taken to be P-type with zero fill; dots"
    " end the trials.",
)  # fmt: skip
def _classic_profiles(study: Study) -> Panel:
    return _error_profiles(_random_start(study, "last"), _SHOWN)


@figure(EX2, "2.10", "largest error over the iterations on (2.37). The text: 1.553 to 0.0058.")
def _errors2(study: Study) -> Panel:
    found = study.run().max_abs_error
    diverges = "it ends at 0.0058; the plant that is printed diverges."
    return errors(
        {"": found}, levels=[0.0058], ylim=(1e-4, None),
        contradicts=diverges if found[-1] > found[0] else "",
    )  # fmt: skip


@figure(EX2_SUBSTITUTE, "2-substitute", "largest error on (2.37) with the output x_3.")
def _substitute(study: Study) -> Panel:
    full = study.run(lengths="full", iterations=_LAST).max_abs_error
    return errors({"uncut trials": full}, band=(_BAND, _spread(study.setting)), levels=[0.0058])


@figure(EX1, "2-outputs", "output of iteration 40 and reference.")
def _outputs(study: Study) -> Panel:
    found = study.run(iterations=_LAST).traces
    curves = [
        Curve(found.problem.times, found.problem.reference, "reference", REFERENCE),
        Curve(found.problem.times, found.trial(40)[1], "iteration 40"),
    ]
    return Panel(curves, {"xlabel": "$t$", "ylabel": "$y$"})
