"""What chapter 2 claims of its examples, and what came out."""

from __future__ import annotations

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter2.plants import (
    EXAMPLE1,
    EXAMPLE1_N30,
    EXAMPLE2,
    SUBSTITUTE,
    WANTED,
    Average,
)
from tailbeat.studies.thesis.cut import SeriesOutcome, first_within, stays_within
from tailbeat.studies.thesis.example import Claim, Study, verdict

SEEDS = range(1, 201)
LATE = 200  # iterations until errors that do not fall any more have settled
_DIGITS = 5e-5  # half a unit of the last printed digit
_START_SEEDS = range(1, 101)
_RANDOM_START = "2.4, example 1, random initial state"
_SUPERIOR = 0.9  # of the other law's floor
_EARLY, _RANDOM_START_WITHIN = 20, 80
_KEPT = (_EARLY, _RANDOM_START_WITHIN, LATE)
_SIGMAS = 4.0  # of 51 means at a time


def _same(printed: float, computed: float, digits: float = _DIGITS) -> bool:
    return abs(printed - computed) <= digits


def _median(values: F64) -> float:
    return float(np.median(values))


def example1(study: Study) -> list[Claim]:
    found = EXAMPLE1.series(SEEDS, LATE)
    study.tick(0.2)
    condition = _condition(
        "sup |1 - p(t) L CB| is about 0.7273", "2.4, example 1", 0.7273, EXAMPLE1
    )
    speed = _error_within(study, found, 1.801, 0.0098, 42)
    average = EXAMPLE1.series(_START_SEEDS, LATE, random_start=True, keep=_KEPT)
    study.tick(0.6)
    classic = EXAMPLE1.series(_START_SEEDS, LATE, past="last", random_start=True, keep=_KEPT)
    return [
        condition, speed, _random_start_mean(average), _random_start_better(average, classic),
    ]  # fmt: skip


def _condition(text: str, source: str, printed: float, setting: Average, note: str = "") -> Claim:
    computed = setting.condition()
    return Claim(text, source, verdict(_same(printed, computed)), computed, note)


def _error_within(
    study: Study, found: SeriesOutcome, start: float, bound: float, iterations: int
) -> Claim:
    full = study.run(lengths="full", iterations=LATE)
    first = float(full.max_abs_error[0])
    whole = _median(first_within(found.max_abs_error, bound))
    executed = _median(first_within(found.executed, bound))
    uncut = float(first_within(full.max_abs_error[np.newaxis], bound)[0])
    return Claim(
        f"||e_i|| falls from {start} to {bound} within {iterations} iterations",
        "2.4, example 1",
        verdict(
            _same(start, first, 5e-4) and whole <= iterations,
            min(executed, uncut) <= iterations,
        ),
        [first, whole, executed, uncut],
        "First error, then the iteration that reaches the bound: median of "
        f"{len(SEEDS)} seeds over the whole record, over what the trials reached, and with uncut "
        "trials. u_0 = 0 and x_0 = 0 make the first error the maximum of y_d. The reading: errors "
        "count where the trial got to.",
    )


def _random_start_mean(found: SeriesOutcome) -> Claim:
    at = _RANDOM_START_WITHIN
    sigmas = max(_mean_in_sigmas(found, at), _mean_in_sigmas(found, LATE))
    single = [_expected(found, i) for i in (at, LATE)]
    return Claim(
        f"With a random x_i(0) E{{e_i}} goes to 0 within {at} iterations",
        _RANDOM_START,
        verdict(sigmas < _SIGMAS and single[0] < 0.01, sigmas < _SIGMAS),
        [sigmas, *single],
        f"Mean error of {len(_START_SEEDS)} series in its standard errors, the largest of 51 "
        f"samples at the iterations {at} and {LATE}; then what a single series expects of its "
        "next trial, sup |E{e_i | u_i}|, at both. The reading: the mean over many series; the "
        "inputs of any one of them go on wandering.",
    )


def _random_start_better(average: SeriesOutcome, classic: SeriesOutcome) -> Claim:
    floors = [_expected(found, LATE) for found in (average, classic)]
    early = [_expected(found, _EARLY) for found in (average, classic)]
    return Claim(
        "Under a random initial state the average is superior to the earlier law [24]",
        _RANDOM_START,
        verdict(floors[0] < _SUPERIOR * floors[1]),
        [*floors, *early],
        "Mean of sup |E{e_i | u_i}|, average and P-type (2.3) with zero fill and the same L, at "
        f"iteration {LATE} and at {_EARLY}. Superior would be a floor lower by a tenth. [24] is "
        "taken to be the P-type.",
    )


