"""Chapter 7: a rod whose heat is carried along and taken up; D-type law with a lead.

Its claims on the Theta function and on the example (section 7.5): by the plant as printed, and by
the heat equation alone, where the thesis's numbers do come out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import (
    Example,
    ExampleRun,
    Found,
    claim,
)
from tailbeat.studies.thesis.plants import advection, heat
from tailbeat.studies.thesis.study import Study, once

_KNOWS = frozenset({"step", "iterations", "delta"})
_example = partial(Example, law="D-type with lead (7.10)", prepare=advection.prepare)
PRINTED = _example(
    "ch7-printed", "Advection and Monod uptake (7.31), phi clipped below v = 0 unless --uptake",
    setting=advection.printed_plant, knows=_KNOWS | {"uptake"}, weight=4.0,
)  # fmt: skip
HEAT = _example(
    "ch7-heat", "The heat equation (7.3): (7.31) without advection and uptake",
    setting=advection.rod_plant, knows=_KNOWS, weight=3.0,
)  # fmt: skip
EXAMPLES = (PRINTED, HEAT)

_ACCURATE = 1.0  # epsilon of the example
_REDUCTION = 0.96
_STEPS = (0.02, heat.STEP, 0.005)
_LONG, _LONG_DELTAS = 60, (0.25, 0.10, 0.02)
_LISTED = ", ".join(f"{delta:g}" for delta in _LONG_DELTAS)
_SHORTEST = advection.DELTAS[-1]
_PULL, _AT = -100.0, 5.0  # input that is held, and when its output is looked at, min
_FIVE = "delta = .25, .15, .10, .05, .02 min."


def _all_deltas(study: Study) -> list[ExampleRun]:
    return [study.run(delta=delta) for delta in advection.DELTAS]


def _long_runs(study: Study) -> list[ExampleRun]:
    return [study.run(delta=delta, iterations=_LONG) for delta in _LONG_DELTAS]


def _last(runs: list[ExampleRun]) -> F64:
    """Errors of the last iteration, infinite where it did not get there."""
    return np.array([run.max_abs_error[-1] if run.diverged is None else np.inf for run in runs])


def _falling(values: ArrayLike) -> bool:
    return bool(np.all(np.diff(values) < 0))


@claim(PRINTED, "7-gain")
def _gain(study: Study) -> Found:
    gain = advection.gain_for(advection.DELTA)
    return Found(abs(gain - advection.RHO) < 5e-5, gain)


_TIME: F64 = np.linspace(0.001, heat.HORIZON, 100_001)


@claim(PRINTED, "7-half")
def _at_most_half(study: Study) -> Found:
    most = np.max(advection.theta(1.0, _TIME))
    return Found(most <= 0.5 + 1e-12, most, "sup over t in (0, 10]; theta(1, t) rises to it.")


def _by_images() -> F64:
    """The sum's largest values, cut at 0 to 8 images."""
    return np.array([np.max(advection.theta(1.0, _TIME, images)) for images in range(9)])


@claim(PRINTED, "7-terms")
def _few_terms(study: Study) -> Found:
    found = _by_images()
    note = "sup over t in (0, 10] of the sum cut at abs(m) <= N, N = 0 to 8."
    return Found(abs(found[-1] - 0.5) < 1e-10 and _falling(-found), found, note)


@once
def _heat(study: Study) -> Study:
    """The heat equation with the same options: the reading F = 0."""
    return study.beside(HEAT)


_HEAT_ONLY = "as printed, then with F = 0, the heat equation alone, which is the reading."


@claim(PRINTED, "7-below-1")
def _accurate(study: Study) -> Found:
    printed, heated = (_last(_all_deltas(one)) for one in (study, _heat(study)))
    holds, reading = (bool(np.all(errors < _ACCURATE)) for errors in (printed, heated))
    note = f"max|e^5| for {_FIVE[:-1]}, {_HEAT_ONLY} {_why_not()}"
    return Found(holds, [*printed, *heated], note, reading)


@claim(PRINTED, "7-96-percent")
def _reduced(study: Study) -> Found:
    found = []
    for one in (study, _heat(study)):
        runs = _all_deltas(one)
        found.append(1 - _last(runs) / runs[0].max_abs_error[0])
    holds, reading = (bool(np.min(one) >= _REDUCTION - 5e-5) for one in found)
    note = f"1 - max|e^5|/max|e^0| for {_FIVE[:-1]}, to the hundredth of a per cent, {_HEAT_ONLY}"
    return Found(holds, np.concatenate(found), note, reading)


@claim(PRINTED, "7-smaller-delta")
def _smaller_delta(study: Study) -> Found:
    printed, heated = (_last(_all_deltas(one)) for one in (study, _heat(study)))
    holds, reading = (_falling(one) and bool(np.all(one < _ACCURATE)) for one in (printed, heated))
    note = f"""max|e^5| for {_FIVE[:-1]}, {_HEAT_ONLY} Differences between runs that did not learn
    are no accuracy. With F = 0 it is so at iteration 5, and because g = 1 sets in at once (below,
    ours)."""
    return Found(holds, [*printed, *heated], note, reading)


