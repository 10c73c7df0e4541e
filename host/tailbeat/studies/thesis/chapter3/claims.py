"""What chapter 3 claims of its examples, and what came out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter3.plants import (
    EXAMPLE1,
    EXAMPLE1_LENGTHS,
    FISH,
    Moving,
    beta_bounds,
    fish_rate_printed,
    fish_wanted_input,
    normal_reached,
    rho_least,
    window_contraction,
)
from tailbeat.studies.thesis.cut import SeriesOutcome, run_series
from tailbeat.studies.thesis.example import Claim, Study, verdict

SEEDS = range(1, 201)
_SWEEP_SEEDS = range(1, 61)
_ESCAPE_SEEDS = range(1, 51)
_SLOPES = (0.5, 1.5)  # of example 1's input, c'f_u
_SOURCE1, _SOURCE2 = "3.4, example 1", "3.4, example 2"
_ITERATIONS1, _ITERATIONS2 = 20, 30
_M_LAST = 5


def example1(study: Study) -> list[Claim]:
    random = EXAMPLE1.series(SEEDS, _ITERATIONS1)
    study.tick(0.4)
    return [_eta(), _bounds(), _example1_error(study, random), _more_memory(study)]


def _eta() -> Claim:
    reached = normal_reached(EXAMPLE1_LENGTHS.mean, EXAMPLE1_LENGTHS.stdev)
    eta = window_contraction([EXAMPLE1.beta] * (EXAMPLE1.m + 1), _SLOPES, reached(EXAMPLE1.times()))
    as_claimed = all(abs(one - 3 / 20) < 1e-12 for one in eta) and abs(sum(eta) - 0.75) < 1e-12
    return Claim("eta_j = 3/20, their sum 3/4", _SOURCE1, verdict(as_claimed), [eta[0], sum(eta)])


def _bounds() -> Claim:
    missed, trials = 0.5, EXAMPLE1.m + 1
    rho = rho_least(missed, _SLOPES)
    low, high = beta_bounds(trials, missed, _SLOPES, rho)
    inside = low - 1e-12 <= EXAMPLE1.beta <= high + 1e-12
    return Claim(
        "beta_j = 1/5 needs no more of the distribution than (3.34)", "(3.34), 3.4, example 1",
        verdict(inside and rho < 1.0), [rho, low, high],
        "The least rho and the bounds of beta_j for it, with alpha_2 = 1/2.",
    )  # fmt: skip


def _example1_error(study: Study, random: SeriesOutcome) -> Claim:
    at, bound = _ITERATIONS1, 0.003035
    uncut = study.run(lengths="full").max_abs_error
    first = float(uncut[0])
    executed = float(np.median(random.executed[:, at]))
    whole = float(np.median(random.max_abs_error[:, at]))
    starts = abs(first - 2.351) < 1e-3
    reaches = min(executed, float(uncut[at])) <= bound
    return Claim(
        f"max|e| falls from 2.351 to {bound} within {at} iterations (m = 4)", _SOURCE1,
        verdict(starts and reaches, reaches),
        [first, executed, whole, float(uncut[at])],
        f"First error; at iteration {at} the medians of {len(SEEDS)} seeds over what the trials "
        "reached and over the whole record, and with uncut trials. Step 0.01 s; the first error "
        "nears 2.351 with smaller ones.",
    )  # fmt: skip


def _sweep(total: bool) -> tuple[list[float], list[float]]:
    """Errors of m = 0 … 5 at iteration 20, uncut and median of random trials. ``total``: the gains
    add up to 1 with every m, instead of 1/5 each."""
    uncut, random = [], []
    for m in range(_M_LAST + 1):
        setting = replace(EXAMPLE1, m=m, beta=1.0 / (m + 1) if total else EXAMPLE1.beta)
        uncut.append(_uncut(setting, _ITERATIONS1)[-1])
        errors = setting.series(_SWEEP_SEEDS, _ITERATIONS1).max_abs_error
        random.append(float(np.median(errors[:, -1])))
    return uncut, random


def _uncut(setting: Moving, iterations: int) -> list[float]:
    task = setting.task()
    found = run_series(task, [task.length("full", 1)], iterations)
    return [float(error) for error in found.max_abs_error[0]]


def _more_memory(study: Study) -> Claim:
    each, each_random = _sweep(total=False)
    study.tick(0.7)
    shared, _ = _sweep(total=True)
    fixed = bool(np.all(np.diff(each[:-1]) < 0.0)) and each[-1] > each[-2]
    normed = bool(np.all(np.diff(shared[:-1]) < 0.0)) and shared[-1] > shared[-2]
    slower = bool(np.all(np.diff(shared) > 0.0))
    return Claim(
        "m = 0 … 4: a larger m converges faster; m = 5 is worse", _SOURCE1,
        verdict(fixed and normed, fixed or normed),
        each,
        f"Uncut error at iteration {_ITERATIONS1} for m = 0 … 5. The reading: beta_j = 1/5 with "
        f"every m, so that m sets the total gain. With beta_j = 1/(m+1) {_listed(shared)}: "
        f"{'a larger m is always slower' if slower else 'no clear order'}. Random lengths, median "
        f"of {len(_SWEEP_SEEDS)} seeds with 1/5: {_listed(each_random)}.",
    )  # fmt: skip


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def fish(study: Study) -> list[Claim]:
    printed = replace(FISH, rate=fish_rate_printed)
    escaped = _diverged(printed)
    escaped_u0 = _diverged(replace(printed, history="first"))
    study.tick(0.2)
    zero = _ratios(FISH.series(SEEDS, _ITERATIONS2))
    study.tick(0.6)
    first = _ratios(replace(FISH, history="first").series(SEEDS, _ITERATIONS2))
    study.tick(0.9)
    pushing = _uncut(replace(FISH, low=0.0), _ITERATIONS2)
    return [
        _falls(zero, first, escaped), _printed_drag(escaped, escaped_u0),
        _pushing_only(pushing),
    ]  # fmt: skip


def _ratios(found: SeriesOutcome) -> F64:
    """How many times smaller the error has become; 0 for a series that diverged."""
    errors = found.max_abs_error
    return np.where(np.isnan(errors[:, -1]), 0.0, errors[:, 0] / errors[:, -1])


def _diverged(setting: Moving) -> float:
    found = setting.series(_ESCAPE_SEEDS, _ITERATIONS2)
    return float((found.diverged >= 0).mean())


def _falls(zero: F64, first: F64, escaped: float) -> Claim:
    wanted = 90.0
    with_zero, with_first = float(np.median(zero)), float(np.median(first))
    share = float((zero > wanted).mean())
    falls = min(with_zero, with_first) > wanted
    return Claim(
        f"||e||_s falls more than 90 times within {_ITERATIONS2} iterations", _SOURCE2,
        verdict(falls and escaped == 0.0, falls),
        [with_zero, with_first, share],
        f"Medians of {len(zero)} seeds with zero history, as printed, and with u_0 as the history; "
        "the share of seeds above 90 with zero history. The reading: drag -alpha v|v|, and a "
        "thrust that may be negative.",
    )  # fmt: skip


def _printed_drag(escaped: float, escaped_u0: float) -> Claim:
    return Claim(
        "The fish as printed, v' = -alpha v^2 + u, learns with zero history", _SOURCE2,
        verdict(escaped == 0.0),
        [escaped, escaped_u0],
        f"Share of {len(_ESCAPE_SEEDS)} seeds whose speed escapes to minus infinity in a trial, "
        "with zero history and with u_0 as the history. Zero history makes u_1 negative; the fish "
        "reverses, and -alpha v^2 drives it on.",
    )  # fmt: skip


def _pushing_only(errors: list[float]) -> Claim:
    ratio = errors[0] / errors[-1]
    needed = fish_wanted_input(FISH.times())
    negative = FISH.times()[1:-1][needed[1:-1] < 0.0]
    since = f" (u_d < 0 from {negative[0]:.2f} s on)" if len(negative) else ""
    return Claim(
        "The reference can be followed by a fish that pushes only, u >= 0", _SOURCE2,
        verdict(ratio > 90.0), [ratio, errors[-1], float(needed.min())],
        f"Uncut: how often the error becomes smaller within {_ITERATIONS2} iterations, the error "
        f"that stays, m/s, and the least thrust that the reference needs, m/s^2{since}.",
        ours=True,
    )  # fmt: skip
