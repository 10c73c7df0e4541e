"""Learning with the model: the next amplitudes from everything that was ever executed.

A pure function of raw data, so that every decision can be made again from the trial files:
re-fit the four numbers on all trials (prior: the identified model, narrow or wide, as the trials
are likelier), estimate what repeats and the
model does not explain (a Kalman filter along the iterations, per beat, for this reference; a new
one takes over the map, the drag, the delay and a flow that repeats), plan, predict with a band.
When what was measured lies outside of what was predicted, the model is refuted and the next step is
P with the designed gain and lead, until a fit on the trials since then predicts one again.

Where an input came from: everything a proposal was made of, as JSON, and the way to make it
again from that and the trials.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tailbeat.core import law as laws
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.core.law import Law
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.reference import Reference
from tailbeat.core.trial_checks import best_at
from tailbeat.learning.belief import Belief, believe
from tailbeat.learning.convergence import input_crc
from tailbeat.learning.fish_model import PARAMS, SIGMA_M_S, FishModel, TrialSpeeds, last_input
from tailbeat.learning.fit import vector_of
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan
from tailbeat.learning.prediction import THRUST

FALLBACK = Law(kp_rad_s_m=4.0, lead_beats=1)
# Between least squares (2) and minimax (infinity). The largest error is what a fish is judged by,
# and a plan that draws the largest ones together leaves room for the scatter of trials; 6 gains
# nearly all of that and costs little elsewhere.
PLAN_POWER = 6.0
MISFIT_M_S = 0.006  # of a beat, RMS: no model of this form explains the fish
_NAMED_GAIN, _NAMED_FLOW_M_S = 0.02, 0.001  # smaller changes are not worth a word
_NO_THRUST = 0.75  # of the dead zone: pushes nothing even if that is smaller than believed

_WORDS = {
    "kappa_per_m": ("drag", "1/m", 1),
    "slope_m_s_rad": ("slope", "m/s/rad", 3),
    "dead_zone_rad": ("dead zone", "rad", 3),
    "delay_s": ("delay", "s", 2),
}


@dataclass(frozen=True)
class ModelStepSetting:
    """What the fish learns: a reference within limits (``step_max_rad``: the most a beat's
    amplitude may differ from that of the last trial of the reference, 0 = any). ``law``: the P law
    that stands in for a refuted model."""

    reference: Reference
    amplitude_max_rad: float
    step_max_rad: float = 0.0
    law: Law = FALLBACK


@dataclass(frozen=True)
class Proposal:
    """The next input and why. ``law``: ``model``, or ``p`` when the model was refuted.
    ``low_m_s``/``high_m_s``: 90 % band of the beats' measured speeds. ``trials``: numbers of the
    trials that the model rests on. ``chance``: of a trial as odd as the last one, by its
    prediction. ``limited_beats``: where the step limit holds the amplitude back. ``reason``: one
    line for people."""

    amplitude_rad: F64
    predicted_m_s: F64
    low_m_s: F64
    high_m_s: F64
    predicted_max_abs_error_m_s: tuple[float, float, float]  # 5 %, median, 95 %
    model: FishModel
    disturbance_m_s: F64
    law: str
    reason: str
    trials: tuple[int, ...] = ()
    chance: float = 1.0
    limited_beats: int = 0


def propose(
    identified: Identified, setting: ModelStepSetting, trials: Sequence[TrialSpeeds] = ()
) -> Proposal:
    """``trials``: all that were executed since the identification, oldest first, of this reference
    (by CRC) and others.

    Costs some 10 ms, and 15 ms per trial of 40 beats. Raises InputError when
    ``amplitude_max_rad`` makes no sense or a trial has other beats than the reference it names.
    """
    return propose_by(believe(identified, trials), setting, trials)


def propose_by(
    belief: Belief, setting: ModelStepSetting, trials: Sequence[TrialSpeeds] = ()
) -> Proposal:
    """As ``propose``, with what is believed after ``trials``."""
    identified = belief.identified
    reference, step_max_rad = setting.reference, setting.step_max_rad
    amplitude_max_rad = setting.amplitude_max_rad
    own = _trials_of(reference, trials)
    recorded = last_input(own, reference.beats)
    low, high = _limits(recorded, amplitude_max_rad, step_max_rad)
    best = _best_known(reference, belief, own)
    law = _law(belief, own, best)
    amplitude = _planned(belief, setting, low, high)
    if law == "best":
        assert best is not None
        amplitude = best
    elif law == "p" and own:
        amplitude = _p_step(setting, own[-1], np.where(np.isfinite(recorded), recorded, amplitude))
    elif law == "p":
        amplitude = _p_begin(setting)
    if step_max_rad > 0:
        amplitude = _ready(amplitude, belief.model, amplitude_max_rad)
    amplitude = np.clip(amplitude, low, high)
    found = belief.predict(amplitude, reference.beat_s, reference.crc, _sigma(identified, trials))
    band = found.band()
    pushes = np.fmax(amplitude, recorded) > belief.model.dead_zone_rad
    held = pushes & (np.abs(amplitude - recorded) >= step_max_rad * (1 - 1e-9))
    limited = int(np.count_nonzero(held)) if step_max_rad > 0 else 0
    return Proposal(
        amplitude_rad=amplitude,
        predicted_m_s=found.mean_m_s,
        low_m_s=band[0],
        high_m_s=band[1],
        predicted_max_abs_error_m_s=found.max_abs_error(reference.speed_m_s.astype(np.float64)),
        model=belief.model,
        disturbance_m_s=belief.disturbance(reference.crc, reference.beats)[0],
        law=law,
        reason=_reason(belief, law),
        trials=tuple(trial.trial for trial in belief.trials),
        chance=belief.chance,
        limited_beats=limited,
    )


def predicted_by(
    known: Belief, reference: Reference, trials: Sequence[TrialSpeeds]
) -> tuple[float, float, float] | None:
    """max|e| of the last of ``trials`` by what was known before it, over the beats that it has:
    5 %, median, 95 %, m/s. None when it was not of this reference or not measured."""
    if not trials or trials[-1].reference_crc != reference.crc or not trials[-1].measured.any():
        return None
    last = trials[-1]
    sigma = float(np.median(last.sigma_m_s[last.measured]))
    found = known.predict(last.amplitude_rad, last.beat_s, last.reference_crc, sigma)
    return found.max_abs_error(reference.speed_m_s.astype(np.float64), last.measured)


def _trials_of(reference: Reference, trials: Sequence[TrialSpeeds]) -> list[TrialSpeeds]:
    """Those of this reference."""
    own = [
        trial for trial in trials if trial.reference_crc == reference.crc and trial.measured.any()
    ]
    for trial in own:
        if trial.beats != reference.beats:
            raise InputError(
                f"trial {trial.trial} has {trial.beats} beats, its reference {reference.beats}.",
                "Its file is damaged; take it away.",
            )
    return own


def _limits(recorded: F64, amplitude_max_rad: float, step_max_rad: float) -> tuple[F64, F64]:
    """Of each beat's amplitude; a beat that was never executed may have any."""
    step = step_max_rad if step_max_rad > 0 else np.inf
    low = np.clip(np.nan_to_num(recorded - step, nan=0.0), 0.0, amplitude_max_rad)
    high = np.clip(np.nan_to_num(recorded + step, nan=np.inf), 0.0, amplitude_max_rad)
    return low, high