def _why_not() -> str:
    samples = heat.reference(heat.times(heat.STEP))
    a_trial = abs(advection.RHO) * np.abs(np.diff(samples)).max() / heat.STEP
    held = samples[round(_AT / heat.STEP)] / _gain_at_rest()
    return (
        "What flows out with the advection, 2(t + 1/2) y, leaves the input no integral. A D-law "
        f"gives about {a_trial:.1f} per trial at most. At t = {_AT:g} it takes an input of "
        f"{held:.0f} to hold y^d."
    )


@claim(PRINTED, "7-finer")
def _finer(study: Study) -> Found:
    printed, heated = (
        _last([one.run(step=step) for step in _STEPS]) for one in (study, _heat(study))
    )
    still = np.array([_without_advection(step) for step in _STEPS])
    holds, *readings = (_better_when_finer(one) for one in (printed, heated, still))
    note = """max|e^5| for delta = .25 at 0.02, 0.01 and 0.005 min: as printed, with F = 0, and with
    the source phi clipped but no advection, which is the reading. Only time is refined; a delta of
    .05 or less gets worse."""
    return Found(holds, [*printed, *heated, *still], note, any(readings))


def _without_advection(step: float) -> float:
    plant = advection.AdvectionPlant(step, carried=0.0)
    law = advection.law(advection.DELTA, step)
    return float(heat.problem(plant, law).uncut(advection.ITERATIONS)[-1])


def _better_when_finer(errors: F64) -> bool:
    return _falling(errors) and bool(errors[-1] < 0.98 * errors[0])


@claim(PRINTED, "7-rule")
def _own_rule(study: Study) -> Found:
    largest = [float(np.abs(run.traces.trial()[0]).max()) for run in _all_deltas(study)]
    gammas = [advection.contraction_bound(advection.RHO, delta) for delta in advection.DELTAS]
    allowed = [longest(gamma, most) for gamma, most in zip(gammas, largest, strict=True)]
    note = f"""The longest delta that (7.18) allows for an accuracy of 1, at the factor of (7.13) of
    each, with the largest input so far ({min(largest):.0f} to {max(largest):.0f}) for its bound;
    with any gain at most {longest(0.0, min(largest)):.4f}. A bound of 100 makes that
    {longest(0.0, 100.0):.4f}, less than a sample."""
    return Found(np.all(np.array(advection.DELTAS) <= allowed), allowed, note)


def longest(gamma: float, input_bound: float) -> float:
    """(7.18): the delta, min."""
    return (1 - gamma) * _ACCURATE / (2 * input_bound * (2 + gamma))


@claim(HEAT, "7-no-advection")
def _nearly_no_advection(study: Study) -> Found:
    plants = [advection.AdvectionPlant(carried=carried) for carried in (0.0, 0.005, 0.01, 2.0)]
    runs = [
        heat.problem(plant, advection.law(advection.DELTA)).uncut(advection.ITERATIONS)
        for plant in plants
    ]
    worst = [1 - errors[-1] / errors[0] for errors in runs]
    note = """delta = .25, phi clipped, varsigma = 0, 0.005, 0.01, and 2 as printed. Whether the
    heat equation or one of these was run is unknown."""
    return Found(min(worst[:2]) >= _REDUCTION > worst[-1], worst, note)


@claim(HEAT, "7-theorem-7.1")
def _contraction(study: Study) -> Found:
    return _in_the_neighbourhood(study, lambda run: 0.0)


@claim(PRINTED, "7-theorem-7.2")
def _long_run(study: Study) -> Found:
    return _in_the_neighbourhood(study, lambda run: _largest_source(run.traces.trial()[0]))


def _largest_source(values: F64) -> float:
    """F-bar: the largest abs(F) of (7.31) in a trial of the printed plant, phi clipped."""
    plant = advection.AdvectionPlant()
    v = plant.field(values)
    x, t = np.linspace(0.0, 1.0, v.shape[1]), plant.time[:, None]
    slope = np.gradient(v, x, axis=1)
    taken_up = -3.2 * np.maximum(v, 0.0) / (1.0 + np.maximum(v, 0.0))
    source = -2.0 * ((t + x) * v + (x * t + x**2 / 2) * slope) + taken_up
    return float(np.abs(source).max())


_LAMBDA_MAX = 10.0  # 1/min


