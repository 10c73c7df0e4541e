"""What chapter 7 claims of its Theta function and of its example (section 7.5), and what comes
out: by the plant as printed, and by the heat equation alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tailbeat.thesis.advection import AdvectionPlant
from tailbeat.thesis.chapter7.task import (
    BY_TIME,
    DELTA,
    DELTAS,
    ITERATIONS,
    RHO,
    STEADY,
    law,
    variant,
)
from tailbeat.thesis.chapter7.theta import gain_for, promised, theta
from tailbeat.thesis.example import COMES_OUT, DOES_NOT, UNDER_A_READING, Claim, Run, Study
from tailbeat.thesis.heat import CHAPTER7, HORIZON, STEP, heat_plant, times
from tailbeat.thesis.heat_trials import learn

_ACCURATE = 1.0  # epsilon of the example
_REDUCTION = 0.96
_STEPS = (0.02, STEP, 0.005)
_LONG = 60
_HEAT_ONLY = "Reading: F = 0, the heat equation alone."


def printed_claims(study: Study) -> list[Claim]:
    """The Theta function's, then the example's by the plant as printed."""
    found = _theta()
    runs = _all_deltas(study)
    study.tick(0.3)
    found += _results(study, runs, printed=True)
    study.tick(0.6)
    found += [_long_run(study), _at_rest(), *_learnable()]
    study.tick(1.0)
    return found


def heat_claims(study: Study) -> list[Claim]:
    """The example's by the heat equation, where the thesis's numbers do come out."""
    runs = _all_deltas(study)
    study.tick(0.3)
    found = _results(study, runs, printed=False)
    study.tick(0.6)
    found += [_nearly_no_advection(), _contraction(study), _without_inflow(), _long_run(study)]
    study.tick(1.0)
    return found


def _verdict(comes_out: bool, as_it_is: str = COMES_OUT) -> str:
    return as_it_is if comes_out else DOES_NOT


def _all_deltas(study: Study) -> list[Run]:
    return [study.run(delta=delta) for delta in DELTAS]


def _last(runs: list[Run]) -> list[float]:
    """Errors of the last iteration, infinite where it did not get there."""
    return [float(run.max_abs_error[-1]) if run.diverged is None else float("inf") for run in runs]


def _falling(values: list[float]) -> bool:
    return all(after < before for before, after in pairwise(values))


def _theta() -> list[Claim]:
    gain = gain_for(DELTA)
    time = np.linspace(0.001, HORIZON, 100_001)
    most = float(np.max(theta(1.0, time)))
    by_images = [float(np.max(theta(1.0, time, images))) for images in range(9)]
    return [
        Claim(
            "rho = -1 / (2 theta(1, 0.25)) = -1.2041",
            "sec. 7.5",
            _verdict(abs(gain - RHO) < 5e-5),
            gain,
        ),
        Claim(
            "theta(1, t) <= 1/2",
            "(7.16)",
            _verdict(most <= 0.5 + 1e-12),
            most,
            "sup over t in (0, 10]; theta(1, t) rises to it.",
        ),
        Claim(
            "few terms of the sum are enough",
            "figs 7.1-7.3",
            _verdict(abs(by_images[-1] - 0.5) < 1e-10 and _falling([-v for v in by_images])),
            by_images,
            "sup over t in (0, 10] of the sum cut at abs(m) <= N, N = 0 to 8.",
        ),
    ]


def _results(study: Study, runs: list[Run], printed: bool) -> list[Claim]:
    errors = _last(runs)
    first = float(runs[0].max_abs_error[0])
    reductions = [1 - error / first for error in errors]
    accurate = all(error < _ACCURATE for error in errors)
    reading = COMES_OUT if printed else UNDER_A_READING
    why = _WHY_NOT if printed else _HEAT_ONLY
    five = "delta = .25, .15, .10, .05, .02 min."
    return [
        Claim(
            "the largest error is below 1 after 5 iterations, for each delta",
            "sec. 7.5 (i)",
            _verdict(accurate, reading),
            errors,
            f"max|e^5| for {five} {why}",
        ),
        Claim(
            "it falls by at least 96 %, for each delta",
            "sec. 7.5 (iii)",
            _verdict(min(reductions) >= _REDUCTION - 5e-5, reading),
            reductions,
            f"1 - max|e^5|/max|e^0| for {five} To the hundredth of a per cent."
            + ("" if printed else f" {_HEAT_ONLY}"),
        ),
        Claim(
            "a smaller delta is more accurate",
            "sec. 7.5 (ii)",
            _verdict(_falling(errors) and accurate, reading),
            errors,
            "Differences between runs that did not learn are no accuracy."
            if printed
            else f"{_HEAT_ONLY} At iteration 5 only, and only because g = 1 sets in at once: see "
            "below.",
        ),
        _finer(study),
    ]


_WHY_NOT = (
    "What flows out with the advection, 2(t + 1/2) y, leaves the input no integral; a D-law gives "
    "about 6.5 per trial at most, and u^d is about -180."
)


def _finer(study: Study) -> Claim:
    runs = [study.run(step=step) for step in _STEPS]
    errors = _last(runs)
    return Claim(
        "finer sampling is more accurate",
        "sec. 7.5 (iii)",
        _verdict(_falling(errors) and errors[-1] < 0.98 * errors[0]),
        errors,
        "max|e^5| for delta = .25 at 0.02, 0.01 and 0.005 min; better counts from 2 % on.",
    )


def _long_run(study: Study) -> Claim:
    runs = [study.run(delta=delta, iterations=_LONG) for delta in (0.25, 0.10, 0.02)]
    least = [float(run.max_abs_error.min()) for run in runs]
    errors = [float(run.max_abs_error[-1]) for run in runs]
    sound = [
        run.diverged is None and error <= 1.1 * low
        for run, error, low in zip(runs, errors, least, strict=True)
    ]
    ends = [f"{d}: {_ended(run)}" for d, run in zip((0.25, 0.10, 0.02), runs, strict=True)]
    return Claim(
        "the law converges, for each delta that meets (7.13)",
        "theorems 7.1, 7.2",
        _verdict(all(sound)),
        errors,
        f"max|e| of the last of {_LONG} iterations that could be computed, delta = .25, .10, .02. "
        f"It has no filter: what grows is fast. {'; '.join(ends)}.",
    )


def _ended(run: Run) -> str:
    if run.diverged is not None:
        return f"not computable from iteration {run.diverged} on"
    at = int(run.max_abs_error.argmin())
    return f"least {run.max_abs_error[at]:.3g} at iteration {at}"


def _at_rest() -> Claim:
    pull, at = -100.0, 5.0
    time = times(STEP)
    output = AdvectionPlant().output(np.full(len(time), pull))
    gain = float(output[round(at / STEP)]) / pull
    balance = -1 / (2 * at + 1)
    return Claim(
        "the input acts as an integral, as (7.8) has it",
        "sec. 7.4 and 7.5",
        _verdict(abs(gain) >= at / 2),
        gain,
        f"y(5)/u for u = -100 from t = 0 on; an integral would give -5, what flows out makes it "
        f"-1/(2t + 1) = {balance:.4f}.",
    )


def _learnable() -> list[Claim]:
    steady = STEADY.learn(13).max_abs_error
    by_time = BY_TIME.learn(ITERATIONS).max_abs_error
    other = "Another law than the thesis's: (7.10) with P for D, and Q."
    return [
        Claim(
            "the printed plant can be learned",
            "sec. 7.5, with another law",
            _verdict(bool(steady[-1] < _ACCURATE), UNDER_A_READING),
            [float(error) for error in steady],
            f"{other} u[t] += -4 e(t + 0.10), Q with N0 = 20; iterations 0 to 13.",
        ),
        Claim(
            "and by 96 % within 5 iterations",
            "sec. 7.5, with another law",
            _verdict(bool(by_time[-1] <= (1 - _REDUCTION) * by_time[0]), UNDER_A_READING),
            [float(error) for error in by_time],
            f"{other} u[t] += -0.5 (2t + 3) e(t + 0.10), N0 = 10: the gain at rest falls with "
            "time, the correction rises with it.",
        ),
    ]


def _nearly_no_advection() -> Claim:
    carried = (0.0, 0.005, 0.01, 2.0)
    worst = []
    for varsigma in carried:
        run = variant(DELTA, varsigma)
        worst.append(float(1 - run.max_abs_error[-1] / run.max_abs_error[0]))
    return Claim(
        "with phi, and advection 2, it falls by at least 96 %",
        "sec. 7.5 (iii)",
        _verdict(worst[-1] >= _REDUCTION),
        worst,
        "delta = .25, phi clipped, varsigma = 0, 0.005, 0.01, 2: only without advection, or nearly "
        "so, as in the heat equation. Which of these was run cannot be told.",
    )


def _contraction(study: Study) -> Claim:
    bound = promised(RHO, 0.02)
    errors = study.run(delta=0.02).max_abs_error
    seen = float(errors[1] / errors[0])
    return Claim(
        "theorem 7.1 tells how fast it learns",
        "(7.13), delta = .02",
        _verdict(bound < 2 * seen),
        [bound, seen],
        "Factor per trial: promised, and seen in the first. theta(1, .02) is nearly 0, but slow "
        "errors shrink by abs(1 + rho).",
    )


def _without_inflow() -> Claim:
    plant = heat_plant(replace(CHAPTER7, inflow=0.0))
    errors = _last([learn(plant, law(delta), ITERATIONS) for delta in DELTAS])
    return Claim(
        "a smaller delta is more accurate because it looks ahead less",
        "sec. 7.5 (ii)",
        _verdict(_falling(errors)),
        errors,
        "max|e^5| with g = 0, where the rod is consistent at t = 0: now a larger delta is better. "
        "With g = 1 the first 0.1 min cannot be learned by any input.",
    )