def _mean_in_sigmas(found: SeriesOutcome, iteration: int) -> float:
    errors = WANTED - found.kept[iteration][1]
    deviation = errors.std(axis=0, ddof=1) / np.sqrt(len(errors))
    return float((np.abs(errors.mean(axis=0)) / deviation).max())


def _expected(found: SeriesOutcome, iteration: int) -> float:
    """Mean over the series of sup |E{e_i | u_i}|: the plant is linear, so that the mean error over
    all starts is the one from their mean, 0."""
    outputs = EXAMPLE1.plant.respond(found.kept[iteration][0])
    return float(np.abs(WANTED - outputs).max(axis=1).mean())


def example1_n30(study: Study) -> list[Claim]:
    bound, iterations = 0.0097, 60
    wide = EXAMPLE1_N30.series(SEEDS, LATE).max_abs_error
    study.tick(0.5)
    narrow = EXAMPLE1.series(SEEDS, LATE).max_abs_error
    reaches = _median(first_within(wide, bound))
    stays = _median(stays_within(wide, bound))
    narrow_reaches = _median(first_within(narrow, bound))
    slower = reaches > narrow_reaches
    return [
        _condition(
            "sup |1 - p(t) L CB| is about 0.7417 for N = 30", "2.4, example 1", 0.7417,
            EXAMPLE1_N30, "A slip: 61 lengths are possible, not 60; 1 - 0.5 * 31/60 is 0.7417.",
        ),
        Claim(
            f"N = 30 takes more than {iterations} iterations to {bound}, longer than N = 5",
            "2.4, example 1",
            verdict(slower and stays > iterations, slower),
            [reaches, stays, narrow_reaches],
            f"Medians of {len(SEEDS)} seeds: iteration that first reaches the bound, iteration "
            "from which on the error stays within it, and the first one with N = 5.",
        ),
    ]  # fmt: skip


def example2(study: Study) -> list[Claim]:
    run = study.run(lengths="full")
    random = study.run()
    needed = float(np.abs(EXAMPLE2.plant.wanted_input(WANTED)).max())
    errors = run.max_abs_error
    reached = [bool((e[:81] <= 0.0058).any()) for e in (errors, random.max_abs_error)]
    ends = f", in iteration {run.diverged} no digit of y_d is left in it" if run.diverged else ""
    grows = "It diverges: the error grows" if errors[-1] > 1e6 * errors[0] else "The error stays"
    return [
        _condition(
            "sup |1 - p(t) L CB| = 0.9", "2.4, example 2", 0.9, EXAMPLE2,
            "p(50) = 0.5 is the coin's probability, not that of a whole trial. With the printed "
            "C(11, m), which sum to 2047/2048, it would be "
            f"{1 - 0.2 * (1 - sum(_printed_binomial()[:5])):.4f}.",
        ),
        Claim(
            "||e_i|| falls from 1.553 to 0.0058 within 80 iterations", "2.4, example 2, (2.37)",
            verdict(all(reached) and _same(1.553, float(errors[0]), 5e-4), all(reached)),
            [float(e) for e in errors[[i for i in (0, 1, 2, 3, 10, 20) if i < len(errors)]]],
            f"max|e| at the iterations 0, 1, 2, 3, 10, 20, uncut. {grows}{ends}. "
            f"The printed plant has an unstable inverse: max|u_d| = {needed:.2g}.",
        ),
    ]  # fmt: skip


def _printed_binomial() -> list[float]:
    from math import comb

    return [comb(11, m) * 0.5**11 for m in range(11)]


def substitute(study: Study) -> list[Claim]:
    found = SUBSTITUTE.series(SEEDS, LATE)
    study.tick(0.9)
    whole = _median(first_within(found.max_abs_error, 0.0058))
    condition = SUBSTITUTE.condition()
    needed = float(np.abs(SUBSTITUTE.plant.wanted_input(WANTED)).max())
    start = float(found.max_abs_error[0, 0])
    return [
        Claim(
            "Theorem 2.2: with sup |1 - p(t) L C(t) B(t)| < 1 the error goes to 0 on a "
            "time-varying plant; 0.0058 within 80 iterations",
            "2.3, 2.4, example 2",
            verdict(
                whole <= 80 and _same(1.553, start, 5e-4),
                whole <= 80 and condition < 1.0,
            ),
            [condition, start, whole, needed],
            "The supremum, the first error, the median iteration that reaches 0.0058 and max|u_d|. "
            "The reading: y = x_3 and L = 1/3 instead of the printed C and L, with the same A, B "
            "and L C B.",
        ),
    ]
