"""How much a fish has changed: one repeat of the best input against the trials before.

max|e| alone shows little of it: near the error bound it sits where the fish is too fast, and a
weaker fish makes it smaller there. So the thrust is compared, too: the speeds of every trial
against those of a model with the same input, as slope (thrust) and offset (flow). The error of the
model is the same before and after, and cancels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.core.trial_file import Trial
from tailbeat.learning.convergence import (
    NoiseBand,
    Score,
    best_of,
    expected_band,
    noise_band,
    repeat_limits,
    score_of,
)
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.scatter import Scatter

Remedy = Literal["go on", "learn on", "trim", "identify"]

IDENTIFY_AGAIN = 0.10  # of the thrust: beyond it the law was designed for another fish
_LIKE_RAD = 0.05  # RMS over beats: inputs so alike are missed by a model alike
_BEAT_SIGMA_M_S = 0.0013  # so that it makes 0.008 in 40 beats of the thesis, 0.03 in 8 (tank plant)
_PRIOR_FREEDOM = 4  # as verdict.noise_band has it
_TAIL = 0.025


@dataclass(frozen=True)
class FishChange:
    """One repeat of the best against what it was. ``speed_shift_m_s``: mean over beats of the
    repeat's speed less the best's, with its standard error. ``low_m_s`` to ``high_m_s``: max|e|
    that a repeat has in 95 of 100 cases. ``thrust``: the repeat's speeds over those before, by the
    model; ``thrust_low`` to ``thrust_high``: the same of 95 of 100 repeats; ``against``: over how
    many trials. ``within``: the repeat is in both bands. ``words``: what it means and what to do,
    which ``remedy`` names."""

    best_trial: int
    best_max_abs_error_m_s: float
    repeat_trial: int
    repeat_max_abs_error_m_s: float
    low_m_s: float
    high_m_s: float
    speed_shift_m_s: float
    speed_shift_sigma_m_s: float
    thrust: float
    thrust_low: float
    thrust_high: float
    against: int
    within: bool
    remedy: Remedy
    words: str = ""


def change_of(
    series: Sequence[Trial],
    repeat: Trial,
    model: FishModel,
    identified: Identified | None = None,
    straight: HeadingDrift | None = None,
) -> FishChange:
    """``series``: what was executed of this reference before, without the discarded. ``model``: the
    identified fish's, or the board's. Raises InputError when none of them swam the repeat's
    amplitudes."""
    scores = [score_of(trial) for trial in series]
    again = score_of(repeat)
    best = best_of([score for score in scores if score.input_crc == again.input_crc])
    if best is None:
        raise _nothing_to_compare()
    original = series[next(at for at, score in enumerate(scores) if score is best)]
    band = noise_band(scores, _expected(original, identified))
    low, high = repeat_limits(scores, best.input_crc, band)
    thrust = _thrust(series, scores, repeat, model, identified)
    slower, sigma = _mean_shift(original, repeat)
    worst = again.max_abs_error_m_s
    within = low <= worst <= high and thrust.low <= thrust.now <= thrust.high
    turned = straight is not None and straight.crooked
    found = FishChange(
        best_trial=best.trial,
        best_max_abs_error_m_s=best.max_abs_error_m_s,
        repeat_trial=repeat.number,
        repeat_max_abs_error_m_s=worst,
        low_m_s=low,
        high_m_s=high,
        speed_shift_m_s=slower,
        speed_shift_sigma_m_s=sigma,
        thrust=thrust.now,
        thrust_low=thrust.low,
        thrust_high=thrust.high,
        against=thrust.against,
        within=within,
        remedy=_remedy(turned, within, thrust),
    )
    return replace(found, words=_words(found, straight if turned else None))


def _remedy(turned: bool, within: bool, thrust: _Thrust) -> Remedy:
    if turned:
        return "trim"
    if within:
        return "go on"
    far = thrust.against > 0 and abs(thrust.now - 1) > IDENTIFY_AGAIN
    return "identify" if far else "learn on"


def require_best(series: Sequence[Trial], input_crc: int) -> None:
    """Raises InputError when no judged trial of the series swam this input."""
    if best_of([s for s in map(score_of, series) if s.input_crc == input_crc]) is None:
        raise _nothing_to_compare()


def _nothing_to_compare() -> InputError:
    return InputError(
        "no trial of the experiment executed the board's best input: there is nothing to compare"
        " a repeat with.",
        "Name the experiment they were executed in, or go on: tailbeat trial run",
    )


def _expected(original: Trial, identified: Identified | None) -> NoiseBand | None:
    if identified is None:
        return None

    wanted = Reference(original.beat_s, original.beats.reference_m_s, "")
    return expected_band(identified, wanted, original.beats.applied_rad)


@dataclass(frozen=True)
class _Thrust:
    now: float
    low: float
    high: float
    against: int


def _thrust(
    series: Sequence[Trial],
    scores: Sequence[Score],
    repeat: Trial,
    model: FishModel,
    identified: Identified | None,
) -> _Thrust:
    """Of the repeat over the mean of the trials whose input was as good as the same."""

    before = [
        slope_of(trial, model)
        for trial, score in zip(series, scores, strict=True)
        if score.judged and _alike(trial, repeat)
    ]
    now = slope_of(repeat, model)
    usual = float(np.mean(before)) if before else math.nan
    if not (math.isfinite(now) and math.isfinite(usual) and usual > 0):
        return _Thrust(1.0, -math.inf, math.inf, 0)  # too little was measured to tell
    scatter = identified.scatter if identified is not None else Scatter()
    fit_sigma = _BEAT_SIGMA_M_S / _lever_m_s(repeat, model)
    half = _half_width(np.array(before) / usual, math.hypot(scatter.gain, fit_sigma))
    return _Thrust(now / usual, 1 - half, 1 + half, len(before))


def slope_of(trial: Trial, model: FishModel) -> float:
    """Measured speeds over the model's, as the slope of a line with an offset, which takes the
    flow. NaN: fewer than three beats were measured, or nothing was to move."""
    speed = trial.beats.speed_m_s.astype(np.float64)
    known = _known(trial)
    spread = _spread(trial, model, known)
    square = float(spread @ spread)
    if np.count_nonzero(known) < 3 or not square > 0:
        return math.nan
    return float(spread @ speed[known]) / square


def _lever_m_s(trial: Trial, model: FishModel) -> float:
    """By which a beat's scatter is divided to make the slope's: a short or slow swim tells less."""
    return float(np.linalg.norm(_spread(trial, model, _known(trial))))


def _known(trial: Trial) -> NDArray[np.bool_]:
    speed = trial.beats.speed_m_s
    return np.isfinite(speed) & (np.arange(len(speed)) < trial.executed_beats)


def _spread(trial: Trial, model: FishModel, known: NDArray[np.bool_]) -> F64:
    """The model's speeds of the known beats, less their mean."""
    amplitude_rad = np.nan_to_num(trial.beats.applied_rad.astype(np.float64))
    told = np.asarray(model.beats(amplitude_rad, trial.beat_s), dtype=np.float64)[known]
    return told - told.mean() if told.size else told


