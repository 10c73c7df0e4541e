"""Why a trial's error is as large as it is: named causes, each with its number, place and remedy.

What the amplitude limit and the reference cost follows from the model (error bounds). The rest is
told from how the trials of a series depart from what was known before them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tailbeat.core.law import Law
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference
from tailbeat.core.trial_checks import spans
from tailbeat.learning.belief import Belief, believe
from tailbeat.learning.departures import Departure, Kind, departures
from tailbeat.learning.error_bound import ErrorBound, Miss, error_bound
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.saturation import SERVO_MOST_RAD, at_limit

SHARE_MIN_M_S = 0.0015  # causes that explain less of the error are not named
# Of the top speed: what a fish that only drag slows may miss where it comes to rest.
_END_PART = 0.3
_DOUBTFUL_M_S = 0.004  # standard deviation of a beat's speed
_MISSING_PART = 0.15  # of the beats
_GAIN_PART = 0.75  # of the gain from which on nothing contracts at steady speed
# From so many trials on the model of a fish that was not measured is trusted, and what does not
# come again is told: two trials of a healthy fish differ too often by chance.
_TELLING_TRIALS = 3
_TRIALS_MAX = 6  # the last ones are compared

_SURELY_DISTURBED = 0.95  # then nobody can tell what a model misses, and a change must be as sure


class _Need(NamedTuple):
    """What it takes to name a departure: so many trials that show it, its probability with so many,
    and with more. One trial alone may be a disturbance as well as a misfit."""

    trials: int
    at_first: float
    later: float


_NEEDS: dict[Kind, _Need] = {
    "changed": _Need(2, 0.85, 0.25), "misfit": _Need(2, 0.7, 0.4), "disturbed": _Need(3, 0.65, 0.7)
}  # fmt: skip
_ERROR_PART = 0.3  # of the last trial's largest error: what a departure must do
# In a long series every trial is another occasion to be wrong: from so many compared trials on,
# at least this probability is asked of all. bench/causes.py counts how often all of this is right.
_LONG_TRIALS, _LONG = 5, 0.7


class Cause(StrEnum):
    """What explains an error."""

    SATURATION = "saturation"
    INFEASIBLE = "infeasible reference"
    MISSING = "missing speeds"
    DISTURBANCE = "non-repetitive disturbance"
    MISFIT = "model misfit"
    CHANGED = "changed fish"
    GAIN = "gain too high"


@dataclass(frozen=True)
class CauseFound:
    """``share_m_s``: of the largest error, as far as it can be told. ``number``: the evidence;
    ``place``: beats or trials; ``proposal``: what to do, in words. ``value``: the gain that is
    proposed; the first trial of a fish that changed; the trial whose input is to be repeated."""

    cause: Cause
    share_m_s: float
    number: str
    place: str
    proposal: str
    value: float | None = None

    @property
    def text(self) -> str:
        """``saturation, beats 12 to 30: 19 of 40 beats at the limit ...``."""
        return f"{self.cause}, {self.place}: {self.number}"


@dataclass(frozen=True)
class Evidence:
    """What is known after a trial. ``trials``: of the reference since the series began, oldest
    first, the last one just executed, all with some speed. ``law``: the P law that makes the
    inputs; None = the model-based law does. ``most_rad``: how far AMP_MAX_RAD could be raised."""

    reference: Reference
    limit_rad: float
    trials: Sequence[TrialSpeeds]
    belief: Belief
    law: Law | None = None
    most_rad: float = SERVO_MOST_RAD

    @cached_property
    def before(self) -> Belief:
        """Before the series; the present one where nothing was measured then."""
        identified = self.belief.identified
        return self.belief if identified.source == "none" else believe(identified, [])

    @property
    def compared(self) -> Sequence[TrialSpeeds]:
        """The last trials."""
        return self.trials[-_TRIALS_MAX:]

    @property
    def knows_fish(self) -> bool:
        """Whether the model can be trusted with what a fish can reach."""
        return self.belief.identified.source != "none" or len(self.trials) >= _TELLING_TRIALS

    @cached_property
    def bound(self) -> ErrorBound:
        """With the largest amplitude that could be allowed."""
        return error_bound(self.belief.model, self.reference, max(self.most_rad, self.limit_rad))

    @cached_property
    def top_m_s(self) -> float:
        """Of the reference."""
        return float(self.reference.speed_m_s.max())

    @property
    def max_abs_error_m_s(self) -> float:
        """Of the last trial."""
        error = self.reference.speed_m_s - self.trials[-1].speed_m_s
        return float(np.nanmax(np.abs(error)))


def diagnose(evidence: Evidence) -> list[CauseFound]:
    """The causes; empty = nothing to be done about. A changed fish comes first, as its model tells
    what limit and reference cost; the others by what they explain. Costs some 0.1 s."""
    detectors = _DETECTORS if evidence.knows_fish else (_missing,)
    found = [found for of in detectors if (found := of(evidence)) is not None]
    return sorted(found, key=lambda one: (one.cause is not Cause.CHANGED, -one.share_m_s))


def _saturation(evidence: Evidence) -> CauseFound | None:
    last = evidence.trials[-1].amplitude_rad
    count = at_limit(last, evidence.limit_rad)
    if not count or evidence.limit_rad >= evidence.most_rad:
        return None
    held = error_bound(evidence.belief.model, evidence.reference, evidence.limit_rad)
    share = held.minimax_m_s - evidence.bound.minimax_m_s
    if share < SHARE_MIN_M_S:
        return None
    beats = np.flatnonzero(last >= evidence.limit_rad * (1 - 1e-6))
    number = (
        f"{count} of {len(last)} beats at the limit {evidence.limit_rad:.2f} rad, which costs"
        f" {mm(share)} mm/s"
    )
    return CauseFound(Cause.SATURATION, share, number, spans(beats), "raise the amplitude limit")


def _infeasible(evidence: Evidence) -> CauseFound | None:
    spots = [one for one in evidence.bound.spots if not _coming_to_rest(one, evidence)]
    if not spots or abs(spots[0].error_m_s) < SHARE_MIN_M_S:
        return None
    worst, share = spots[0], abs(spots[0].error_m_s)
    number = f"no input gets nearer than {mm(share)} mm/s there ({worst.why})"
    place = spans(range(worst.first, worst.last + 1))
    return CauseFound(Cause.INFEASIBLE, share, number, place, "use the nearest feasible reference")


def _coming_to_rest(spot: Miss, evidence: Evidence) -> bool:
    """Every reference that ends at rest asks for more brake than drag in its last beats."""
    ends = evidence.reference.speed_m_s[-1] < _END_PART * evidence.top_m_s
    last = spot.last >= evidence.reference.beats - 1 and spot.error_m_s < 0
    return bool(ends and last and abs(spot.error_m_s) < _END_PART * evidence.top_m_s)


def _missing(evidence: Evidence) -> CauseFound | None:
    last = evidence.trials[-1]
    executed = last.beats if last.swum_beats is None else last.swum_beats
    doubtful = ~last.measured | (last.sigma_m_s > _DOUBTFUL_M_S)
    beats = np.flatnonzero(doubtful[:executed])
    if len(beats) <= _MISSING_PART * executed:
        return None
    share = max(evidence.max_abs_error_m_s * len(beats) / executed, SHARE_MIN_M_S)
    number = f"{len(beats)} of {executed} beats have no speed, or a doubtful one"
    proposal = "check the camera and the IMU before going on"
    return CauseFound(Cause.MISSING, share, number, spans(beats), proposal)


def _gain(evidence: Evidence) -> CauseFound | None:
    law = evidence.law
    if law is None:
        return None
    model = evidence.belief.model
    slopes = model.steady_slope(np.linspace(0.5, 1.0, 8) * evidence.top_m_s)
    limit = float(2 / slopes.max())
    if law.kp_rad_s_m < _GAIN_PART * limit:
        return None
    share = evidence.max_abs_error_m_s * min(law.kp_rad_s_m / limit, 1.0)
    number = f"gain {law.kp_rad_s_m:.2f}; errors grow from {limit:.2f} on"
    proposal = f"set the gain to {limit / 2:.2f} and go on from the best input"
    return CauseFound(Cause.GAIN, share, number, "every beat", proposal, value=limit / 2)


def _departing(evidence: Evidence) -> CauseFound | None:
    """Changed fish, misfit or disturbance: whichever explains the most."""
    wanted_m_s = np.asarray(evidence.reference.speed_m_s, dtype=np.float64)
    found = departures(evidence.before, evidence.compared, wanted_m_s)
    named = {kind: one for kind, one in found.items() if _is_named(one, evidence)}
    if found["disturbed"].chance > _SURELY_DISTURBED:
        named.pop("misfit", None)
        if found["changed"].chance < _SURELY_DISTURBED:
            named.pop("changed", None)
    if not named:
        return None
    most = max(named.values(), key=lambda one: abs(one.effect_m_s))
    return _BY_KIND[most.kind](evidence, most)


def _is_named(one: Departure, evidence: Evidence) -> bool:
    need, shown_by = _NEEDS[one.kind], len(evidence.compared) - one.since
    wanted = need.at_first if shown_by == need.trials else need.later
    if len(evidence.compared) >= _LONG_TRIALS:
        wanted = max(wanted, _LONG)
    least_m_s = max(SHARE_MIN_M_S, _ERROR_PART * evidence.max_abs_error_m_s)
    return shown_by >= need.trials and one.chance >= wanted and abs(one.effect_m_s) >= least_m_s


def _disturbance(evidence: Evidence, found: Departure) -> CauseFound:
    share, best = found.effect_m_s, evidence.compared[found.best].trial
    number = f"{mm(share)} mm/s differ from trial to trial and cannot be learned"
    proposal = (
        f"repeat the input of trial {best}, the best without it. Let the water rest longer, and"
        " look for what moves it"
    )
    return CauseFound(Cause.DISTURBANCE, share, number, "every trial", proposal, float(best))


def _misfit(evidence: Evidence, found: Departure) -> CauseFound:
    share, proposal = abs(found.effect_m_s), "measure the fish again (one trial)"
    number = f"the measured model misses every trial by {mm(share)} mm/s in the same way"
    return CauseFound(Cause.MISFIT, share, number, "every trial", proposal)


def _changed(evidence: Evidence, found: Departure) -> CauseFound:
    share, first = abs(found.effect_m_s), evidence.compared[found.since].trial
    sign = "+" if found.effect_m_s > 0 else "-"
    number = f"{sign}{mm(share)} mm/s at the same amplitudes (battery, ballast, fin?)"
    proposal = "look at battery and fin; if nothing is wrong, measure the fish again (one trial)"
    return CauseFound(Cause.CHANGED, share, number, f"since trial {first}", proposal, float(first))


_BY_KIND: dict[Kind, Callable[[Evidence, Departure], CauseFound]] = {
    "changed": _changed, "misfit": _misfit, "disturbed": _disturbance
}  # fmt: skip

_DETECTORS: tuple[Callable[[Evidence], CauseFound | None], ...] = (
    _saturation, _infeasible, _missing, _gain, _departing
)  # fmt: skip
