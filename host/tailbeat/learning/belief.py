"""What the trials so far say of a fish, and what it will do next, with a band.

All trials, those of the identification among them, are fitted together: the model, each trial's own
start, flow and gain, and how much trials scatter. Every further trial is predicted first. When it
is not as predicted, the explanations are weighed against each other by how likely they make it: a
regular trial, a spoilt one, a fish that has had another thrust since, another shape. A spoilt one
counts little; a change that two trials agree on, or one trial shows clearly, is taken over and
named. What none of them explains refutes the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import NUMBERS, Conditions, FishModel, TrialSpeeds
from tailbeat.learning.fit import Fit, Prior, Robust, fit_robust
from tailbeat.learning.identification import Identified
from tailbeat.learning.prediction import (
    AGED,
    OTHER,
    SHAPE,
    SPOILT,
    THRUST,
    Expected,
    Explanation,
    Prediction,
    explain,
)
from tailbeat.learning.scatter import STD_ABS, WALK, Scatter
from tailbeat.learning.slopes import speed_and_slopes

FALSE_ALARM = 1e-3  # of the test of one regular trial by the best explanation of it
MEMORY_TRIALS = 20  # older ones no longer count

_MEAN_ABS = 0.7978845608028654  # of |N(0, 1)|: a fish begins forwards or at rest
_ROUNDS = 2  # of fit and scatter
_COLD_ROUNDS = 3
_DAY = 0.01  # as WALK, from the identification to the first trial
_REPEATS_M_S = 0.001  # what repeats on a reference and the model leaves out: of a beat ...
_REPEATS_BEATS = 2.0  # ... shared by neighbours
_FORGETS_M_S = 0.0003  # ... that comes new with each trial
_WRONG_ABOUT_CHANGES = 0.05  # of the change of steady speed from trial to trial
_SPOILT_WEIGHT = 0.02
_OLD_WEIGHT = 0.02  # of trials before a change of shape


@dataclass(frozen=True)
class Change:
    """A lasting change since the trial of index ``since`` (of the belief's trials). ``kind``:
    ``thrust`` (a gain or a flow) or ``shape``. ``log_gain``, ``flow_m_s``: as estimated."""

    kind: str
    since: int
    log_gain: float = 0.0
    flow_m_s: float = 0.0


@dataclass(frozen=True)
class Belief:
    """``trials``: those that count, without the identification's. ``refuted_in_a_row``: so many of
    the last ones nothing explains. ``chance``: of the last trial, by the prediction that was made
    for it. ``weights``: of all trials, the identification's first. ``changes``: lasting ones,
    oldest first. ``before``: without the last trial."""

    identified: Identified
    scatter: Scatter
    fit: Fit | None = None
    trials: tuple[TrialSpeeds, ...] = ()
    weights: F64 = field(default_factory=lambda: np.ones(0))
    spoilt: tuple[bool, ...] = ()
    refuted_in_a_row: int = 0
    chance: float = 1.0
    changes: tuple[Change, ...] = ()
    before: Belief | None = None
    _filtered: dict[tuple[int, int], tuple[F64, F64, F64 | None]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def refuted(self) -> bool:
        """Whether nothing explains the last trial."""
        return self.refuted_in_a_row > 0

    @property
    def model(self) -> FishModel:
        """The most probable model."""
        return self.identified.model if self.fit is None else self.fit.model

    @property
    def covariance(self) -> F64:
        """Of the model, as in Fit."""
        if self.fit is None:
            return self._prior().covariance
        return self.fit.covariance

    @property
    def first(self) -> list[TrialSpeeds]:
        """The identification's trials."""
        return [trial for trial in self.identified.trials if trial.measured.any()]

    def _prior(self) -> Prior:
        """Of any fish where the identification's trials are there to be fitted again; otherwise the
        identification's sigmas, widened by how far the fish may be. What was only assumed is known
        no better than of any fish."""
        if self.first:
            return Prior()
        identified = self.identified
        far = OTHER if any(change.kind == "shape" for change in self.changes) else AGED
        known = np.sqrt(np.diag(identified.whole_covariance) + np.square(far))
        assumed = [name in identified.assumed for name in NUMBERS]
        sigma = np.where(assumed, np.maximum(known, Prior().sigma), known)
        return Prior(identified.model, *sigma.tolist())

    def level(self) -> tuple[float, float]:
        """(log gain of the next trial, its variance): a Kalman filter along the trials."""
        level, variance = 0.0, WALK**2
        if self.fit is None:
            return level, variance
        gains = [math.log(given.gain) for given in self.fit.conditions]
        jumps = {len(self.first) + c.since: c.log_gain for c in self.changes if c.kind == "thrust"}
        for index, (gain, weight) in enumerate(zip(gains, self.weights, strict=True)):
            level += jumps.get(index, 0.0)
            if index in jumps:
                variance += self.scatter.gain**2
            variance += WALK**2 + (_DAY**2 if index == len(self.first) else 0.0)
            share = variance / (variance + self.scatter.gain**2 / weight)
            level += share * (gain - level)
            variance *= 1 - share
        return level, variance + WALK**2

    @property
    def typical(self) -> Conditions:
        """What the next trial's conditions are on average. A flow is taken to repeat by as much as
        the mean over the trials stands out of their scatter (James and Stein's estimate)."""
        since = max((c.since for c in self.changes if c.flow_m_s), default=0)
        own = self.fit.conditions[len(self.first) + since :] if self.fit else []
        weights = self.weights[len(self.weights) - len(own) :]
        flow = 0.0
        if own:
            flow = float(np.average([given.flow_m_s for given in own], weights=weights))
        noise = self.scatter.flow_m_s**2 / float(weights.sum()) if own else 0.0
        repeats = max(0.0, 1 - noise / flow**2) if flow else 0.0
        return Conditions(
            _MEAN_ABS * self.scatter.start_m_s, repeats * flow, math.exp(self.level()[0])
        )

    @property
    def misfit_m_s(self) -> float:
        """What the model leaves out of a beat, RMS, as the trials show it."""
        return self.scatter.misfit_m_s

    def disturbance(
        self, reference_crc: int, beats: int, amplitude_rad: F64 | None = None
    ) -> tuple[F64, F64]:
        """(mean, covariance) of what the model does not explain on this reference and comes again:
        a Kalman filter along its trials. (m/s, m^2/s^2) The covariance is that of a trial with
        ``amplitude_rad`` (None = of one like the last): where amplitudes change, the model may be
        wrong anew."""
        mean, covariance, last = self._repeating(reference_crc, beats)
        if amplitude_rad is not None:
            covariance = covariance + np.diag(self._unknown(last, amplitude_rad))
        return mean, (covariance + covariance.T) / 2

    def _repeating(self, reference_crc: int, beats: int) -> tuple[F64, F64, F64 | None]:
        """(mean, covariance, amplitudes of the last trial) of the Kalman filter, kept."""
        kept = self._filtered.get((reference_crc, beats))
        if kept is None:
            kept = self._filtered[reference_crc, beats] = self._filter(reference_crc, beats)
        return kept

    def _filter(self, reference_crc: int, beats: int) -> tuple[F64, F64, F64 | None]:
        mean = np.zeros(beats)
        covariance = self._left_out(beats)
        last: F64 | None = None
        residuals = self.fit.residual_m_s if self.fit else []
        rows = zip([*self.first, *self.trials], residuals, self.weights, strict=bool(residuals))
        for trial, residual, weight in rows:
            if not reference_crc or trial.reference_crc != reference_crc or trial.beats != beats:
                continue
            covariance = covariance + np.diag(self._unknown(last, trial.amplitude_rad))
            last = trial.amplitude_rad
            seen = np.isfinite(residual)
            noise = self._noise(trial)[np.ix_(seen, seen)] / weight
            gain = np.linalg.solve(covariance[np.ix_(seen, seen)] + noise, covariance[seen]).T
            mean = mean + gain @ (residual[seen] - mean[seen])
            covariance = covariance - gain @ covariance[seen]
        return mean, covariance, last

    def left_out(self, amplitudes_rad: Sequence[F64]) -> F64:
        """Covariance of what the model leaves out and comes again in trials with these amplitudes,
        one after the other, before any of them is known: (all beats, all beats)."""
        lasting, last = [self._left_out(len(amplitudes_rad[0]))], None
        for amplitude in amplitudes_rad:
            lasting.append(lasting[-1] + np.diag(self._unknown(last, amplitude)))
            last = amplitude
        count = range(1, len(lasting))
        return np.block([[lasting[min(one, other)] for other in count] for one in count])

    def _left_out(self, beats: int) -> F64:
        apart = np.abs(np.subtract.outer(np.arange(beats), np.arange(beats)))
        repeats_m_s = max(_REPEATS_M_S, self.misfit_m_s)
        covariance: F64 = repeats_m_s**2 * np.exp(-apart / _REPEATS_BEATS)
        return covariance

    def _noise(self, trial: TrialSpeeds) -> F64:
        """Of a trial's beats beyond what repeats, (beats, beats)."""
        own = trial.sigma_m_s**2 + self.scatter.model_m_s**2
        moving: F64 = self.scatter.moving(trial.beats, trial.beat_s)
        return moving + np.diag(own)

    def _unknown(self, last_rad: F64 | None, amplitude_rad: F64) -> F64:
        """Variance per beat that other amplitudes than the last ones (None = none) bring."""
        steady = self.model.root(amplitude_rad)
        if last_rad is None:
            return self.scatter.alone(self.model, amplitude_rad) - self.scatter.model_m_s**2
        changed = steady - self.model.root(last_rad)
        added: F64 = _FORGETS_M_S**2 + (_WRONG_ABOUT_CHANGES * changed) ** 2
        return added

    def predict(
        self, amplitude_rad: F64, beat_s: float, reference_crc: int, sigma_m_s: F64 | float
    ) -> Prediction:
        """``sigma_m_s``: the measurement's."""
        trial = _unmeasured(amplitude_rad, beat_s, sigma_m_s)
        mean, by = speed_and_slopes(self.model, trial, self.typical)
        repeats, covariance = self.disturbance(reference_crc, trial.beats, amplitude_rad)
        factors = self._factors(by)
        covariance = covariance + factors @ factors.T + self._noise(trial)
        return Prediction(mean + repeats, covariance)

    def _factors(self, by: F64) -> F64:
        """What one standard deviation of every cause that beats share does to them."""
        root = np.linalg.cholesky(self.covariance + 1e-18 * np.eye(len(NUMBERS)))
        gain = math.sqrt(self.scatter.gain**2 + self.level()[1])
        differ = [STD_ABS * self.scatter.start_m_s, self.scatter.flow_m_s, gain]
        return np.hstack([by[:, : len(NUMBERS)] @ root, by[:, len(NUMBERS) :] * differ])

    def after(self, trial: TrialSpeeds) -> Belief:
        """With one more trial."""
        found = self.predict(
            trial.amplitude_rad, trial.beat_s, trial.reference_crc, trial.sigma_m_s
        )
        chance = found.chance(trial.speed_m_s)
        before = replace(self, before=None)
        if self.before is not None:
            both = [self.trials[-1], trial]
            together = self.before.explained(both)
            if together.kind in (THRUST, SHAPE):
                start = replace(self.before, refuted_in_a_row=self.refuted_in_a_row)
                return start._taken(both, together, chance, None)
            return self._taken([trial], together, chance, before)
        return self._taken([trial], self.explained([trial]), chance, before)

    def explained(self, trials: Sequence[TrialSpeeds]) -> Explanation:
        """Trials that come next, by what is believed."""
        rows = []
        for trial in trials:
            mean, by = speed_and_slopes(self.model, trial, self.typical)
            repeats, covariance = self.disturbance(
                trial.reference_crc, trial.beats, trial.amplitude_rad
            )
            seen = trial.measured
            noise = (self._noise(trial) + covariance)[np.ix_(seen, seen)]
            rows.append(Expected((trial.speed_m_s - mean - repeats)[seen], by[seen], noise))
        return explain(rows, self.covariance, self.scatter, self.level()[1], first=not self.trials)

    def _taken(
        self,
        trials: Sequence[TrialSpeeds],
        found: Explanation,
        chance: float,
        before: Belief | None,
    ) -> Belief:
        """With trials that are explained."""
        changes, rounds = self.changes, _ROUNDS
        if found.kind in (THRUST, SHAPE):
            change = Change(found.kind, len(self.trials), found.log_gain, found.flow_m_s)
            changes, rounds = (*changes, change), _COLD_ROUNDS
        spoilt = [found.kind == SPOILT] * len(trials)
        refuted = self.refuted_in_a_row + 1 if found.chance < FALSE_ALARM else 0
        taken = replace(
            self,
            trials=(*self.trials, *trials),
            spoilt=(*self.spoilt, *spoilt),
            changes=changes,
            refuted_in_a_row=refuted,
            chance=chance,
            before=before,
        )
        return taken._forgetting()._fitted(rounds)

    def _forgetting(self) -> Belief:
        """Without trials beyond the memory."""
        gone = len(self.trials) - MEMORY_TRIALS
        if gone <= 0:
            return self
        changes = tuple(replace(c, since=max(c.since - gone, 0)) for c in self.changes)
        begin = self.fit
        if begin is not None:
            kept = begin.vector[len(NUMBERS) :].reshape(-1, 3)
            kept = np.delete(kept, range(len(self.first), len(self.first) + gone), axis=0)
            vector = np.concatenate([begin.vector[: len(NUMBERS)], kept.ravel()])
            begin = replace(begin, vector=vector)
        return replace(
            self, trials=self.trials[gone:], spoilt=self.spoilt[gone:], changes=changes, fit=begin
        )

    def _centres(self) -> F64:
        """(flow, log gain) that each trial is expected to have."""
        centres = np.zeros((len(self.first) + len(self.trials), 2))
        for change in self.changes:
            centres[len(self.first) + change.since :] += (change.flow_m_s, change.log_gain)
        return centres

    def _least(self) -> F64:
        """The most that each trial may count."""
        most = np.concatenate([np.ones(len(self.first)),
                               np.where(self.spoilt, _SPOILT_WEIGHT, 1.0)])  # fmt: skip
        for change in self.changes:
            if change.kind == "shape":
                most[: len(self.first) + change.since] *= _OLD_WEIGHT
        return most

    def _fitted(self, rounds: int = _ROUNDS) -> Belief:
        trials = [*self.first, *self.trials]
        if not trials:
            return self
        usual = Scatter() if self.first else self.identified.scatter
        last = None if self.fit is None else Robust(self.fit, self.scatter, self.weights)
        found = fit_robust(
            trials, self._prior(), usual, self._least(), self._centres(), last, rounds
        )
        return replace(self, fit=found.fit, scatter=found.scatter, weights=found.weights)


def _unmeasured(amplitude_rad: F64, beat_s: float, sigma_m_s: F64 | float) -> TrialSpeeds:
    beats = len(amplitude_rad)
    sigma = np.broadcast_to(np.asarray(sigma_m_s, dtype=np.float64), (beats,))
    return TrialSpeeds(amplitude_rad, np.full(beats, np.nan), sigma, beat_s)


_COUNTED = 30  # trials that a belief begins with: older ones have no say after MEMORY_TRIALS


def believe(identified: Identified, trials: Sequence[TrialSpeeds]) -> Belief:
    """After ``trials``, oldest first, of which the last 30 count; those without a speed tell
    nothing."""
    belief = _first(identified)
    for trial in _telling(trials)[-_COUNTED:]:
        belief = belief.after(trial)
    return belief


def _first(identified: Identified) -> Belief:
    """Before any trial."""
    belief = Belief(identified, identified.scatter)
    return belief._fitted(_COLD_ROUNDS) if belief.first else belief


def _telling(trials: Sequence[TrialSpeeds]) -> list[TrialSpeeds]:
    return [trial for trial in trials if trial.measured.any()]


class Beliefs:
    """What is believed of a fish along its trials: as ``believe``, but each trial costs only its
    own step."""

    def __init__(self, identified: Identified) -> None:
        self.identified = identified
        self._trials: list[TrialSpeeds] = []
        self._chain = [_first(identified)]

    def after(self, trials: Sequence[TrialSpeeds]) -> Belief:
        """As ``believe``. ``trials``: those of the last call, or some of them, and later ones."""
        telling = _telling(trials)
        if len(telling) > _COUNTED:
            return believe(self.identified, telling)
        rows = zip(self._trials, telling, strict=False)
        same = next((at for at, (one, other) in enumerate(rows) if not _equal(one, other)),
                    min(len(self._trials), len(telling)))  # fmt: skip
        del self._trials[same:], self._chain[same + 1 :]
        for trial in telling[same:]:
            self._trials.append(trial)
            self._chain.append(self._chain[-1].after(trial))
        return self._chain[len(telling)]


def _equal(one: TrialSpeeds, other: TrialSpeeds) -> bool:
    return (
        one.reference_crc == other.reference_crc
        and np.array_equal(one.amplitude_rad, other.amplitude_rad)
        and np.array_equal(one.speed_m_s, other.speed_m_s, equal_nan=True)
    )
