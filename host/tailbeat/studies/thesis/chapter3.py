"""Chapter 3: the moving average (3.12), (3.43) on continuous plants whose trials end at random."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import Example, Found, claim
from tailbeat.studies.thesis.plants import held
from tailbeat.studies.thesis.study import Study, once

_example = partial(
    Example, prepare=held.prepare,
    knows=frozenset({"lengths", "seed", "iterations", "step", "m", "beta"}),
)  # fmt: skip
EX1 = _example(
    "ch3-ex1", "Nonlinear plant, trials of about 2 s (3.4, example 1)",
    "moving average D, (3.12)", held.EXAMPLE1, weight=5.0,
)  # fmt: skip
EX2 = _example(
    "ch3-fish", "Robotic fish, trials of 44 to 58 s (3.4, example 2)",
    "moving average PD, (3.43)", held.FISH, weight=12.0,
)  # fmt: skip
EXAMPLES = (EX1, EX2)

SEEDS = range(1, 201)
_SWEEP_SEEDS = range(1, 61)
_ESCAPE_SEEDS = range(1, 51)
_FIGURE_SEEDS = range(1, 61)
_FIGURE_LAST = 40, 30
_SLOPES = (0.5, 1.5)  # of example 1's input, c'f_u
_SOURCE1, _SOURCE2 = "3.4, example 1", "3.4, example 2"
_ITERATIONS1, _ITERATIONS2 = 20, 30
ORDERS = range(6)


@claim(EX1, "3-eta")
def _eta(study: Study) -> Found:
    beta, trials = study.setting.beta, study.setting.m + 1
    eta = [held.contraction(beta, trials, _SLOPES, held.example1_reached())] * trials
    as_claimed = abs(eta[0] - 3 / 20) < 1e-12 and abs(sum(eta) - 0.75) < 1e-12
    return Found(as_claimed, [eta[0], sum(eta)])


@claim(EX1, "3-bounds")
def _bounds(study: Study) -> Found:
    missed = 0.5
    rho = held.rho_least(missed, _SLOPES)
    low, high = held.beta_bounds(study.setting.m + 1, missed, _SLOPES, rho)
    inside = low - 1e-12 <= study.setting.beta <= high + 1e-12
    note = "The least rho and the bounds of beta_j for it, with alpha_2 = 1/2."
    return Found(inside and rho < 1.0, [rho, low, high], note)


@claim(EX1, "3-error")
def _falls1(study: Study) -> Found:
    at, bound = _ITERATIONS1, 0.003035
    uncut = study.run(lengths="full").max_abs_error
    random = study.setting.problem().series(SEEDS, at)
    executed, whole = (
        float(np.median(one[:, at])) for one in (random.executed, random.max_abs_error)
    )
    reaches = min(executed, uncut[at]) <= bound
    note = f"""First error; at iteration {at} the medians of {len(SEEDS)} seeds over what the trials
    reached and over the whole record, and with uncut trials. Step 0.01 s; the first error nears
    2.351 with smaller ones."""
    starts = abs(uncut[0] - 2.351) < 1e-3
    return Found(starts and reaches, [uncut[0], executed, whole, uncut[at]], note, reaches)


def of_order(setting: held.Moving, m: int, total: bool) -> held.Moving:
    """``total``: the gains add up to 1 with every m, instead of 1/5 each."""
    return replace(setting, m=m, beta=1.0 / (m + 1) if total else setting.beta)


@claim(EX1, "3-memory")
def _more_memory(study: Study) -> Found:
    each, shared = (
        [float(of_order(study.setting, m, total).problem().uncut(_ITERATIONS1)[-1]) for m in ORDERS]
        for total in (False, True)
    )
    random = [
        of_order(study.setting, m, False).problem().series(_SWEEP_SEEDS, _ITERATIONS1)
        for m in ORDERS
    ]
    each_random = [float(np.median(one.max_abs_error[:, -1])) for one in random]
    fixed, normed = (
        bool(np.all(np.diff(one[:-1]) < 0.0)) and one[-1] > one[-2] for one in (each, shared)
    )
    slower = bool(np.all(np.diff(shared) > 0.0))
    note = f"""Uncut error at iteration {_ITERATIONS1} for m = 0 … 5. The reading: beta_j = 1/5 with
    every m, so that m sets the total gain. With beta_j = 1/(m+1) {_listed(shared)}:
    {"a larger m is always slower" if slower else "no clear order"}. Random lengths, median of
    {len(_SWEEP_SEEDS)} seeds with 1/5: {_listed(each_random)}."""
    return Found(fixed and normed, each, note, fixed or normed)


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


@once
def _escaped(study: Study) -> list[float]:
    """Shares of series of the fish as printed that diverge, with zero history and with u_0."""
    printed = replace(study.setting, rate=held.fish_rate_printed)
    both = (replace(printed, history=history) for history in ("zero", "first"))
    found = [one.problem().series(_ESCAPE_SEEDS, _ITERATIONS2) for one in both]
    return [float((one.diverged >= 0).mean()) for one in found]


def _ratios(setting: held.Moving) -> F64:
    """How many times smaller the error has become; 0 for a series that diverged."""
    errors = setting.problem().series(SEEDS, _ITERATIONS2).max_abs_error
    return np.where(np.isnan(errors[:, -1]), 0.0, errors[:, 0] / errors[:, -1])


@claim(EX2, "3-fish-error")
def _falls2(study: Study) -> Found:
    zero, first = _ratios(study.setting), _ratios(replace(study.setting, history="first"))
    with_zero, with_first = float(np.median(zero)), float(np.median(first))
    falls = min(with_zero, with_first) > 90.0
    note = f"""Medians of {len(zero)} seeds with zero history, as printed, and with u_0 as the
    history; the share of seeds above 90 with zero history. The reading: drag -alpha v|v|, and a
    thrust that may be negative."""
    measured = [with_zero, with_first, float((zero > 90.0).mean())]
    return Found(falls and _escaped(study)[0] == 0.0, measured, note, falls)


@claim(EX2, "3-fish-printed")
def _printed_drag(study: Study) -> Found:
    note = f"""Share of {len(_ESCAPE_SEEDS)} seeds whose speed escapes to minus infinity in a trial,
    with zero history and with u_0 as the history. Zero history makes u_1 negative; the fish
    reverses, and -alpha v^2 drives it on."""
    return Found(_escaped(study)[0] == 0.0, _escaped(study), note)


@claim(EX2, "3-fish-pushing")
def _pushing_only(study: Study) -> Found:
    errors = replace(study.setting, low=0.0).problem().uncut(_ITERATIONS2)
    times = study.setting.times()
    needed = held.fish_exact_input(times)
    negative = times[1:-1][needed[1:-1] < 0.0]
    since = f" (u_d < 0 from {negative[0]:.2f} s on)" if len(negative) else ""
    note = f"""Uncut: how often the error becomes smaller within {_ITERATIONS2} iterations, the
    error that stays, m/s, and the least thrust that the reference needs, m/s^2{since}."""
    ratio = errors[0] / errors[-1]
    return Found(ratio > 90.0, [ratio, errors[-1], needed.min()], note)
