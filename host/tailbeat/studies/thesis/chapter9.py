"""Section 9.2: what the thesis leaves to future work, as studies. None of it is the thesis's.

Item 1: a plant that is only locally Lipschitz. Item 2: a robust law with a limited input. Item 4:
the rods of chapters 6 and 7 over trials of random length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter5 import CASE1_SMOOTH
from tailbeat.studies.thesis.example import Example, ExampleOptions, Found, Prepared, claim
from tailbeat.studies.thesis.plants import advection, escaping, heat, rod
from tailbeat.studies.thesis.plants import feedback as loop
from tailbeat.studies.thesis.series import LearningProblem, SeriesOutcome, prepared, uniform
from tailbeat.studies.thesis.study import Study

SEEDS = range(20)
LOW = escaping.EscapeTask(0.3)
HIGH = escaping.EscapeTask(1.0)
CONTRACTION_GAIN = 10.0  # 1/s: a twentieth per sample; from 50 on it escapes at height 0.3, too
_LEARNED, _DECADE = 0.2, 0.1  # of the first error

TIGHT, WIDE = 1.0, 4.0  # limits of the input
ESTIMATE_MAX = 5.0

ROD_LAST = 100


def rod_chapter6() -> LearningProblem:
    """The linear rod, trials of half to full length."""
    return _of_random_length(heat.problem(heat.heat_plant(heat.CHAPTER6), rod.law()))


def rod_chapter7() -> LearningProblem:
    """The reading F = 0 of chapter 7 with its largest delta, trials of half to full length."""
    return _of_random_length(heat.problem(heat.heat_plant(heat.CHAPTER7), advection.law()))


def _of_random_length(whole: LearningProblem) -> LearningProblem:
    end = float(whole.times[-1])
    return replace(whole, draw=uniform(0.5 * end, end))


def _prepare_rod(problem: Callable[[], LearningProblem], options: ExampleOptions) -> Prepared:
    _, last = heat.step_and_last(options, ROD_LAST)
    return prepared(problem, options, last, usual="uniform")


LIPSCHITZ, LIMITED, CUT_ROD = EXAMPLES = (
    Example(
        "ch9-lipschitz", "Plant that is locally Lipschitz, trials of random length",
        "adaptive, energy function", HIGH, escaping.prepare,
        knows=frozenset({"seed", "iterations"}), weight=4.0, on_board=False,
    ),
    Example(
        "ch9-limits", "Plant of chapter 5, input limited", "robust with tanh, (5.8)-(5.9)",
        replace(CASE1_SMOOTH, input_max=TIGHT), loop.prepare,
        knows=frozenset({"step", "iterations"}), on_board=False,
    ),
    Example(
        "ch9-rod", "Heated rod of chapter 6, trials of random length", "D-type with Q (6.42)",
        rod_chapter6, _prepare_rod, knows=frozenset({"lengths", "seed", "iterations"}),
    ),
)  # fmt: skip


@cache
def adaptive(task: escaping.EscapeTask) -> F64:
    """Errors of the adaptive law over the executed parts, (series, iterations)."""
    return escaping.adaptive(task, SEEDS, escaping.ITERATIONS).errors


@cache
def contraction(task: escaping.EscapeTask) -> SeriesOutcome:
    """The P-type law on the same lengths."""
    problem = escaping.contraction(task, CONTRACTION_GAIN)
    return problem.series(SEEDS, escaping.ITERATIONS - 1)


@claim(LIPSCHITZ, "9-local-adaptive")
def _adaptive_learns(study: Study) -> Found:
    errors = adaptive(HIGH)
    left = float((errors[:, -10:].max(axis=1) / errors[:, 0]).max())
    note = "Worst series: largest error of the last ten trials over the first, at height 1."
    return Found(left < _LEARNED, left, note)


@claim(LIPSCHITZ, "9-local-contraction")
def _contraction_escapes(study: Study) -> Found:
    low, high = (contraction(task) for task in (LOW, HIGH))
    learned = low.executed[:, -10:].max(axis=1) < _LEARNED * low.executed[:, 0]
    highest = float((low.executed.max(axis=1) / low.executed[:, 0]).max())
    escaped = high.diverged >= 0
    note = f"""Series of {len(SEEDS)} that learn at height 0.3, and that escape at height 1; then
    the largest error on the way over the first, at height 0.3."""
    return Found(learned.all() and escaped.all(), [learned.sum(), escaped.sum(), highest], note)


@cache
def limited(input_max: float, theta_max: float = loop.NO_LIMIT) -> loop.LoopTrials:
    """The smooth law of chapter 5 with an actuator that has a limit."""
    case = replace(CASE1_SMOOTH, input_max=input_max, theta_max=theta_max)
    return loop.run_trials(case, case.ITERATIONS)


@claim(LIMITED, "9-limit-wide")
def _wide(study: Study) -> Found:
    free, wide = (limited(one).error(CASE1_SMOOTH.ITERATIONS) for one in (loop.NO_LIMIT, WIDE))
    off = np.abs(np.array(wide) / free - 1)
    note = f"""Error of trial 50 at a limit of {WIDE:g} over that without, less 1. The law asks for
    up to {limited(loop.NO_LIMIT).max_abs_input.max():.1f} in trial 1."""
    return Found(np.all(off < 0.05), off, note)


@claim(LIMITED, "9-limit-tight")
def _winds_up(study: Study) -> Found:
    estimate = limited(TIGHT).max_estimate[[9, 24, 49], 0]
    held = limited(TIGHT, ESTIMATE_MAX)
    errors = limited(TIGHT).settled(41, 50), held.settled(41, 50)
    note = f"""Estimate after trials 10, 25 and 50 at a limit of {TIGHT:g}, then the largest error
    of trials 41 to 50, with the estimate free and held below {ESTIMATE_MAX:g}."""
    grows = estimate[2] > 1.5 * estimate[1] > 2.25 * estimate[0]
    return Found(grows and errors[1] < 1.05 * errors[0], [*estimate, *errors], note)


@cache
def cut_rod(problem: Callable[[], LearningProblem]) -> SeriesOutcome:
    """A rod's law over trials of random length."""
    return problem().series(SEEDS, ROD_LAST)


@claim(CUT_ROD, "9-rod-linear")
def _linear_rod(study: Study) -> Found:
    found = cut_rod(rod_chapter6)
    whole = rod_chapter6().uncut(ROD_LAST)[-1]
    medians = [float(np.median(found.executed[:, i])) / whole for i in (10, 30, ROD_LAST)]
    note = f"""Median of {len(SEEDS)} series over {whole:.4f}, the error with full trials, at
    iterations 10, 30 and {ROD_LAST}."""
    return Found(medians[-1] < 1.05, medians, note)


@claim(CUT_ROD, "9-rod-lead")
def _nonlinear_rod(study: Study) -> Found:
    found = cut_rod(rod_chapter7)
    early = float((found.executed[:, 10] / found.executed[:, 0]).max())
    series = rod_chapter7().uncut(ROD_LAST), np.nanmedian(found.max_abs_error, axis=0)
    note = """Worst error of iteration 10 over the first; then the iteration from which the error
    is above twice its least, full trials and random lengths (median)."""
    return Found(early < _DECADE, [early, *map(_grown_at, series)], note)


def _grown_at(errors: F64) -> float:
    risen = np.flatnonzero(errors > 2 * np.minimum.accumulate(errors))
    return float(risen[0]) if len(risen) else np.inf