def _ready(amplitude_rad: F64, model: FishModel, amplitude_max_rad: float) -> F64:
    """Beats without thrust wag as much as surely pushes nothing: from 0 a limited step could end
    inside the dead zone, trial after trial, and the beat would never push again."""
    return np.maximum(amplitude_rad, min(_NO_THRUST * model.dead_zone_rad, amplitude_max_rad))


def _law(belief: Belief, own: Sequence[TrialSpeeds], best: F64 | None) -> str:
    """Which one makes the next input."""
    if belief.refuted_in_a_row == 1 and len(own) > 1 and best is not None:
        return "best"
    if belief.misfit_m_s > MISFIT_M_S or (belief.refuted and own):
        return "p"
    return "model"


def _best_known(reference: Reference, belief: Belief, own: Sequence[TrialSpeeds]) -> F64 | None:
    """The executed input of the best trial that is judged, a spoilt one if there is no other; None
    = none is judged."""
    spoilt = {swim_crc(t) for t, odd in zip(belief.trials, belief.spoilt, strict=True) if odd}
    judged = [trial for trial in own if trial.judged(reference.speed_m_s)]
    chosen = [trial for trial in judged if swim_crc(trial) not in spoilt] or judged
    best = best_at(trial.error_m_s(reference.speed_m_s) for trial in chosen)
    return None if best is None else chosen[best].amplitude_rad


