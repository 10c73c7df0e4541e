"""The four numbers of a fish from its trials, with priors and error bars.

Maximum a posteriori over (log kappa, log slope, dead zone, delay), shared by all trials, and for
each trial its own start speed, flow and gain, which are kept near (0, 0, 1) by what is known of how
trials differ. Every beat counts by its measurement's sigma and the model's own imperfection. The
delay is told best by trials whose amplitude changes gently from beat to beat: in a hard step the
servo hides it.

How far amplitudes carry a fish, and one that is as strong as may still be believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds


@dataclass(frozen=True)
class Prior:
    """What is believed of a fish before its trials: a model and how wrong it may be. Sigmas of
    kappa and slope are relative (of the logarithm)."""

    model: FishModel = field(default_factory=lambda: FishModel(10.0, 0.219, 0.197, 0.3))
    kappa: float = 0.8
    slope: float = 0.3
    dead_zone_rad: float = 0.08
    delay_s: float = 0.25

    @property
    def sigma(self) -> F64:
        """In the order of PARAMS."""
        return np.array([self.kappa, self.slope, self.dead_zone_rad, self.delay_s])

    @property
    def covariance(self) -> F64:
        """As of a ``Fit``."""
        return np.diag(self.sigma**2)


@dataclass(frozen=True)
class Scatter:
    """How trials of one fish differ, as standard deviations; 0 = never differs. ``model_m_s``: of a
    beat's speed, for what the model leaves out."""

    gain: float = 0.02
    flow_m_s: float = 0.0015
    start_m_s: float = 0.002
    model_m_s: float = 0.001
    switch: float = 0.05

    def draw(self, rng: np.random.Generator) -> Conditions:
        """How one trial differs from the others."""
        return Conditions(
            start_m_s=abs(rng.normal(0, self.start_m_s)),
            flow_m_s=rng.normal(0, self.flow_m_s),
            gain=max(rng.normal(1, self.gain), 0.0),
        )


@dataclass(frozen=True)
class Fit:
    """``covariance``: 4 x 4, of (log kappa, log slope, dead zone, delay). ``conditions``: one per
    trial. ``residual_m_s``: per trial, measured minus model, NaN where not measured.
    ``rms_m_s``: of all residuals; ``beats``: how many there are. ``log_evidence``: of the prior, by
    Laplace's approximation; for comparing priors on the same trials and scatter."""

    model: FishModel
    covariance: F64
    conditions: list[Conditions]
    residual_m_s: list[F64]
    rms_m_s: float
    beats: int
    log_evidence: float = 0.0


_ITERATIONS_MAX = 40
_CONVERGED = 1e-9  # of the cost
_DELAY_MAX_BEATS = 4.0
_CONDITIONS = 3  # start, flow, log gain of every trial
_SHARED = 4
_KAPPA_RANGE = (0.05, 2000.0)
_START_SIGMA_MIN_M_S = 1e-4
_SIGMA_MIN = 1e-4
_BLOCK_BEATS = 3


def fit(
    trials: Sequence[TrialSpeeds], prior: Prior | None = None, scatter: Scatter | None = None
) -> Fit:
    """The most probable model. Raises InputError when no beat has a speed.

    Costs about 5 ms for four trials of 40 beats.
    """
    if not any(trial.measured.any() for trial in trials):
        raise InputError(
            "no beat of these trials has a speed.", "Look at the camera, or upload the speeds."
        )
    problem = _Problem(trials, prior or Prior(), scatter or Scatter())
    return problem.solved(_levenberg_marquardt(problem))