def _in_the_neighbourhood(study: Study, source: Callable[[ExampleRun], float]) -> Found:
    """The last of the long runs against (7.15) or, with a source F, (7.30). u-bar: the largest
    input of that trial."""
    ends, bounds, weights = [], [], []
    for run, delta in zip(_long_runs(study), _LONG_DELTAS, strict=True):
        values, output = run.traces.trial()
        bound = _bound(delta, float(np.abs(values).max()), source(run))
        time = run.traces.problem.times
        error = np.abs(heat.reference(time) - output)
        ends.append(float(error.max()))
        bounds.append(bound)
        weights.append(_least_lambda(time, error, bound))
    within = [end <= bound for end, bound in zip(ends, bounds, strict=True)]
    note = f"""max|e| of the last iteration of {_LONG} that could be computed, delta = {_LISTED},
    then the bounds, then the least lambda, 1/min, with which the lambda-norm is within them.
    (7.12) is not enforced: u-bar is the largest input of that trial. Without a filter fast errors
    grow, so the run at the largest delta means little."""
    reading = all(np.isfinite(weights)) and max(weights) <= _LAMBDA_MAX
    return Found(all(within), [*ends, *bounds, *weights], note, reading)


def _bound(delta: float, input_bound: float, source_bound: float) -> float:
    """((1 + rho_1) l_1 / (1 - gamma)) of theorems 7.1 and 7.2: (7.14), (7.22). The sum of both
    theta in (7.22) covers a period, whose heat is 1."""
    time = np.linspace(delta / 2000, delta, 2000)
    reached = float(np.trapezoid(advection.theta(1.0, time), time))
    gamma = advection.contraction_bound(advection.RHO, delta)
    inner = 4 * input_bound * reached + 2 * source_bound * delta
    return (1 + abs(advection.RHO)) * inner / (1 - gamma)


def _least_lambda(time: F64, error: F64, bound: float) -> float:
    """The least with which exp(-lambda t) error is nowhere above the bound; infinite when no number
    is."""
    above = error > bound
    if not above.any():
        return 0.0
    if time[above].min() <= 0 or not np.all(np.isfinite(error)):
        return float("inf")
    return float((np.log(error[above] / bound) / time[above]).max())


def _factors(study: Study) -> list[float]:
    errors = study.run(delta=_SHORTEST).max_abs_error
    return [float(after / before) for before, after in pairwise(errors)]


@claim(HEAT, "7-sharp")
def _sharp(study: Study) -> Found:
    bound, first = advection.contraction_bound(advection.RHO, _SHORTEST), _factors(study)[0]
    note = f"""The bound and the first trial. theta(1, {_SHORTEST:g}) is
    {float(advection.theta(1.0, _SHORTEST)):.1e}, but slow errors decrease by abs(1 + rho) =
    {abs(1 + advection.RHO):.3f}."""
    return Found(bound < 2 * first, [bound, first], note)


@claim(HEAT, "7-inflow")
def _without_inflow(study: Study) -> Found:
    plant = heat.heat_plant(replace(heat.CHAPTER7, inflow=0.0))
    errors = [
        heat.problem(plant, advection.law(delta)).uncut(advection.ITERATIONS)[-1]
        for delta in advection.DELTAS
    ]
    note = """max|e^5| with g = 0, where the rod is consistent at t = 0: now a larger delta is
    better. With g = 1 the first moments cannot be learned by any input."""
    return Found(_falling(errors), errors, note)


@cache
def _gain_at_rest() -> float:
    """y/u of the printed plant at ``_AT``, for an input that was held from the start on."""
    output = advection.AdvectionPlant().output(np.full(len(heat.times(heat.STEP)), _PULL))
    return float(output[round(_AT / heat.STEP)]) / _PULL


@claim(PRINTED, "7-integral")
def _at_rest(study: Study) -> Found:
    gain, balance = _gain_at_rest(), -1 / (2 * _AT + 1)
    note = f"""y({_AT:g})/u for u = {_PULL:g} from t = 0 on; an integral would give {-_AT:g}, what
    flows out makes it -1/(2t + 1) = {balance:.4f}."""
    return Found(abs(gain) >= _AT / 2, gain, note)


@claim(PRINTED, "7-d-law")
def _by_the_d_law(study: Study) -> Found:
    least = [run.max_abs_error.min() for run in _long_runs(study)]
    note = f"Least max|e| in {_LONG} iterations, delta = {_LISTED}."
    return Found(min(least) < _ACCURATE, least, note)


_OTHER_LAW = "Another law than the thesis's: (7.10) with P for D, and Q."


@claim(PRINTED, "7-p-law")
def _steady(study: Study) -> Found:
    found = advection.STEADY.problem().uncut(13)
    note = f"{_OTHER_LAW} u[t] += -4 e(t + 0.10), Q with N0 = 20; iterations 0 to 13."
    return Found(found[-1] < _ACCURATE, found, note)


@claim(PRINTED, "7-p-law-time")
def _by_time(study: Study) -> Found:
    found = advection.BY_TIME.problem().uncut(advection.ITERATIONS)
    note = f"""{_OTHER_LAW} u[t] += -0.5 (2t + 3) e(t + 0.10), N0 = 10: the gain at rest falls with
    time, the correction rises with it."""
    return Found(found[-1] <= (1 - _REDUCTION) * found[0], found, note)
