"""What the trials so far say of a fish, and what it will do next, with a band.

The trials since the identification are gone through in their order. The first one opens the fit:
the identification is its prior, widened to what the fish may have become, or to what another fish
of the kind may be when that explains the trials better. Each further one is
predicted from those before it. When it lies outside of what was predicted, or when no model of this
form explains it, the model is refuted: what came before no longer counts, and the fit begins anew
with that trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import PARAMS, Conditions, FishModel, TrialSpeeds
from tailbeat.learning.fit import Fit, Prior, fit, speed_and_slopes, steepness
from tailbeat.learning.identification import Identified

# Of the test of one trial, if all noise were normal and the model's form right. As the model's
# imperfection is counted as noise of each beat, the test seldom gives a false alarm at all.
FALSE_ALARM = 1e-3
MEMORY_TRIALS = 12  # older ones no longer count

# How far a fish may be from the one that was identified, as standard deviations in the order and
# units of PARAMS, relative for kappa and slope. AGED: the same fish. OTHER: another of its kind;
# wide enough for one trial to overrule. The fit takes the prior that makes the trials likelier:
# by the narrow one a trial's own gain and flow are not taken for the map.
AGED = (0.05, 0.02, 0.005, 0.02)
OTHER = (0.5, 0.2, 0.08, 0.25)

_Z_90 = 1.6448536269514722  # 90 % of the standard normal lie within
_MEAN_ABS = 0.7978845608028654  # of |N(0, 1)|: a fish begins forwards or at rest
_STD_ABS = 0.6028102749890869
_DRAWS = 400
_NOISE_M_S = 0.0002  # of a beat's speed, that neither model nor measurement tells of
_FORGET = 0.1  # of the model's imperfection, added to the disturbance's variance at each trial
_WRONG_ABOUT_CHANGES = 0.05  # of the change of steady speed from trial to trial
_WRONG_ABOUT_NEW = 0.015  # of the steady speed, on a reference that was never executed
# The usual imperfection stands against what residuals tell of it as so many beats do.
_USUAL_BEATS = 3  # in the identification's trials
_IDENTIFIED_BEATS = 10  # in later ones, and then as the identification's showed it
_IMPERFECT_MIN = 0.03
_USUAL = 1.0
_MISFIT = 0.2  # residuals beyond this share of the speeds: the model explains nothing
_TINY = 1e-18  # keeps a covariance of what is known exactly invertible


@dataclass(frozen=True)
class Prediction:
    """Of the measured beats of a trial. ``factors``: (beats, causes), what one standard deviation
    of every cause that beats share does to them; ``sigma_m_s``: of each beat alone."""

    mean_m_s: F64
    factors: F64
    sigma_m_s: F64

    def band(self) -> tuple[F64, F64]:
        """90 % of the measured speeds of a beat lie within (low, high), m/s."""
        spread = _Z_90 * np.sqrt(np.sum(self.factors**2, axis=1) + self.sigma_m_s**2)
        return self.mean_m_s - spread, self.mean_m_s + spread

    def chance(self, speed_m_s: F64) -> float:
        """Probability of a trial at least as odd (chi-square over the measured beats); 1 = none
        was measured."""
        from scipy.special import gammaincc

        seen = np.isfinite(speed_m_s)
        if not seen.any():
            return 1.0
        miss = (speed_m_s - self.mean_m_s)[seen]
        f = self.factors[seen]
        covariance = f @ f.T + np.diag(self.sigma_m_s[seen] ** 2)
        odd = float(miss @ np.linalg.solve(covariance, miss))
        return float(gammaincc(seen.sum() / 2, odd / 2))

    def max_abs_error(
        self, reference_m_s: F64, measured: NDArray[np.bool_] | None = None
    ) -> tuple[float, float, float]:
        """5 %, 50 % and 95 % quantile of a trial's max|e| over the ``measured`` beats (None = all),
        m/s; the same draws every time."""
        rng = np.random.default_rng(1)
        beats, causes = self.factors.shape
        speed = self.mean_m_s + rng.standard_normal((_DRAWS, causes)) @ self.factors.T
        speed = speed + rng.standard_normal((_DRAWS, beats)) * self.sigma_m_s
        error = np.abs(reference_m_s - speed)
        peak = (error if measured is None else error[:, measured]).max(axis=1)
        low, median, high = np.percentile(peak, (5, 50, 95))
        return float(low), float(median), float(high)


@dataclass(frozen=True)
class Belief:
    """``trials``: those the fit rests on. ``refuted``: the last trial was not as predicted, or no
    model explains it. ``chance``: of the last trial, by the prediction that was made for it.
    ``identified_imperfection``: as ``imperfection``, of the identification's trials."""

    identified: Identified
    prior: Prior
    trials: tuple[TrialSpeeds, ...] = ()
    fit: Fit | None = None
    refuted: bool = False
    chance: float = 1.0
    identified_imperfection: float = 1.0

    @property
    def model(self) -> FishModel:
        """The most probable model."""
        return self.prior.model if self.fit is None else self.fit.model

    @property
    def typical(self) -> Conditions:
        """What a trial's conditions are on average. A flow is taken to repeat by as much as the
        mean over the trials stands out of their scatter (James and Stein's estimate)."""
        scatter = self.identified.scatter
        flows = [given.flow_m_s for given in self.fit.conditions] if self.fit else []
        flow = float(np.mean(flows)) if flows else 0.0
        noise = scatter.flow_m_s**2 / len(flows) if flows else 0.0
        repeats = max(0.0, 1 - noise / flow**2) if flow else 0.0
        return Conditions(_MEAN_ABS * scatter.start_m_s, repeats * flow)

    @property
    def imperfection(self) -> float:
        """Variance of what the model leaves out, over the usual one: as the trials' residuals tell
        it, which are set against some beats of the usual one."""
        usual = self.identified_imperfection
        return self._imperfect(self.trials, self.fit, _IDENTIFIED_BEATS, usual)

    def _imperfect(
        self, trials: Sequence[TrialSpeeds], found: Fit | None, usual_beats: int, usual: float
    ) -> float:
        """What residuals tell, set against ``usual_beats`` of the ``usual`` imperfection."""
        total, beats = 0.0, 0
        for trial, residual in zip(trials, found.residual_m_s if found else (), strict=True):
            seen = np.isfinite(residual)
            excess = residual**2 - trial.sigma_m_s**2
            total += float(np.sum((excess / self._usual(trial.amplitude_rad))[seen]))
            beats += int(seen.sum())
        return max(_IMPERFECT_MIN, (usual_beats * usual + total) / (usual_beats + beats))

    def begun(self) -> Belief:
        """With the imperfection that the identification's own trials show."""
        trials = [trial for trial in self.identified.trials if trial.measured.any()]
        found = fit(trials, self.prior, self.identified.scatter) if trials else None
        shown = self._imperfect(trials, found, _USUAL_BEATS, 1.0)
        return replace(self, identified_imperfection=shown)

    def _usual(self, amplitude_rad: F64) -> F64:
        """Variance of what a model usually leaves out of each beat, (m/s)**2."""
        scatter = self.identified.scatter
        steady = self.model.steady_m_s(amplitude_rad)
        usual: F64 = (
            scatter.model_m_s**2
            + (scatter.switch * steepness(steady)) ** 2
            + (_WRONG_ABOUT_NEW * steady) ** 2
        )
        return usual

    def disturbance(
        self,
        reference_crc: int,
        beats: int,
        amplitude_rad: F64 | None = None,
        imperfect_min: float = 0.0,
    ) -> tuple[F64, F64]:
        """(mean, variance) per beat of what the model does not explain on this reference: a Kalman
        filter along its trials. (m/s, m^2/s^2) The variance is that of a trial with
        ``amplitude_rad`` (None = of one like the last): where amplitudes change, the model may be
        wrong anew. The imperfection is taken to be ``imperfect_min`` at least."""
        share = max(self.imperfection, imperfect_min)
        mean, variance = np.zeros(beats), np.zeros(beats)
        last: F64 | None = None
        trials = zip(self.trials, self.fit.residual_m_s if self.fit else (), strict=True)
        for trial, residual in trials:
            if trial.reference_crc != reference_crc or trial.beats != beats:
                continue
            variance = variance + share * self._unknown(last, trial.amplitude_rad)
            last = trial.amplitude_rad
            seen = np.isfinite(residual)
            noise = trial.sigma_m_s**2 + _NOISE_M_S**2
            gain = np.where(seen, variance / (variance + noise), 0.0)
            mean = mean + gain * np.where(seen, residual - mean, 0.0)
            variance = (1 - gain) * variance
        if amplitude_rad is not None:
            variance = variance + share * self._unknown(last, amplitude_rad)
        return mean, variance

    def _unknown(self, last_rad: F64 | None, amplitude_rad: F64) -> F64:
        """What other amplitudes than the last ones (None = there were none) add to the usual
        disturbance's variance."""
        if last_rad is None:
            return self._usual(amplitude_rad)
        changed = self.model.steady_m_s(amplitude_rad) - self.model.steady_m_s(last_rad)
        scatter = self.identified.scatter
        added: F64 = (
            _FORGET * scatter.model_m_s**2
            + (scatter.switch * steepness(changed)) ** 2
            + (_WRONG_ABOUT_CHANGES * changed) ** 2
        )
        return added

    def predict(
        self,
        amplitude_rad: F64,
        beat_s: float,
        reference_crc: int,
        sigma_m_s: F64 | float,
        imperfect_min: float = 0.0,
    ) -> Prediction:
        """``sigma_m_s``: the measurement's. ``imperfect_min``: as for ``disturbance``."""
        beats = len(amplitude_rad)
        sigma = np.broadcast_to(np.asarray(sigma_m_s, dtype=np.float64), (beats,))
        trial = TrialSpeeds(amplitude_rad, np.full(beats, np.nan), sigma, beat_s)
        scatter = self.identified.scatter
        speed, by = speed_and_slopes(self.model, trial, self.typical)
        trials_differ = [_STD_ABS * scatter.start_m_s, scatter.flow_m_s, scatter.gain]
        root = np.linalg.cholesky(self.covariance + _TINY * np.eye(len(PARAMS)))
        factors = np.hstack([by[:, : len(PARAMS)] @ root, by[:, len(PARAMS) :] * trials_differ])
        mean, variance = self.disturbance(reference_crc, beats, amplitude_rad, imperfect_min)
        return Prediction(speed + mean, factors, np.sqrt(sigma**2 + _NOISE_M_S**2 + variance))

    @property
    def covariance(self) -> F64:
        """Of the model, as in Fit."""
        return self.prior.covariance if self.fit is None else self.fit.covariance

    def after(self, trial: TrialSpeeds) -> Belief:
        """With one more trial. It is tested as if the model were as imperfect as usual: what some
        trials did not show is seldom reason enough for P."""
        found = self.predict(
            trial.amplitude_rad, trial.beat_s, trial.reference_crc, trial.sigma_m_s, _USUAL
        )
        chance = found.chance(trial.speed_m_s)
        if not self.trials:
            return self._resting_on((trial,), chance, refuted=False)
        if chance < FALSE_ALARM:
            return self._resting_on((trial,), chance, refuted=True)
        return self._resting_on((*self.trials, trial)[-MEMORY_TRIALS:], chance, refuted=False)

    def _resting_on(self, trials: tuple[TrialSpeeds, ...], chance: float, refuted: bool) -> Belief:
        priors = [_prior(self.identified, far) for far in (AGED, OTHER)]
        fits = [fit(trials, prior, self.identified.scatter) for prior in priors]
        found, prior = max(zip(fits, priors, strict=True), key=lambda one: one[0].log_evidence)
        speeds = np.concatenate([trial.speed_m_s[trial.measured] for trial in trials])
        nonsense = found.rms_m_s > _MISFIT * float(np.sqrt(np.mean(speeds**2)))
        refuted = refuted or nonsense
        return replace(self, prior=prior, trials=trials, fit=found, refuted=refuted, chance=chance)


def believe(identified: Identified, trials: Sequence[TrialSpeeds]) -> Belief:
    """After ``trials``, oldest first, of which the last 24 count; those without a speed tell
    nothing."""
    belief = Belief(identified, _prior(identified, AGED)).begun()
    for trial in [trial for trial in trials if trial.measured.any()][-2 * MEMORY_TRIALS :]:
        belief = belief.after(trial)
    return belief


def _prior(identified: Identified, far: tuple[float, ...]) -> Prior:
    """The identification's sigmas widened by how ``far`` the fish may be; what was only assumed is
    known no better than of any fish."""
    known = np.sqrt(np.diag(identified.covariance) + np.square(far))
    assumed = [name in identified.assumed for name in PARAMS]
    sigma = np.where(assumed, np.maximum(known, Prior().sigma), known)
    return Prior(identified.model, *sigma.tolist())