def sample(found: Fit, count: int = 40, seed: int = 1) -> list[FishModel]:
    """Models drawn from the fit's normal posterior (``count`` even): what ``bootstrap`` gives for
    data that are as the model says, in a hundredth of the time. In pairs on either side of the fit
    and with its very covariance: so few drawn plainly would give every fish the same lopsided
    interval."""
    normal = np.random.default_rng(seed).standard_normal((count // 2, _SHARED))
    normal = normal @ np.linalg.inv(np.linalg.cholesky(normal.T @ normal / len(normal))).T
    normal = np.concatenate([normal, -normal])
    rows = vector_of(found.model) + normal @ np.linalg.cholesky(found.covariance).T
    return [model_of(row) for row in rows]


def bootstrap(
    trials: Sequence[TrialSpeeds],
    found: Fit,
    count: int = 40,
    seed: int = 1,
    prior: Prior | None = None,
    scatter: Scatter | None = None,
) -> list[FishModel]:
    """Models that fit data as these could have come out, too: residuals are drawn anew within each
    trial, in blocks of three beats, and the conditions from ``scatter``. Deterministic by ``seed``.
    """
    rng = np.random.default_rng(seed)
    differ = scatter or Scatter()
    models = []
    for _ in range(count):
        again = [
            _resampled(trial, found.model, residual, differ, rng)
            for trial, residual in zip(trials, found.residual_m_s, strict=True)
        ]
        models.append(fit(again, prior, scatter).model)
    return models


def _resampled(
    trial: TrialSpeeds, model: FishModel, residual: F64, differ: Scatter, rng: np.random.Generator
) -> TrialSpeeds:
    speed = model.beats(trial.amplitude_rad, trial.beat_s, differ.draw(rng))
    known = residual[np.isfinite(residual)]
    blocks = -(-trial.beats // _BLOCK_BEATS)
    begins = rng.integers(0, max(len(known) - _BLOCK_BEATS, 0) + 1, blocks)
    places = (begins[:, None] + np.arange(_BLOCK_BEATS)).ravel()[: trial.beats]
    drawn = known[np.minimum(places, len(known) - 1)] if len(known) else np.zeros(trial.beats)
    return replace(trial, speed_m_s=np.where(trial.measured, speed + drawn, np.nan))


def vector_of(model: FishModel) -> F64:
    """(log kappa, log slope, dead zone, delay): what a ``covariance`` is of."""
    return np.array(
        [math.log(model.kappa_per_m), math.log(model.slope_m_s_rad), model.dead_zone_rad,
         model.delay_s]
    )  # fmt: skip


def model_of(shared: F64) -> FishModel:
    """The other way, within what a fish can be."""
    low, high = _KAPPA_RANGE
    return FishModel(
        kappa_per_m=min(max(math.exp(shared[0]), low), high),
        slope_m_s_rad=math.exp(shared[1]),
        dead_zone_rad=max(float(shared[2]), 0.0),
        delay_s=max(float(shared[3]), 0.0),
    )


class _Problem:
    """Residuals over sigma and their Jacobian, as functions of one vector: the four shared numbers,
    then (start, flow, log gain) of every trial."""

    def __init__(self, trials: Sequence[TrialSpeeds], prior: Prior, scatter: Scatter) -> None:
        self.trials = trials
        self.sigma = [beat_sigma(trial, prior.model, scatter) for trial in trials]
        differ = [
            max(scatter.start_m_s, _START_SIGMA_MIN_M_S),
            max(scatter.flow_m_s, _SIGMA_MIN),
            max(scatter.gain, _SIGMA_MIN),
        ]
        self.centre = np.r_[vector_of(prior.model), np.zeros(_CONDITIONS * len(trials))]
        self.spread = np.r_[prior.sigma, differ * len(trials)]
        self.low = np.r_[math.log(_KAPPA_RANGE[0]), -np.inf, 0.0, 0.0,
                         [0.0, -np.inf, -np.inf] * len(trials)]  # fmt: skip
        beat_s = trials[0].beat_s
        self.high = np.r_[math.log(_KAPPA_RANGE[1]), np.inf, np.pi / 2, _DELAY_MAX_BEATS * beat_s,
                          np.full(_CONDITIONS * len(trials), np.inf)]  # fmt: skip

    def conditions(self, x: F64, index: int) -> Conditions:
        start, flow, log_gain = x[_SHARED + _CONDITIONS * index :][:_CONDITIONS]
        return Conditions(max(float(start), 0.0), float(flow), math.exp(log_gain))

    def evaluated(self, x: F64) -> tuple[F64, F64]:
        """(residuals, Jacobian): the prior's rows first, then the measured beats of every trial."""
        model = model_of(x[:_SHARED])
        prior = (x - self.centre) / self.spread
        rows, slopes = [prior], [np.diag(1 / self.spread)]
        for index, (trial, sigma) in enumerate(zip(self.trials, self.sigma, strict=True)):
            speed, by = speed_and_slopes(model, trial, self.conditions(x, index))
            seen = trial.measured
            rows.append((speed[seen] - trial.speed_m_s[seen]) / sigma[seen])
            wide = np.zeros((int(seen.sum()), len(x)))
            wide[:, :_SHARED] = by[seen, :_SHARED] / sigma[seen, None]
            at = _SHARED + _CONDITIONS * index
            wide[:, at : at + _CONDITIONS] = by[seen, _SHARED:] / sigma[seen, None]
            slopes.append(wide)
        return np.concatenate(rows), np.vstack(slopes)

    def solved(self, x: F64) -> Fit:
        model = model_of(x[:_SHARED])
        off, jacobian = self.evaluated(x)
        normal = jacobian.T @ jacobian
        covariance = np.linalg.inv(normal)[:_SHARED, :_SHARED]
        narrowed = float(np.linalg.slogdet(normal)[1]) / 2 + float(np.log(self.spread).sum())
        conditions = [self.conditions(x, index) for index in range(len(self.trials))]
        residual = [
            trial.speed_m_s - model.beats(trial.amplitude_rad, trial.beat_s, given)
            for trial, given in zip(self.trials, conditions, strict=True)
        ]
        together = np.concatenate(residual)
        known = together[np.isfinite(together)]
        return Fit(
            model=model,
            covariance=np.asarray(covariance, dtype=np.float64),
            conditions=conditions,
            residual_m_s=residual,
            rms_m_s=float(np.sqrt(np.mean(known**2))),
            beats=len(known),
            log_evidence=-float(off @ off) / 2 - narrowed,
        )


def beat_sigma(trial: TrialSpeeds, model: FishModel, scatter: Scatter) -> F64:
    """Standard deviation of measured minus modelled speed per beat, conditions known."""
    switched = scatter.switch * steepness(model.steady_m_s(trial.amplitude_rad))
    sigma: F64 = np.sqrt(trial.sigma_m_s**2 + scatter.model_m_s**2 + switched**2)
    return sigma


def steepness(steady_m_s: F64) -> F64:
    """Of the steady speeds of beats: the larger of the last two changes, from rest, m/s."""
    change = np.abs(np.diff(steady_m_s, prepend=0.0))
    steepest: F64 = np.maximum(change, np.concatenate([[0.0], change[:-1]]))
    return steepest


def speed_and_slopes(model: FishModel, trial: TrialSpeeds, given: Conditions) -> tuple[F64, F64]:
    """Beat means and their derivatives by (log kappa, log slope, dead zone, delay, start, flow, log
    gain)."""
    steady = given.gain * model.steady_m_s(trial.amplitude_rad)
    w = steady**2
    distance, by_w, by_model = model.distance(w, trial.beat_s, given.start_m_s, slopes=True)
    assert by_w is not None and by_model is not None
    mean_by_w = np.diff(by_w, axis=0) / trial.beat_s
    mean_by_model = np.diff(by_model, axis=0) / trial.beat_s
    by_log_scale = mean_by_w @ (2 * w)
    columns = [
        mean_by_model[:, 0] * model.kappa_per_m,
        by_log_scale,
        mean_by_w @ (-2 * steady * given.gain * model.slope_m_s_rad),
        mean_by_model[:, 1],
        mean_by_model[:, 2],
        np.ones(trial.beats),
        by_log_scale,
    ]
    return np.diff(distance) / trial.beat_s + given.flow_m_s, np.column_stack(columns)


def _levenberg_marquardt(problem: _Problem) -> F64:
    """Projected onto the bounds; the start is the prior's centre."""
    x: F64 = np.clip(problem.centre, problem.low, problem.high)
    residual, jacobian = problem.evaluated(x)
    cost, damping = float(residual @ residual), 1e-3
    for _ in range(_ITERATIONS_MAX):
        gradient, normal = jacobian.T @ residual, jacobian.T @ jacobian
        pushed = ((x <= problem.low) & (gradient > 0)) | ((x >= problem.high) & (gradient < 0))
        free = ~pushed
        diagonal = np.diag(normal)[free]
        inner = normal[np.ix_(free, free)] + damping * np.diag(diagonal)
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(inner, gradient[free])
        moved = np.clip(x + step, problem.low, problem.high)
        new_residual, new_jacobian = problem.evaluated(moved)
        new_cost = float(new_residual @ new_residual)
        if not new_cost < cost:
            if damping > 1e6:
                break
            damping *= 8
            continue
        gained = cost - new_cost
        x, residual, jacobian, cost = moved, new_residual, new_jacobian, new_cost
        damping = max(damping / 8, 1e-9)
        if gained < _CONVERGED * cost:
            break
    return x


PESSIMISM = 2.0  # sigmas
_COAST_S = 5.0  # after the last beat, until somebody is at the fish


def speeds_with_coast(
    model: FishModel, amplitude_rad: ArrayLike, beat_s: float, given: Conditions | None = None
) -> F64:
    """Mean speed over ground per beat, m/s: of ``amplitude_rad`` and then of the coast after it,
    shape (beats + some,)."""
    coast = np.zeros(max(1, round(_COAST_S / beat_s)))
    amplitude = np.concatenate([np.asarray(amplitude_rad, dtype=np.float64), coast])
    return model.beats(amplitude, beat_s, given)


def travel_m(
    model: FishModel, amplitude_rad: ArrayLike, beat_s: float, given: Conditions | None = None
) -> float:
    """Way over ground until the coast after the last beat is over, m."""
    return float(np.sum(speeds_with_coast(model, amplitude_rad, beat_s, given))) * beat_s


def farthest(
    model: FishModel, covariance: F64, scatter: Scatter, amplitude_rad: ArrayLike, beat_s: float
) -> tuple[FishModel, Conditions]:
    """The most probable of the fish and days that travel ``PESSIMISM`` sigmas too far.

    Of all (log kappa, log slope, dead zone, delay, gain, flow) at that distance from the best, in
    units of what is known of them, the one straight up the slope of the way. ``covariance``: 4 x 4
    of the first four.
    """
    centre = np.r_[vector_of(model), 1.0, 0.0]
    whole = np.zeros((6, 6))
    whole[:4, :4] = covariance
    whole[4, 4], whole[5, 5] = scatter.gain**2, scatter.flow_m_s**2
    sigma = np.sqrt(np.diag(whole))

    def fish_at(x: F64) -> tuple[FishModel, Conditions]:
        return model_of(x), Conditions(gain=max(float(x[4]), 0.0), flow_m_s=float(x[5]))

    def travel_at(x: F64) -> float:
        fish, conditions = fish_at(x)
        return travel_m(fish, amplitude_rad, beat_s, conditions)

    slope = np.zeros(6)
    for i in np.flatnonzero(sigma > 0):
        step = np.zeros(6)
        step[i] = sigma[i]
        slope[i] = (travel_at(centre + step) - travel_at(centre - step)) / (2 * sigma[i])
    spread = math.sqrt(float(slope @ whole @ slope))
    if spread == 0:
        return model, Conditions()
    return fish_at(centre + PESSIMISM * (whole @ slope) / spread)