def _p_begin(setting: ModelStepSetting) -> F64:
    law = replace(setting.law, amplitude_max_rad=setting.amplitude_max_rad)
    return first_amplitudes(law, setting.reference.speed_m_s).astype(np.float64)


def _planned(belief: Belief, setting: ModelStepSetting, low: F64, high: F64) -> F64:
    reference = setting.reference
    disturbance, _ = belief.disturbance(reference.crc, reference.beats)
    scatter = belief.scatter
    fastest = float(reference.speed_m_s.max())
    return plan(
        belief.model,
        reference.speed_m_s,
        reference.beat_s,
        setting.amplitude_max_rad,
        disturbance,
        belief.typical,
        power=PLAN_POWER,
        scatter_m_s=float(np.hypot(scatter.flow_m_s, scatter.gain * fastest)),
        low_rad=low,
        high_rad=high,
    ).amplitude_rad


def _p_step(setting: ModelStepSetting, last: TrialSpeeds, start_rad: F64) -> F64:
    """The P law applied to a trial: from ``start_rad``, by its errors."""
    limit_rad = setting.amplitude_max_rad
    law = replace(setting.law, amplitude_max_rad=limit_rad, beat_s=last.beat_s)
    error, measured = laws.errors_of(setting.reference.speed_m_s, last.speed_m_s)
    following, _ = laws.update(law, start_rad, error, measured)
    return np.clip(following.astype(np.float64), 0.0, limit_rad)


def _sigma(identified: Identified, trials: Sequence[TrialSpeeds]) -> float:
    """What the next trial will probably be measured with."""
    for trial in [*identified.trials, *trials][::-1]:
        known = trial.sigma_m_s[np.isfinite(trial.sigma_m_s)]
        if known.size:
            return float(np.median(known))
    return SIGMA_M_S


def _reason(belief: Belief, law: str) -> str:
    count = len(belief.trials)
    if law == "best":
        return "the last trial was not as the model said: back to the best input so far"
    if law == "p" and not belief.refuted:
        return (
            f"the model misses the beats by {belief.misfit_m_s * 1e3:.0f} mm/s: steps by P, which"
            " needs none"
        )
    if law == "p":
        return "the last trial was not as the model said: a step by P, and the fit begins anew"
    if not count:
        return "planned with the identified model, before any trial"
    text = f"re-fitted on {count} trial{'s' if count > 1 else ''}"
    moved = [*_changed(belief), *_moved(belief)]
    return f"{text}: {', '.join(moved)}" if moved else text


def _changed(belief: Belief) -> list[str]:
    """The last lasting change, in words."""
    if not belief.changes:
        return []
    last = belief.changes[-1]
    since = f"since trial {belief.trials[last.since].trial}"
    if last.kind != THRUST:
        return [f"{since} it moves like another fish (ballast, fin?)"]
    words = []
    if abs(last.log_gain) >= _NAMED_GAIN:
        change = math.expm1(last.log_gain)
        words.append(f"the same amplitude gives {change:+.0%} of speed (battery, servo, fin?)")
    if abs(last.flow_m_s) >= _NAMED_FLOW_M_S:
        words.append(f"the water moves by {last.flow_m_s * 1e3:+.1f} mm/s")
    return [f"{since} {' and '.join(words)}"] if words else []