def _alike(trial: Trial, repeat: Trial) -> bool:
    mine, other = trial.beats.applied_rad, repeat.beats.applied_rad
    if mine.shape != other.shape:
        return False
    return float(np.sqrt(np.nanmean((mine - other) ** 2))) <= _LIKE_RAD


def _half_width(relative: F64, expected_sigma: float) -> float:
    """Of the 95 % band of one more trial. What was seen is pooled with what is expected, which
    counts as four degrees of freedom; never narrower than expected."""
    from statistics import NormalDist

    from scipy.special import stdtrit

    freedom = len(relative) - 1
    usual = expected_sigma * -NormalDist().inv_cdf(_TAIL)  # a few trials may be alike by chance
    prior = usual / float(stdtrit(_PRIOR_FREEDOM, 1 - _TAIL))
    squares = float(np.sum((relative - relative.mean()) ** 2))
    together = _PRIOR_FREEDOM + freedom
    sigma = math.sqrt((_PRIOR_FREEDOM * prior**2 + squares) / together)
    half = max(float(stdtrit(together, 1 - _TAIL)) * sigma, usual)
    return half * math.sqrt(1 + 1 / len(relative))


def _mean_shift(original: Trial, repeat: Trial) -> tuple[float, float]:
    difference = repeat.beats.speed_m_s.astype(np.float64) - original.beats.speed_m_s
    known = difference[np.isfinite(difference)]
    if known.size < 2:
        return math.nan, math.nan
    return float(known.mean()), float(known.std(ddof=1) / math.sqrt(known.size))


_REMEDIES: dict[Remedy, str] = {
    "go on": "Go on: tailbeat trial run",
    "learn on": "Let it learn on, a trial or two take that up: tailbeat trial run",
    "trim": "Trim it again: tailbeat session trim; then tailbeat session resume",
    "identify": "Identify it again: tailbeat session identify,"
    " tailbeat session design --apply; then go on",
}


def _words(found: FishChange, straight: HeadingDrift | None) -> str:
    """``straight``: of a repeat that turned."""
    thrust = "thrust not known"
    if found.against:
        band = f"{found.thrust_low:.2f} to {found.thrust_high:.2f} are noise"
        thrust = f"thrust {found.thrust:.2f} of what it was ({band})"
    figures = (
        f"max|e| {mm(found.repeat_max_abs_error_m_s)} mm/s (95 of 100 repeats have "
        f"{mm(found.low_m_s)} to {mm(found.high_m_s)}), {thrust}"
    )
    repeats = f"trial {found.repeat_trial} repeats trial {found.best_trial}"
    if found.remedy == "go on":
        return f"{repeats} within noise: {figures}. {_REMEDIES[found.remedy]}"
    faster = found.speed_shift_m_s
    if math.isfinite(faster):
        figures += f", {mm(abs(faster))} mm/s {'slower' if faster < 0 else 'faster'} on average"
    if straight is not None:
        figures += f"; it turned by {math.degrees(straight.worst_yaw_rad):+.0f} degrees"
    return f"{repeats}, but the fish has changed: {figures}. {_REMEDIES[found.remedy]}"
