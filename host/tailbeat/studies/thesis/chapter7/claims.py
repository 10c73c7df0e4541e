"""What chapter 7 claims of its Theta function and of its example (section 7.5), and what comes
out: by the plant as printed, and by the heat equation alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from tailbeat.studies.thesis.chapter7.plants import (
    BY_TIME,
    DELTA,
    DELTAS,
    ITERATIONS,
    RHO,
    STEADY,
    AdvectionPlant,
    gain_for,
    law,
    promised,
    theta,
    variant,
)
from tailbeat.studies.thesis.example import Claim, ExampleRun, Study, verdict
from tailbeat.studies.thesis.heat import (
    CHAPTER7,
    HORIZON,
    STEP,
    heat_plant,
    learn,
    reference,
    times,
)

_ACCURATE = 1.0  # epsilon of the example
_REDUCTION = 0.96
_STEPS = (0.02, STEP, 0.005)
_LONG, _LONG_DELTAS = 60, (0.25, 0.10, 0.02)
_SHORTEST = DELTAS[-1]
_PULL, _AT = -100.0, 5.0  # input that is held, and when its output is looked at, min
_HEAT_ONLY = "Reading: F = 0, the heat equation alone."


def printed_claims(study: Study) -> list[Claim]:
    """The Theta function's, then the example's by the plant as printed."""
    found = _theta()
    runs = _all_deltas(study)
    study.tick(0.3)
    found += _results(study, runs, printed=True)
    study.tick(0.6)
    found += [_own_rule(runs), _long_run(study), _at_rest(), _by_the_d_law(study), *_learnable()]
    study.tick(1.0)
    return found


def heat_claims(study: Study) -> list[Claim]:
    """The example's by the heat equation, where the thesis's numbers do come out."""
    runs = _all_deltas(study)
    study.tick(0.3)
    found = _results(study, runs, printed=False)
    study.tick(0.6)
    found += [_nearly_no_advection(), *_contraction(study), _without_inflow(), _long_run(study)]
    study.tick(1.0)
    return found


def _all_deltas(study: Study) -> list[ExampleRun]:
    return [study.run(delta=delta) for delta in DELTAS]


def _last(runs: list[ExampleRun]) -> list[float]:
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
            verdict(abs(gain - RHO) < 5e-5),
            gain,
        ),
        Claim(
            "theta(1, t) <= 1/2",
            "(7.16)",
            verdict(most <= 0.5 + 1e-12),
            most,
            "sup over t in (0, 10]; theta(1, t) rises to it.",
        ),
        Claim(
            "few terms of the sum are enough",
            "figs 7.1-7.3",
            verdict(abs(by_images[-1] - 0.5) < 1e-10 and _falling([-v for v in by_images])),
            by_images,
            "sup over t in (0, 10] of the sum cut at abs(m) <= N, N = 0 to 8.",
        ),
    ]


def _results(study: Study, runs: list[ExampleRun], printed: bool) -> list[Claim]:
    errors = _last(runs)
    first = float(runs[0].max_abs_error[0])
    reductions = [1 - error / first for error in errors]
    accurate = all(error < _ACCURATE for error in errors)
    why = _why_not() if printed else _HEAT_ONLY

    def found(holds: bool) -> str:
        return verdict(holds and printed, holds)

    five = "delta = .25, .15, .10, .05, .02 min."
    return [
        Claim(
            "the largest error is below 1 after 5 iterations, for each delta",
            "sec. 7.5 (i)",
            found(accurate),
            errors,
            f"max|e^5| for {five} {why}",
        ),
        Claim(
            "it falls by at least 96 %, for each delta",
            "sec. 7.5 (iii)",
            found(min(reductions) >= _REDUCTION - 5e-5),
            reductions,
            f"1 - max|e^5|/max|e^0| for {five} To the hundredth of a per cent."
            + ("" if printed else f" {_HEAT_ONLY}"),
        ),
        Claim(
            "a smaller delta is more accurate",
            "sec. 7.5 (ii)",
            found(_falling(errors) and accurate),
            errors,
            "Differences between runs that did not learn are no accuracy."
            if printed
            else f"{_HEAT_ONLY} At iteration 5 only, and only because g = 1 sets in at once: see "
            "below.",
        ),
        _finer(study),
    ]


def _why_not() -> str:
    wanted = reference(times(STEP))
    a_trial = abs(RHO) * float(np.abs(np.diff(wanted)).max()) / STEP
    held = wanted[round(_AT / STEP)] / _gain_at_rest()
    return (
        "What flows out with the advection, 2(t + 1/2) y, leaves the input no integral; a D-law "
        f"gives about {a_trial:.1f} per trial at most, and at t = {_AT:g} it takes an input of "
        f"{held:.0f} to hold y^d."
    )


def _finer(study: Study) -> Claim:
    runs = [study.run(step=step) for step in _STEPS]
    errors = _last(runs)
    return Claim(
        "finer sampling is more accurate",
        "sec. 7.5 (iii)",
        verdict(_falling(errors) and errors[-1] < 0.98 * errors[0]),
        errors,
        "max|e^5| for delta = .25 at 0.02, 0.01 and 0.005 min; better counts from 2 % on.",
    )


def _long_run(study: Study) -> Claim:
    runs = [study.run(delta=delta, iterations=_LONG) for delta in _LONG_DELTAS]
    least = [float(run.max_abs_error.min()) for run in runs]
    errors = [float(run.max_abs_error[-1]) for run in runs]
    sound = [
        run.diverged is None and error <= 1.1 * low
        for run, error, low in zip(runs, errors, least, strict=True)
    ]
    ends = [f"{d}: {_ended(run)}" for d, run in zip(_LONG_DELTAS, runs, strict=True)]
    return Claim(
        "the law converges, for each delta that meets (7.13)",
        "theorems 7.1, 7.2",
        verdict(all(sound)),
        errors,
        f"max|e| of the last of {_LONG} iterations that could be computed, delta = "
        f"{_listed_deltas()}. "
        f"It has no filter: what grows is fast. {'; '.join(ends)}.",
    )


def _listed_deltas() -> str:
    return ", ".join(f"{delta:g}" for delta in _LONG_DELTAS)


def _ended(run: ExampleRun) -> str:
    if run.diverged is not None:
        return f"not computable from iteration {run.diverged} on"
    at = int(run.max_abs_error.argmin())
    return f"least {run.max_abs_error[at]:.3g} at iteration {at}"


@cache
def _gain_at_rest() -> float:
    """y/u of the printed plant at ``_AT``, for an input that was held from the start on."""
    output = AdvectionPlant().output(np.full(len(times(STEP)), _PULL))
    return float(output[round(_AT / STEP)]) / _PULL


def _at_rest() -> Claim:
    gain, balance = _gain_at_rest(), -1 / (2 * _AT + 1)
    return Claim(
        "the input acts as an integral, as (7.8) has it",
        "sec. 7.4 and 7.5",
        verdict(abs(gain) >= _AT / 2),
        gain,
        f"y({_AT:g})/u for u = {_PULL:g} from t = 0 on; an integral would give {-_AT:g}, what "
        f"flows out makes it -1/(2t + 1) = {balance:.4f}.",
    )


def _by_the_d_law(study: Study) -> Claim:
    runs = [study.run(delta=delta, iterations=_LONG) for delta in _LONG_DELTAS]
    least = [float(run.max_abs_error.min()) for run in runs]
    return Claim(
        "the printed plant can be learned by the D-law",
        "sec. 7.5, (7.10)",
        verdict(min(least) < _ACCURATE),
        least,
        f"Least max|e| in {_LONG} iterations, delta = {_listed_deltas()}.",
        ours=True,
    )


def _learnable() -> list[Claim]:
    steady = STEADY.learn(13).max_abs_error
    by_time = BY_TIME.learn(ITERATIONS).max_abs_error
    other = "Another law than the thesis's: (7.10) with P for D, and Q."
    return [
        Claim(
            "the printed plant can be learned by P with lead and Q",
            "sec. 7.5, with another law",
            verdict(bool(steady[-1] < _ACCURATE)),
            [float(error) for error in steady],
            f"{other} u[t] += -4 e(t + 0.10), Q with N0 = 20; iterations 0 to 13.",
            ours=True,
        ),
        Claim(
            "and by 96 % within 5 iterations",
            "sec. 7.5, with another law",
            verdict(bool(by_time[-1] <= (1 - _REDUCTION) * by_time[0])),
            [float(error) for error in by_time],
            f"{other} u[t] += -0.5 (2t + 3) e(t + 0.10), N0 = 10: the gain at rest falls with "
            "time, the correction rises with it.",
            ours=True,
        ),
    ]


def _nearly_no_advection() -> Claim:
    carried = (0.0, 0.005, 0.01, 2.0)
    worst = []
    for varsigma in carried:
        run = variant(DELTA, varsigma)
        worst.append(float(1 - run.max_abs_error[-1] / run.max_abs_error[0]))
    return Claim(
        "without advection, or nearly so, it falls by at least 96 % with phi, too",
        "sec. 7.5 (iii), with another varsigma",
        verdict(min(worst[:2]) >= _REDUCTION > worst[-1]),
        worst,
        "delta = .25, phi clipped, varsigma = 0, 0.005, 0.01, and 2 as printed. Whether the heat "
        "equation or one of these was run cannot be told.",
        ours=True,
    )


def _contraction(study: Study) -> list[Claim]:
    bound = promised(RHO, _SHORTEST)
    errors = study.run(delta=_SHORTEST).max_abs_error
    factors = [float(after / before) for before, after in pairwise(errors)]
    return [
        Claim(
            "no trial leaves more of the error than theorem 7.1 allows",
            f"(7.13), delta = {_SHORTEST:g}",
            verdict(max(factors) <= bound),
            [bound, *factors],
            "Factor per trial: the bound's, without the rest (7.14) that it allows beside, then "
            f"those of max|e| in the {len(factors)} trials of the example.",
        ),
        Claim(
            "this bound is sharp: learning is no faster",
            f"(7.13), delta = {_SHORTEST:g}",
            verdict(bound < 2 * factors[0]),
            [bound, factors[0]],
            f"The bound and the first trial. theta(1, {_SHORTEST:g}) is "
            f"{float(theta(1.0, _SHORTEST)):.1e}, but slow errors shrink by "
            f"abs(1 + rho) = {abs(1 + RHO):.3f}.",
            ours=True,
        ),
    ]


def _own_rule(runs: list[ExampleRun]) -> Claim:
    inputs = [float(np.abs(run.traces["input"]).max()) for run in runs]
    gammas = [promised(RHO, delta) for delta in DELTAS]
    allowed = [_longest(gamma, most) for gamma, most in zip(gammas, inputs, strict=True)]
    return Claim(
        "the five delta meet the thesis's own rule, (7.18)",
        "(7.18), sec. 7.5",
        verdict(all(d <= most for d, most in zip(DELTAS, allowed, strict=True))),
        allowed,
        "The longest delta that (7.18) allows for an accuracy of 1, at the factor of (7.13) of "
        f"each, with the largest input so far ({min(inputs):.0f} to {max(inputs):.0f}) for its "
        f"bound; with any gain at most {_longest(0.0, min(inputs)):.4f}. A bound of 100 makes "
        f"that {_longest(0.0, 100.0):.4f}, less than a sample.",
    )


def _longest(gamma: float, input_bound: float) -> float:
    """(7.18): the delta, min."""
    return (1 - gamma) * _ACCURATE / (2 * input_bound * (2 + gamma))


def _without_inflow() -> Claim:
    plant = heat_plant(replace(CHAPTER7, inflow=0.0))
    errors = _last([learn(plant, law(delta), ITERATIONS) for delta in DELTAS])
    return Claim(
        "a smaller delta is more accurate because it looks ahead less",
        "sec. 7.5 (ii)",
        verdict(_falling(errors)),
        errors,
        "max|e^5| with g = 0, where the rod is consistent at t = 0: now a larger delta is better. "
        "With g = 1 the first moments cannot be learned by any input.",
        ours=True,
    )