def _moved(belief: Belief) -> list[str]:
    """The numbers that left their identified 95 % interval, and what they were."""
    identified = belief.identified
    sigma = np.sqrt(np.diag(identified.whole_covariance) + np.diag(belief.covariance))
    change = vector_of(belief.model) - vector_of(identified.model)
    found = []
    for name in np.array(PARAMS)[(np.abs(change) > 2 * sigma)[: len(PARAMS)]]:
        word, unit, digits = _WORDS[name]
        was, now = (f"{getattr(one.model, name):.{digits}f}" for one in (identified, belief))
        found.append(f"{word} {now} {unit} (identified {was})")
    return found


FORMAT = "tailbeat proposal 2"  # 1: of fish in four numbers


def document_of(
    proposal: Proposal,
    identified: Identified,
    setting: ModelStepSetting,
    trials: Sequence[TrialSpeeds],
) -> dict[str, Any]:
    """JSON types, SI units. The arguments are those ``propose`` was called with."""
    quantiles = zip(("low", "median", "high"), proposal.predicted_max_abs_error_m_s, strict=True)
    document: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "law": proposal.law,
            "reason": proposal.reason,
            "input_crc": input_crc(proposal.amplitude_rad),
            **_of(proposal, "amplitude_rad", "predicted_m_s", "low_m_s", "high_m_s"),
            "predicted_max_abs_error_m_s": dict(quantiles),
            **_of(proposal, "model", "disturbance_m_s"),
            "fitted_trials": proposal.trials,
            **_of(proposal, "chance", "limited_beats"),
            "reference": _of(setting.reference, "crc", "name", "beat_s", "speed_m_s"),
            **_of(setting, "amplitude_max_rad", "step_max_rad"),
            "fallback": setting.law,
            "swims": [{"trial": trial.trial, "crc": swim_crc(trial)} for trial in trials],
            "identified": identified.as_dict(),
        }
    )
    return document


def _of(source: object, *names: str) -> dict[str, Any]:
    return {name: getattr(source, name) for name in names}


def repropose(document: dict[str, Any], trials: Sequence[TrialSpeeds]) -> Proposal:
    """The proposal made anew; ``trials``: of the fish, in any order, those it names among them.

    Raises InputError when one is missing or no longer what it was, the document is damaged, or an
    earlier law has made it.
    """
    if document.get("format") != FORMAT:
        raise InputError(
            f"this proposal is of another law ({document.get('format')}; here it is {FORMAT}).",
            "Take the tailbeat that made it, or plan anew: tailbeat trial learn --law model.",
        )
    try:
        reference = Reference(
            beat_s=float(document["reference"]["beat_s"]),
            speed_m_s=np.array(document["reference"]["speed_m_s"], dtype=np.float32),
            name=str(document["reference"]["name"]),
        )
        setting = ModelStepSetting(
            reference,
            float(document["amplitude_max_rad"]),
            float(document["step_max_rad"]),
            Law(**document["fallback"]),
        )
        identified = Identified.from_dict(document["identified"])
        return propose(identified, setting, _named(document["swims"], trials))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "this is no proposal, or it is damaged.", "Take one from the fish's trial library."
        ) from error


def _named(names: Sequence[dict[str, Any]], trials: Sequence[TrialSpeeds]) -> list[TrialSpeeds]:
    by_crc = {swim_crc(trial): trial for trial in trials}
    missing = [str(name["trial"]) for name in names if name["crc"] not in by_crc]
    if missing:
        raise InputError(
            f"the proposal was made from other data of trial {', '.join(missing)}.",
            "Look for that trial's file in the fish's trial library.",
        )
    return [by_crc[name["crc"]] for name in names]


def swim_crc(trial: TrialSpeeds) -> int:
    """CRC-32 of all that the model learns from a trial."""
    crc = zlib.crc32(f"{trial.trial} {trial.reference_crc} {trial.beat_s!r}".encode())
    for values in (trial.amplitude_rad, trial.speed_m_s, trial.sigma_m_s):
        crc = zlib.crc32(np.nan_to_num(values, nan=-1.0).astype("<f8").tobytes(), crc)
    return crc
