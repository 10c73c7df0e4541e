"""Runs that tell what a fish is like: three cruises and a coast-down, within the tank.

Pure planning: how a run is executed is the caller's. Every run is sized by the best model so far
and by its pessimistic edge; the gentlest comes first, and what a run teaches sizes the next.
Amplitudes rise beat by beat to the cruise, because a hard step says little of the delay (see
``fitting``).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.learning import fit
from tailbeat.learning.fish_model import FishModel, TrialSpeeds
from tailbeat.learning.fit import Fit, Prior, farthest, travel_m
from tailbeat.learning.identification import Identified, now_text
from tailbeat.learning.scatter import Scatter

CRUISE, COAST = "cruise", "coast-down"
FRACTIONS = (0.4, 0.7, 1.0)  # of the way from the dead zone to the limit: Table 8.1's, nearly
STILL_M_S = 0.004  # a mean speed below it may be the water's
_RUNS_MAX = 8
_MODELS = 50  # from each way of drawing them
_RAMP_BEATS = 4
_CRUISE_S = (6.0, 16.0)  # shortest and longest time at the cruise amplitude
_COAST_S = {CRUISE: 8.0, COAST: 14.0}
_SETTLED = 3.0  # time constants of speed, after which a cruise is steady
_AMPLITUDE_STEPS = 10
_LAST_SWING = 0.75  # of the dead zone: pushes nothing even if that is smaller than believed
_RAISE_RAD = 0.06  # at least, after a run in which nothing moved


@dataclass(frozen=True)
class Limits:
    """What runs must keep to. ``step_max_rad``: the cruise amplitude rises by no more from one run
    to the next; 0 = no limit. ``tank_m`` 0: the length is not checked. ``margin_m``: of the tank's
    length, left free."""

    amplitude_max_rad: float = 0.5
    step_max_rad: float = 0.0
    tank_m: float = 3.0
    fish_m: float = 0.36
    margin_m: float = 0.15
    beat_s: float = 1.0

    @classmethod
    def from_params(cls, params: Mapping[str, float], beat_s: float = 1.0) -> Limits:
        """The limits held in board parameters."""
        return cls(
            amplitude_max_rad=params["AMP_MAX_RAD"],
            step_max_rad=params["DU_MAX_RAD"],
            tank_m=params["TANK_LEN_M"],
            fish_m=params["FISH_LEN_M"],
            beat_s=beat_s,
        )

    @property
    def usable_m(self) -> float:
        """How far a fish may swim; infinite when the tank is not checked."""
        return self.tank_m - self.fish_m - self.margin_m if self.tank_m > 0 else math.inf


@dataclass(frozen=True)
class IdentificationRun:
    """One run, planned. ``number`` counts from 1. ``travel_m``: until some seconds after its last
    beat, by the best model; ``travel_worst_m``: by one that is as far off as may be believed."""

    number: int
    kind: str
    cruise_rad: float
    amplitude_rad: F64
    predicted_m_s: F64
    travel_m: float
    travel_worst_m: float

    @property
    def beats(self) -> int:
        """Length of the run."""
        return len(self.amplitude_rad)


@dataclass
class IdentificationSeries:
    """What runs have taught so far. ``still_rad``: the largest amplitude that moved nothing."""

    limits: Limits
    prior: Prior = field(default_factory=Prior)
    usual: Scatter = field(default_factory=Scatter)
    scatter: Scatter = field(default_factory=Scatter)
    trials: list[TrialSpeeds] = field(default_factory=list)
    found: Fit | None = None
    still_rad: float = 0.0
    cruised_rad: float | None = None
    stage: int = 0  # runs in which something moved

    @property
    def done(self) -> bool:
        """Whether three cruises and the coast-down are executed."""
        return self.stage > len(FRACTIONS)

    @property
    def model(self) -> FishModel:
        """The best so far."""
        if self.found is not None:
            return self.found.model
        dead_zone_rad = max(self.prior.model.dead_zone_rad, self.still_rad)
        return replace(self.prior.model, dead_zone_rad=dead_zone_rad)

    @property
    def covariance(self) -> F64:
        """Of (log kappa, log slope, dead zone, delay)."""
        return self.prior.covariance if self.found is None else self.found.covariance

    def next_run(self) -> IdentificationRun:
        """The next run. Raises InputError when none fits, or nothing ever moves."""
        kind = CRUISE if self.stage < len(FRACTIONS) else COAST
        number = len(self.trials) + 1
        wanted = self._amplitude(FRACTIONS[min(self.stage, len(FRACTIONS) - 1)])
        if number > _RUNS_MAX or self.still_rad >= wanted:
            raise InputError(
                f"the fish did not move at {self.still_rad:.2f} rad, the most that is allowed.",
                "Look whether it is free and the camera sees it; then raise AMP_MAX_RAD.",
            )
        return self._sized(number, kind, wanted)

    def add(self, run: IdentificationRun, trial: TrialSpeeds) -> None:
        """What was measured. Raises InputError when it was nothing."""
        if not trial.measured.any():
            raise InputError(
                f"identification trial {run.number} has no speeds.",
                "Look at the camera; then identify again.",
            )
        self.trials.append(trial)
        self.cruised_rad = run.cruise_rad
        if not _moved(trial, run.cruise_rad):
            self.still_rad = max(self.still_rad, run.cruise_rad)
            return
        self.stage += 1
        found = fit.fit_robust(self.trials, self.prior, self.usual)
        self.found, self.scatter = found.fit, found.scatter

    def _amplitude(self, fraction: float) -> float:
        """Between the dead zone and the limit; higher than what moved nothing."""
        most = self.limits.amplitude_max_rad
        dead = min(max(self.model.dead_zone_rad, self.still_rad), most)
        wanted = dead + fraction * (most - dead)
        if self.still_rad > 0:
            wanted = max(wanted, self.still_rad + _RAISE_RAD)
        if self.cruised_rad is not None and self.limits.step_max_rad > 0:
            wanted = min(wanted, self.cruised_rad + self.limits.step_max_rad)
        return min(wanted, most)

    def _sized(self, number: int, kind: str, wanted_rad: float) -> IdentificationRun:
        """As long as fits, and slower only if even the shortest does not."""
        longest_rad = self._profile(kind, wanted_rad, self._beats(_CRUISE_S[1]))
        beat_s = self.limits.beat_s
        edge, day = farthest(self.model, self.covariance, self.scatter, longest_rad, beat_s)
        usable_m = self.limits.usable_m

        def worst(amplitude: F64) -> float:
            return travel_m(edge, amplitude, beat_s, day)

        shortest, longest = (self._beats(s) for s in self._cruise_s(kind, wanted_rad))
        amplitude = self._profile(kind, wanted_rad, shortest)
        lowest = max(self.still_rad, self.model.dead_zone_rad)
        for _ in range(_AMPLITUDE_STEPS):
            if worst(amplitude) <= usable_m:
                break
            wanted_rad = lowest + 0.8 * (wanted_rad - lowest)
            amplitude = self._profile(kind, wanted_rad, shortest)
        else:
            raise InputError(
                f"the tank is too short to identify the fish: {max(usable_m, 0.0):.2f} m are left.",
                "Correct TANK_LEN_M and FISH_LEN_M, or swim by hand and give --trials.",
            )
        longer = range(shortest + 1, longest + 1)
        more = bisect_right(
            longer, usable_m, key=lambda beats: worst(self._profile(kind, wanted_rad, beats))
        )
        amplitude = self._profile(kind, wanted_rad, shortest + more)
        model = self.model
        return IdentificationRun(
            number=number,
            kind=kind,
            cruise_rad=wanted_rad,
            amplitude_rad=amplitude,
            predicted_m_s=model.beats(amplitude, beat_s),
            travel_m=travel_m(model, amplitude, beat_s),
            travel_worst_m=worst(amplitude),
        )

    def _cruise_s(self, kind: str, cruise_rad: float) -> tuple[float, float]:
        """Shortest and longest time at the cruise amplitude; a coast-down need only get fast."""
        low, high = _CRUISE_S
        if kind == CRUISE:
            return low, high
        speed = float(self.model.steady_m_s(cruise_rad))
        settled_s = _SETTLED / (2 * self.model.kappa_per_m * max(speed, STILL_M_S))
        return low, min(max(low, settled_s), high)

    def _beats(self, time_s: float) -> int:
        return max(1, round(time_s / self.limits.beat_s))

    def _profile(self, kind: str, cruise_rad: float, cruise_beats: int) -> F64:
        """Up in equal steps of steady speed, the cruise, the coast."""
        foot = min(self.model.dead_zone_rad, cruise_rad)
        ramp = foot + (cruise_rad - foot) * np.arange(1, _RAMP_BEATS + 1) / (_RAMP_BEATS + 1)
        cruise = np.full(cruise_beats, cruise_rad)
        coast = np.zeros(self._beats(_COAST_S[kind]))
        coast[0] = _LAST_SWING * foot
        return np.concatenate([ramp, cruise, coast])


def _moved(trial: TrialSpeeds, cruise_rad: float) -> bool:
    """By the later half of the beats at the cruise amplitude."""
    cruise = np.flatnonzero((trial.amplitude_rad >= 0.99 * cruise_rad) & trial.measured)
    later = cruise[len(cruise) // 2 :]
    speed = trial.speed_m_s[later] if later.size else trial.speed_m_s[trial.measured]
    return bool(np.mean(speed) > STILL_M_S)


def identify_runs(
    trial: Callable[[F64], TrialSpeeds],
    limits: Limits,
    prior: Prior | None = None,
    scatter: Scatter | None = None,
    on_run: Callable[[IdentificationRun], None] | None = None,
    quick: bool = False,
    unique_id: str = "",
) -> Identified:
    """Executes the runs by ``trial(amplitude per beat, rad)`` and fits the fish to them.

    ``on_run`` is told of each run before it is executed. ``quick``: the models as likely are drawn
    from the fit's normal posterior only, not from a bootstrap too (a hundredth of the time).
    Whatever ``trial`` or ``on_run`` raises passes through.
    """
    usual = scatter or Scatter()
    course = IdentificationSeries(limits, prior or Prior(), usual, usual)
    while not course.done:
        run = course.next_run()
        if on_run is not None:
            on_run(run)
        course.add(run, trial(run.amplitude_rad))
    return identify_trials(course.trials, course.prior, usual, "runs", unique_id, quick)


def identify_trials(
    trials: Sequence[TrialSpeeds],
    prior: Prior | None = None,
    scatter: Scatter | None = None,
    source: str = "trials",
    unique_id: str = "",
    quick: bool = False,
) -> Identified:
    """From trials of any kind that exist. Raises InputError when no beat of them has a speed."""
    prior, scatter = prior or Prior(), scatter or Scatter()
    robust = fit.fit_robust(trials, prior, scatter)
    found, scatter = robust.fit, robust.scatter
    models = fit.sample(found, _MODELS)
    if not quick:
        # Alone either is a little narrow: the bootstrap when a few trials happen to be alike, the
        # posterior when the model leaves something out.
        models += fit.bootstrap(trials, found, _MODELS, prior=prior, scatter=scatter)
    return Identified(
        model=found.model,
        models=models,
        covariance=found.covariance,
        scatter=scatter,
        source=source,
        unique_id=unique_id,
        made=now_text(),
        trials=list(trials),
    )
