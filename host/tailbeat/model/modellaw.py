"""Learning with the model: the next amplitudes from everything that was ever swum.

A pure function of raw data, so that every decision can be made again from the trial files:
re-fit the four numbers on all swims (prior: the identified model), estimate what repeats and the
model does not explain (a Kalman filter along the iterations, per beat, for this reference; a new
one takes over the map, the drag, the delay and a flow that repeats), plan, predict with a band.
When what was measured lies outside of what was predicted, the model is refuted and the next step is
P with the designed gain and lead, until a fit on the swims since then predicts one again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat import laws
from tailbeat.errors import InputError
from tailbeat.laws import Law
from tailbeat.model.belief import Belief, believe
from tailbeat.model.fishmodel import PARAMS, FishModel
from tailbeat.model.identified import Identified
from tailbeat.model.planner import plan
from tailbeat.model.swim import SIGMA_M_S, Swim
from tailbeat.reference import Reference

Array = NDArray[np.float64]

FALLBACK = Law(kp_rad_s_m=4.0, lead_beats=1)
# Between least squares (2) and minimax (infinity). The largest error is what a fish is judged by,
# and a plan that draws the largest ones together leaves room for the scatter of swims; 6 gains
# nearly all of that and costs little elsewhere.
PLAN_POWER = 6.0

_WORDS = {
    "kappa_per_m": ("drag", "1/m", 1),
    "slope_m_s_rad": ("slope", "m/s/rad", 3),
    "dead_zone_rad": ("dead zone", "rad", 3),
    "delay_s": ("delay", "s", 2),
}


@dataclass(frozen=True)
class Proposal:
    """The next input and why. ``law``: ``model``, or ``p`` when the model was refuted.
    ``low_m_s``/``high_m_s``: 90 % band of the beats' measured speeds. ``trials``: numbers of the
    swims that the model rests on. ``chance``: of a swim as odd as the last one, by its prediction.
    ``limited_beats``: where the step limit holds the amplitude back. ``reason``: one line for
    people."""

    amplitude_rad: Array
    predicted_m_s: Array
    low_m_s: Array
    high_m_s: Array
    predicted_max_abs_error_m_s: tuple[float, float, float]  # 5 %, median, 95 %
    model: FishModel
    disturbance_m_s: Array
    law: str
    reason: str
    trials: tuple[int, ...] = ()
    chance: float = 1.0
    limited_beats: int = 0


def propose(
    identified: Identified,
    reference: Reference,
    amplitude_max_rad: float,
    swims: Sequence[Swim] = (),
    fallback: Law | None = None,
    step_max_rad: float = 0.0,
) -> Proposal:
    """``swims``: all that were swum since the identification, oldest first, of this reference (by
    CRC) and others. ``fallback``: the P law (default: gain 4, lead 1 beat). ``step_max_rad``: the
    most a beat's amplitude may differ from that of the last swim of this reference, 0 = any.

    Costs some 15 ms and 5 ms per swim. Raises InputError when ``amplitude_max_rad`` makes no sense
    or a swim has other beats than the reference it names.
    """
    belief = believe(identified, swims)
    wanted = reference.speed_m_s.astype(np.float64)
    last = _last_of(reference, swims)
    low, high = _limits(last, amplitude_max_rad, step_max_rad)
    if belief.refuted and last is not None:
        law = "p"
        amplitude = _p_step(fallback or FALLBACK, amplitude_max_rad, wanted, last)
    else:
        law = "model"
        amplitude = _planned(belief, reference, amplitude_max_rad, low, high)
    amplitude = np.clip(amplitude, low, high)
    found = belief.predict(amplitude, reference.beat_s, reference.crc, _sigma(identified, swims))
    band = found.band()
    limited = int(np.count_nonzero((amplitude == low) | (amplitude == high))) if last else 0
    return Proposal(
        amplitude_rad=amplitude,
        predicted_m_s=found.mean_m_s,
        low_m_s=band[0],
        high_m_s=band[1],
        predicted_max_abs_error_m_s=found.max_abs_error(wanted),
        model=belief.model,
        disturbance_m_s=belief.disturbance(reference.crc, reference.beats)[0],
        law=law,
        reason=_reason(belief, law),
        trials=tuple(swim.trial for swim in belief.swims),
        chance=belief.chance,
        limited_beats=limited if step_max_rad > 0 else 0,
    )


def foretold(
    identified: Identified, reference: Reference, swims: Sequence[Swim]
) -> tuple[float, float, float] | None:
    """max|e| of the last of ``swims`` by what was known before it: 5 %, median, 95 %, m/s. None
    when it was not of this reference or not measured."""
    if not swims or swims[-1].reference_crc != reference.crc or not swims[-1].measured.any():
        return None
    last = swims[-1]
    sigma = float(np.median(last.sigma_m_s[last.measured]))
    known = believe(identified, swims[:-1])
    found = known.predict(last.amplitude_rad, last.beat_s, last.reference_crc, sigma)
    return found.max_abs_error(reference.speed_m_s.astype(np.float64))


def _last_of(reference: Reference, swims: Sequence[Swim]) -> Swim | None:
    """The last swim of this reference."""
    own = [swim for swim in swims if swim.reference_crc == reference.crc and swim.measured.any()]
    if own and own[-1].beats != reference.beats:
        raise InputError(
            f"trial {own[-1].trial} has {own[-1].beats} beats, its reference {reference.beats}.",
            "Its file is damaged; take it away.",
        )
    return own[-1] if own else None


def _limits(
    last: Swim | None, amplitude_max_rad: float, step_max_rad: float
) -> tuple[Array | float, Array | float]:
    if last is None or step_max_rad <= 0:
        return 0.0, amplitude_max_rad
    low = np.clip(last.amplitude_rad - step_max_rad, 0.0, amplitude_max_rad)
    return low, np.clip(last.amplitude_rad + step_max_rad, 0.0, amplitude_max_rad)


def _planned(
    belief: Belief,
    reference: Reference,
    amplitude_max_rad: float,
    low: Array | float,
    high: Array | float,
) -> Array:
    disturbance, _ = belief.disturbance(reference.crc, reference.beats)
    scatter = belief.identified.scatter
    fastest = float(reference.speed_m_s.max())
    return plan(
        belief.model,
        reference.speed_m_s,
        reference.beat_s,
        amplitude_max_rad,
        disturbance,
        belief.typical,
        power=PLAN_POWER,
        scatter_m_s=float(np.hypot(scatter.flow_m_s, scatter.gain * fastest)),
        low_rad=low,
        high_rad=high,
    ).amplitude_rad


def _p_step(law: Law, amplitude_max_rad: float, wanted: Array, last: Swim) -> Array:
    """The P law applied to a swim."""
    limited = replace(law, amplitude_max_rad=amplitude_max_rad, beat_s=last.beat_s)
    error, measured = laws.errors_of(wanted, last.speed_m_s)
    following, _ = laws.update(limited, last.amplitude_rad, error, measured)
    return np.clip(following.astype(np.float64), 0.0, amplitude_max_rad)


def _sigma(identified: Identified, swims: Sequence[Swim]) -> float:
    """What the next swim will probably be measured with."""
    latest = [*identified.swims, *swims][-1:]
    return float(np.nanmedian(latest[0].sigma_m_s)) if latest else SIGMA_M_S


def _reason(belief: Belief, law: str) -> str:
    count = len(belief.swims)
    if law == "p":
        return "the last swim was not as the model said: a step by P, and the fit begins anew"
    if not count:
        return "planned with the identified model, before any swim"
    text = f"re-fitted on {count} swim{'s' if count > 1 else ''}"
    moved = [
        f"{_number(name, getattr(belief.model, name))} (identified {_number(name, was, bare=True)})"
        for name, was in _moved(belief)
    ]
    return f"{text}: {', '.join(moved)}" if moved else text


def _moved(belief: Belief) -> list[tuple[str, float]]:
    """The numbers that left their identified 95 % interval, and what they were."""
    identified = belief.identified
    sigma = np.sqrt(np.diag(identified.covariance) + np.diag(belief.covariance))
    found = []
    for name, s in zip(PARAMS, sigma, strict=True):
        was, now = getattr(identified.model, name), getattr(belief.model, name)
        relative = name in ("kappa_per_m", "slope_m_s_rad")
        way = np.log(now / was) if relative else now - was
        if abs(way) > 2 * s:
            found.append((name, was))
    return found


def _number(name: str, value: float, bare: bool = False) -> str:
    word, unit, digits = _WORDS[name]
    number = f"{value:.{digits}f}"
    return number if bare else f"{word} {number} {unit}"
