"""Chapter 2: the iteration average (2.10) on linear plants whose trials end at random."""

from __future__ import annotations

from functools import partial
from math import comb

import numpy as np

from tailbeat.studies.thesis.example import Example, Found, claim
from tailbeat.studies.thesis.plants import linear
from tailbeat.studies.thesis.series import (
    SeriesOutcome,
    first_within,
    stays_within,
)
from tailbeat.studies.thesis.study import Study, once

_example = partial(
    Example, law="iteration average, (2.10)", prepare=linear.prepare,
    knows=frozenset({"lengths", "seed", "iterations"}),
)  # fmt: skip
EX1 = _example(
    "ch2-ex1", "Linear plant, trials of 45 to 55 samples (2.4, example 1)", setting=linear.EXAMPLE1,
    weight=8.0,
)  # fmt: skip
EX1_N30 = _example(
    "ch2-ex1-n30", "The same, trials of 20 to 80 samples", setting=linear.EXAMPLE1_N30, weight=3.0
)
EX2 = _example(
    "ch2-ex2", "Time-varying plant (2.37) as printed: diverges", setting=linear.EXAMPLE2, weight=0.5
)
EX2_SUBSTITUTE = _example(
    "ch2-ex2-substitute", "(2.37) with its third state as the output", setting=linear.SUBSTITUTE
)
EXAMPLES = (EX1, EX1_N30, EX2, EX2_SUBSTITUTE)

SEEDS = range(1, 201)
LATE = 200  # iterations until errors that do not fall any more have settled
_START_SEEDS = range(1, 101)
_FIGURE_SEEDS = range(1, 101)
_FIGURE_LAST = 80
_DIGITS = 5e-5  # half a unit of the last printed digit
_SOURCE = "2.4, example 1"
_RANDOM_START = "2.4, example 1, random initial state"
_SUPERIOR = 0.9  # of the other law's error bound
_EARLY, _RANDOM_START_WITHIN = 20, 80
_SIGMAS = 4.0  # of 51 means at a time


def _same(printed: float, computed: float, digits: float = _DIGITS) -> bool:
    return abs(printed - computed) <= digits


@once
def _random(study: Study) -> SeriesOutcome:
    """Of the example's own lengths."""
    problem = study.setting.problem()
    found: SeriesOutcome = problem.series(SEEDS, LATE)
    return found


@claim(EX1, "2-contraction-n5")
def _condition(study: Study) -> Found:
    return Found(_same(0.7273, study.setting.condition()), study.setting.condition())


@claim(EX1, "2-error-n5")
def _error_within(study: Study) -> Found:
    start, bound, iterations = 1.801, 0.0098, 42
    found = _random(study)
    full = study.run(lengths="full", iterations=LATE).max_abs_error
    whole, executed, uncut = (
        float(np.median(first_within(one, bound)))
        for one in (found.max_abs_error, found.executed, full[np.newaxis])
    )
    note = f"""First error, then the iteration that reaches the bound: median of {len(SEEDS)} seeds
    over the whole record, over what the trials reached, and with uncut trials. u_0 = 0 and x_0 = 0
    make the first error the maximum of y_d. The reading: errors count where the trial got to."""
    plainly = _same(start, full[0], 5e-4) and whole <= iterations
    reading = min(executed, uncut) <= iterations
    return Found(plainly, [full[0], whole, executed, uncut], note, reading)


@once
def random_starts(study: Study) -> tuple[SeriesOutcome, SeriesOutcome]:
    """The average and the P-type."""
    average, classic = (
        study.setting.problem(past, _START_SEEDS).series(
            _START_SEEDS, LATE, keep=(_EARLY, _RANDOM_START_WITHIN)
        )
        for past in ("mean", "last")
    )
    return average, classic


@claim(EX1, "2-random-start-mean")
def _random_start_mean(study: Study) -> Found:
    found, at = random_starts(study)[0], _RANDOM_START_WITHIN
    sigmas = max(_mean_in_sigmas(found, at), _mean_in_sigmas(found, LATE))
    single = [expected(found, i) for i in (at, LATE)]
    note = f"""Mean error of {len(_START_SEEDS)} series in its standard errors, the largest of 51
    samples at the iterations {at} and {LATE}; then what a single series expects of its next trial,
    sup |E{{e_i | u_i}}|, at both. The reading: the mean over many series; the inputs of any one of
    them go on wandering."""
    small = sigmas < _SIGMAS
    return Found(small and single[0] < 0.01, [sigmas, *single], note, small)


