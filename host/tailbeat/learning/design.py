"""Gain, lead and filter for a fish, with a certificate of what they will do.

Proved, for small errors around speeds outside the dead zone, for every model of the identified set:
the ratios (``certificate``). Simulated: the series of a whole learning (``series``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.core.reference import Reference
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.law_prediction import (
    FREQUENCIES,
    ExpectedSeries,
    Plants,
    expected_series,
    input_norm,
    plants_of,
    worst_ratio,
)
from tailbeat.learning.planner import Plan, plan

LEAD_MAX_BEATS = 16.0
_SLOPES = 5  # speeds at which the map's slope is looked at
_Q_LENS = (1, 2, 3, 4, 6, 8)
_GAIN_MIN = 0.05  # of static_gain_best
_GAIN_STEP = 0.01
_AS_GOOD = 0.02  # ratios nearer than this are equals
_MEAN_WEIGHT = 0.1
_NEUTRAL = 0.002  # a ratio this near to 1: neither shrinks nor grows
_MILD = 1.05
_FAST = math.sqrt(2)  # doubles in two trials


@dataclass(frozen=True)
class Design:
    """``ratio``: the worst over models and speeds, per frequency (cycles/beat). ``ratio_max`` over
    all frequencies; ``ratio_dc`` at 0; ``ratio_slow``: over all frequencies at lower speeds, from
    ``slow_from_m_s`` on. ``input_ratio``: the saturated law's, ||Q(I - L G)||_2 of the input error
    towards the fixed point, on ``input_beats`` beats of the trial. ``static_gain_max``: 2/Gmax, no
    gain above contracts at DC; ``static_gain_best``: 2/(Gmin + Gmax). ``speeds_m_s``: the range it
    is stated for. ``floor_m_s``: max|e| of the best amplitudes by the model. ``refused``: why it
    must not be used ("" = may); ``warnings``: one line each."""

    law: Law
    frequency_cycles: F64
    ratio: F64
    ratio_max: float
    ratio_dc: float
    ratio_slow: float
    input_ratio: float
    input_beats: int
    static_gain_best: float
    static_gain_max: float
    speeds_m_s: tuple[float, float]
    slow_from_m_s: float
    models: int
    floor_m_s: float
    series: ExpectedSeries
    refused: str = ""
    warnings: list[str] = field(default_factory=list)

    @property
    def worst_cycles(self) -> float:
        """Where ``ratio_max`` is, cycles/beat."""
        return float(self.frequency_cycles[int(np.argmax(self.ratio))])


@dataclass(frozen=True)
class _Choice:
    gain: float
    lead_beats: float
    q_len: int
    ratio: F64

    @property
    def worst(self) -> float:
        return float(self.ratio.max())

    @property
    def mean(self) -> float:
        return float(self.ratio.mean())


def design(
    identified: Identified,
    reference: Reference,
    amplitude_max_rad: float,
    gain: float | None = None,
    lead_beats: float | None = None,
    q_len: int | None = None,
    iterations: int = 10,
    step_max_rad: float = 0.0,
) -> Design:
    """The law with the smallest worst ratio; what is given is kept and judged. Leads are multiples
    of half a beat.

    Gains are sought up to ``static_gain_best`` only. Beyond it the highest frequencies of a
    sluggish fish would shrink a little faster still, but slow errors, which are nearly all of a
    learning trial's, shrink slower, and each trial's noise comes back larger: by a/(2 - a) in
    variance for a = gain*slope, 1 at that gain and 7 at 1.75. Laws whose worst ratios are nearly
    equal are told apart by the mean ratio, then by the smaller lead. A filter is taken only when
    the lead is free and some frequency grows with every lead: it rounds off corners, which on
    references that could be followed exactly costs 2 to 7 mm/s of max|e| at length 2. Raises
    InputError when there is nothing to design for.
    """
    _check(gain, lead_beats, q_len, reference)
    models = [identified.model, *identified.models]
    plants = plants_of(models, reference, amplitude_max_rad)
    speeds = np.linspace(*plants.speeds_m_s, _SLOPES)
    slopes = np.concatenate([model.steady_slope(speeds) for model in models])
    best, limit = float(2 / (slopes.min() + slopes.max())), float(2 / slopes.max())
    leads = [lead_beats] if lead_beats is not None else _leads(models, reference)
    lengths = [q_len] if q_len is not None else [1]
    if q_len is None and lead_beats is None:
        lengths = [length for length in _Q_LENS if 2 * length - 1 <= reference.beats]
    chosen = _choose(plants, gain, leads, lengths, best)
    law = Law(
        kp_rad_s_m=chosen.gain, lead_beats=chosen.lead_beats, q_len=chosen.q_len,
        amplitude_max_rad=amplitude_max_rad, step_max_rad=step_max_rad, beat_s=reference.beat_s,
    )  # fmt: skip
    nominal = plan(identified.model, reference.speed_m_s, reference.beat_s, amplitude_max_rad)
    input_ratio, input_beats = _input_ratio(identified, nominal, plants, reference, law)
    slow = worst_ratio(plants.slow, chosen.gain, chosen.lead_beats, chosen.q_len)
    return Design(
        law=law,
        frequency_cycles=FREQUENCIES,
        ratio=chosen.ratio,
        ratio_max=chosen.worst,
        ratio_dc=float(chosen.ratio[0]),
        ratio_slow=float(slow.max(initial=0.0)),
        input_ratio=input_ratio,
        input_beats=input_beats,
        static_gain_best=best,
        static_gain_max=limit,
        speeds_m_s=plants.speeds_m_s,
        slow_from_m_s=plants.slow_from_m_s,
        models=len(models),
        floor_m_s=nominal.max_abs_error_m_s,
        series=expected_series(identified, reference, law, iterations),
        refused=_refusal(chosen, best, limit),
        warnings=_warnings(chosen, slow, plants.speeds_m_s[1], identified, reference),
    )


def _check(
    gain: float | None, lead_beats: float | None, q_len: int | None, reference: Reference
) -> None:
    if gain is not None and not (math.isfinite(gain) and gain > 0):
        raise InputError(f"a gain of {gain:g} learns nothing.", "Give one above 0, like 4.")
    if lead_beats is not None:
        low_enough = 0 <= lead_beats <= min(LEAD_MAX_BEATS, reference.beats - 1)
        if not (low_enough and 2 * lead_beats == math.floor(2 * lead_beats)):
            raise InputError(
                f"a lead of {lead_beats:g} beats cannot be.",
                f"Use 0, 0.5, 1, ... up to {LEAD_MAX_BEATS:g}, less than the trial has.",
            )
    if q_len is not None and not (q_len >= 1 and 2 * q_len - 1 <= reference.beats):
        raise InputError(
            f"a filter of {q_len} does not fit into {reference.beats} beats.", "1 is none."
        )


def _leads(models: Sequence[FishModel], reference: Reference) -> list[float]:
    """Half beats up to one beat more than the longest delay."""
    longest = max(model.delay_s for model in models) / reference.beat_s + 1
    last = min(math.ceil(2 * longest) / 2, LEAD_MAX_BEATS, reference.beats - 1)
    return [half / 2 for half in range(int(2 * last) + 1)]


def _choose(
    plants: Plants,
    gain: float | None,
    leads: Sequence[float],
    lengths: Sequence[int],
    gain_max: float,
) -> _Choice:
    """The first filter length that lets nothing grow; failing that, the smallest worst ratio."""
    found: list[_Choice] = []
    for q in lengths:
        tried = [_with_best_gain(plants, gain, lead, q, gain_max) for lead in leads]
        limit = min(choice.worst for choice in tried) + _AS_GOOD
        good = min(
            (choice for choice in tried if choice.worst <= limit),
            key=lambda choice: (round(choice.mean / _AS_GOOD), choice.lead_beats),
        )
        if good.worst <= 1 + _NEUTRAL or good.ratio[0] >= 1:  # no filter helps at 0
            return good
        found.append(good)
    return min(found, key=lambda choice: choice.worst)


def _with_best_gain(
    plants: Plants, gain: float | None, lead_beats: float, q_len: int, gain_max: float
) -> _Choice:
    """The gain with the smallest largest ratio; the mean decides where that does not depend on the
    gain (a half beat's at 0.5 cycles/beat). Where something grows with every gain the smallest
    largest ratio would be that of learning nothing: then it is the gain that is best at 0."""

    def choice(gain: float) -> _Choice:
        return _Choice(gain, lead_beats, q_len, worst_ratio(plants.fast, gain, lead_beats, q_len))

    if gain is not None:
        return choice(gain)

    def cost(gain: float) -> float:
        tried = choice(gain)
        return tried.worst + _MEAN_WEIGHT * tried.mean

    found = choice(_least(cost, gain_max))
    return found if found.worst <= 1 + _NEUTRAL else choice(_rounded_down(gain_max))


def _least(cost: Callable[[float], float], gain_max: float) -> float:
    """Where a convex cost is least, in steps of 0.01."""
    from scipy.optimize import minimize_scalar

    bounds = (_GAIN_MIN * gain_max, gain_max)
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 2e-3})
    return _rounded_down(min(float(found.x) + _GAIN_STEP / 2, gain_max))


def _rounded_down(gain: float) -> float:
    return round(math.floor(gain / _GAIN_STEP) * _GAIN_STEP, 2)


def _input_ratio(
    identified: Identified, best: Plan, plants: Plants, reference: Reference, law: Law
) -> tuple[float, int]:
    """The norm of a step in the input, the largest of the set, and on how many beats: those where
    the reference wants a speed of the certificate's range and the best amplitude is outside the
    dead zone and below the largest. Every model is taken at the same steady speeds."""
    amplitude, nominal = best.amplitude_rad, identified.model
    free = (amplitude > nominal.dead_zone_rad) & (amplitude < law.amplitude_max_rad)
    beats: NDArray[np.bool_] = free & (reference.speed_m_s >= plants.speeds_m_s[0])
    steady = nominal.steady_m_s(amplitude)
    step = (law.kp_rad_s_m, law.lead_beats, law.q_len)
    norms = [
        input_norm(model, model.amplitude_rad(steady), reference.beat_s, *step, beats)
        for model in [nominal, *identified.models]
    ]
    return max(norms), int(beats.sum())


def _refusal(choice: _Choice, best: float, limit: float) -> str:
    dc = float(choice.ratio[0])
    if dc < 1:
        return ""
    return (
        f"at gain {choice.gain:g} steady errors do not converge: ratio {dc:.2f} per trial by the "
        f"steepest map of the set. Only gains below {limit:.2f} converge, {best:.2f} fastest."
    )


def _warnings(
    choice: _Choice, slow: F64, fastest_m_s: float, identified: Identified, reference: Reference
) -> list[str]:
    everywhere = np.maximum(choice.ratio, slow)
    found = [_growth(everywhere)] if choice.ratio[0] < 1 else []
    wanted = float(np.max(reference.speed_m_s))
    if fastest_m_s < wanted:
        found.append(
            f"the reference wants {wanted * 1e3:.0f} mm/s, but the slowest model of the set "
            f"reaches {fastest_m_s * 1e3:.0f} with the largest amplitude"
        )
    for name in (name for name in identified.assumed if name in _ASSUMED):
        values = sorted({f"{getattr(model, name):g}" for model in identified.models}, key=float)
        found.append(f"{_ASSUMED[name]} assumed, {' to '.join([values[0], *values[1:][-1:]])}")
    return [line for line in found if line]


_ASSUMED = {
    "kappa_per_m": "drag over mass (1/m) is",
    "delay_s": "the delay (s) is",
    "slope_m_s_rad": "the map's slope (m/s/rad) is",
    "dead_zone_rad": "the dead zone (rad) is",
}


def _growth(ratio: F64) -> str:
    """A line on frequencies that do not shrink; "" when all do."""
    worst = float(ratio.max())
    if worst < 1 - _NEUTRAL:
        return ""
    if worst <= 1 + _NEUTRAL:
        return "errors that alternate from beat to beat neither shrink nor grow (ratio 1.00)"
    grows = FREQUENCIES[ratio > 1 + _NEUTRAL]
    where = f"{grows.min():.2f} to {grows.max():.2f} cycles/beat"
    double = math.ceil(math.log(2) / math.log(worst))
    how = "slowly" if worst < _FAST else "fast"
    line = f"errors of {where} grow {how}, by at most {worst:.2f} per trial: they double in about "
    line += f"{double} trial{'s' if double > 1 else ''}"
    if worst <= _MILD:
        return line
    return line + "; learning will get good, stall and get worse again. Choose another lead"


def law_words(law: Law) -> str:
    """``gain 4.57 rad s/m, lead 1 beat, no filter``."""
    lead = f"lead {law.lead_beats:g} beat{'' if law.lead_beats == 1 else 's'}"
    lead = lead if law.lead_beats else "no lead"
    q = f"filter of length {law.q_len}" if law.q_len > 1 else "no filter"
    return f"gain {law.kp_rad_s_m:g} rad s/m, {lead}, {q}"