@claim(EX1, "2-random-start-better")
def _random_start_better(study: Study) -> Found:
    late, early = ([expected(one, i) for one in random_starts(study)] for i in (LATE, _EARLY))
    note = f"""Mean of sup |E{{e_i | u_i}}|, average and P-type (2.3) with zero fill and the same L,
    at iteration {LATE} and at {_EARLY}. Superior would be a final error lower by a tenth. [24] is
    taken to be the P-type."""
    return Found(late[0] < _SUPERIOR * late[1], [*late, *early], note)


def _mean_in_sigmas(found: SeriesOutcome, iteration: int) -> float:
    errors = linear.REFERENCE - found.kept[iteration][1]
    deviation = errors.std(axis=0, ddof=1) / np.sqrt(len(errors))
    return float((np.abs(errors.mean(axis=0)) / deviation).max())


def expected(found: SeriesOutcome, iteration: int) -> float:
    """Mean over the series of sup |E{e_i | u_i}|: the plant is linear, so that the mean error over
    all starts is the one from their mean, 0."""
    responses = linear.EXAMPLE1.plant.respond(found.kept[iteration][0])
    return float(np.abs(linear.REFERENCE - responses).max(axis=1).mean())


@claim(EX1_N30, "2-contraction-n30")
def _condition_n30(study: Study) -> Found:
    computed = study.setting.condition()
    note = "A slip: 61 lengths are possible, not 60; 1 - 0.5 * 31/60 is 0.7417."
    return Found(_same(0.7417, computed), computed, note)


@claim(EX1_N30, "2-slower-n30")
def _slower(study: Study) -> Found:
    bound, iterations = 0.0097, 60
    wide, narrow = _random(study), linear.EXAMPLE1.problem().series(SEEDS, LATE)
    reaches, stays, narrow_reaches = (
        float(np.median(within(one.max_abs_error, bound)))
        for within, one in ((first_within, wide), (stays_within, wide), (first_within, narrow))
    )
    slower = reaches > narrow_reaches
    note = f"""Medians of {len(SEEDS)} seeds: iteration that first reaches the bound, iteration from
    which on the error stays within it, and the first one with N = 5."""
    return Found(slower and stays > iterations, [reaches, stays, narrow_reaches], note, slower)


@claim(EX2, "2-contraction-ex2")
def _condition2(study: Study) -> Found:
    computed = study.setting.condition()
    printed = sum(comb(11, m) * 0.5**11 for m in range(5))
    note = f"""p(50) = 0.5 is the coin's probability, not that of a whole trial. With the printed
    C(11, m), which sum to 2047/2048, it would be {1 - 0.2 * (1 - printed):.4f}."""
    return Found(_same(0.9, computed), computed, note)


@claim(EX2, "2-error-ex2")
def _example2(study: Study) -> Found:
    run = study.run(lengths="full")
    errors = run.max_abs_error
    needed = float(np.abs(study.setting.plant.exact_input()).max())
    reached = all((e[:81] <= 0.0058).any() for e in (errors, study.run().max_abs_error))
    ends = f", in iteration {run.diverged} no digit of y_d is left in it" if run.diverged else ""
    grows = "It diverges: the error grows" if errors[-1] > 1e6 * errors[0] else "The error stays"
    note = f"""max|e| at the iterations 0, 1, 2, 3, 10, 20, uncut. {grows}{ends}. The printed plant
    has an unstable inverse: max|u_d| = {needed:.2g}."""
    shown = errors[[i for i in (0, 1, 2, 3, 10, 20) if i < len(errors)]]
    return Found(reached and _same(1.553, errors[0], 5e-4), shown, note, reached)


@claim(EX2_SUBSTITUTE, "2-theorem-2.2")
def _substitute(study: Study) -> Found:
    errors = _random(study).max_abs_error
    whole = float(np.median(first_within(errors, 0.0058)))
    condition, start = study.setting.condition(), float(errors[0, 0])
    needed = float(np.abs(study.setting.plant.exact_input()).max())
    note = """The supremum, the first error, the median iteration that reaches 0.0058 and
    max|u_d|. The reading: y = x_3 and L = 1/3 instead of the printed C and L, with the same A, B
    and L C B."""
    plainly, reading = _same(1.553, start, 5e-4), condition < 1.0
    measured = [condition, start, whole, needed]
    return Found(whole <= 80 and plainly, measured, note, whole <= 80 and reading)
