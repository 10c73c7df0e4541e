"""The numbers of a fish from its trials, with priors and error bars.

Maximum a posteriori over the eight numbers of the model, shared by all trials, and for each trial
its own start speed, flow and gain, which are kept near their centres by how trials scatter. The
noise of beats is the measurement's, what the model leaves out of each, and a flow that moves within
the trial, which neighbouring beats share. The shape is drawn towards a fish without one: only what
the trials show is taken from them. The delay is told best by trials whose amplitude changes gently
from beat to beat: in a hard step the servo hides it.

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
from tailbeat.learning.fish_model import NUMBERS, Conditions, FishModel, TrialSpeeds
from tailbeat.learning.scatter import Scatter, learned, weights_of
from tailbeat.learning.slopes import groups_of


@dataclass(frozen=True)
class Prior:
    """What is believed of a fish before its trials: a model and how wrong it may be. Sigmas of
    kappa, slope and wake_s are relative (of the logarithm)."""

    model: FishModel = field(
        default_factory=lambda: FishModel(10.0, 0.2, 0.17, 0.3, 0.0, 0.004, 0.15, 1.0)
    )
    kappa: float = 0.8
    slope: float = 0.4
    dead_zone_rad: float = 0.09
    delay_s: float = 0.25
    bend_per_rad: float = 0.5
    linear_drag_m_s: float = 0.006
    wake_share: float = 0.15
    wake_s: float = 0.5

    @property
    def sigma(self) -> F64:
        """In the order of NUMBERS."""
        return np.array(list(vars(self).values())[1:], dtype=np.float64)

    @property
    def covariance(self) -> F64:
        """As of a ``Fit``."""
        return np.diag(self.sigma**2)


@dataclass(frozen=True)
class Fit:
    """``covariance``: 8 x 8, of the model as ``vector_of`` has it. ``conditions``: one per trial;
    ``condition_variance``: of its (start, flow, log gain), shape (trials, 3). ``residual_m_s``: per
    trial, measured minus model, NaN where not measured. ``rms_m_s``: of all residuals; ``beats``:
    how many there are. ``oddness``: per trial, mean square of its residuals over what was expected
    of them. ``vector``: all unknowns, for a fit that begins where this one ended."""

    model: FishModel
    covariance: F64
    conditions: list[Conditions]
    condition_variance: F64
    residual_m_s: list[F64]
    rms_m_s: float
    beats: int
    oddness: F64
    vector: F64


_ITERATIONS_MAX = 60
_CONVERGED = 1e-7  # of the cost
_DELAY_MAX_BEATS = 4.0
_CONDITIONS = 3  # start, flow, log gain of every trial
_SHARED = len(NUMBERS)
_KAPPA_RANGE = (0.05, 2000.0)
_BEND_RANGE = (-3.0, 4.0)
_SHARE_RANGE = (1e-3, 0.9)  # without any share nothing tells of its time constant
_WAKE_RANGE_S = (0.2, 6.0)
_SIGMA_MIN = 1e-4
_BLOCK_BEATS = 3


def fit(
    trials: Sequence[TrialSpeeds],
    prior: Prior | None = None,
    scatter: Scatter | None = None,
    weights: F64 | None = None,
    centres: F64 | None = None,
    begin: F64 | None = None,
) -> Fit:
    """The most probable model. Raises InputError when no beat has a speed.

    ``weights``: how much each trial counts (None = 1). ``centres``: (flow, log gain) that each
    trial is expected to have, shape (trials, 2); None = 0. ``begin``: ``vector`` of a fit to the
    first of these trials. Costs about 10 ms for four trials of 40 beats.
    """
    if not any(trial.measured.any() for trial in trials):
        raise InputError(
            "no beat of these trials has a speed.", "Look at the camera, or upload the speeds."
        )
    count = len(trials)
    problem = _Problem(
        trials,
        prior or Prior(),
        scatter or Scatter(),
        np.ones(count) if weights is None else weights,
        np.zeros((count, 2)) if centres is None else centres,
    )
    return problem.solved(_levenberg_marquardt(problem, problem.start(begin)))


@dataclass(frozen=True)
class Robust:
    """A fit, the scatter of the trials that it was learned with, and how much each counts."""

    fit: Fit
    scatter: Scatter
    weights: F64


def fit_robust(
    trials: Sequence[TrialSpeeds],
    prior: Prior | None = None,
    usual: Scatter | None = None,
    most: F64 | None = None,
    centres: F64 | None = None,
    last: Robust | None = None,
    rounds: int = 3,
) -> Robust:
    """The fit, the scatter and the weights in turn, ``rounds`` times. ``usual``: the scatter of any
    fish. ``most``: that a trial may count. ``last``: the answer for the first of these trials."""
    count = len(trials)
    most = np.ones(count) if most is None else most
    centres = np.zeros((count, 2)) if centres is None else centres
    usual = usual or Scatter()
    scatter, begin, weights = usual, None, most
    if last is not None:
        scatter, begin = last.scatter, last.fit.vector
        weights = np.minimum(most, np.append(last.weights, np.ones(count))[:count])
    for _ in range(rounds):
        found = fit(trials, prior, scatter, weights, centres, begin)
        begin = found.vector
        own = begin[_SHARED:].reshape(-1, _CONDITIONS) - np.pad(centres, ((0, 0), (1, 0)))
        weights = np.minimum(weights_of(own[:, 1:], found.oddness, scatter), most)
        scatter = learned(trials, found.residual_m_s, own, found.condition_variance, weights, usual)
    return Robust(found, scatter, weights)


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
    """(log kappa, log slope, dead zone, delay, bend, linear drag, wake share, log wake time): what
    a ``covariance`` is of."""
    m = model
    return np.array(
        [math.log(m.kappa_per_m), math.log(m.slope_m_s_rad), m.dead_zone_rad, m.delay_s,
         m.bend_per_rad, m.linear_drag_m_s, m.wake_share, math.log(m.wake_s)]
    )  # fmt: skip


def model_of(shared: F64) -> FishModel:
    """The other way, within what a fish can be."""
    share = min(max(float(shared[6]), 0.0), _SHARE_RANGE[1])
    return FishModel(
        kappa_per_m=min(max(math.exp(shared[0]), _KAPPA_RANGE[0]), _KAPPA_RANGE[1]),
        slope_m_s_rad=math.exp(shared[1]),
        dead_zone_rad=max(float(shared[2]), 0.0),
        delay_s=max(float(shared[3]), 0.0),
        bend_per_rad=min(max(float(shared[4]), _BEND_RANGE[0]), _BEND_RANGE[1]),
        linear_drag_m_s=max(float(shared[5]), 0.0),
        wake_share=share,
        wake_s=min(max(math.exp(shared[7]), _WAKE_RANGE_S[0]), _WAKE_RANGE_S[1]),
    )


def _bounds(beat_s: float) -> tuple[F64, F64]:
    """Lowest and highest of what ``vector_of`` gives."""
    low = [math.log(_KAPPA_RANGE[0]), -np.inf, 0.0, 0.0, _BEND_RANGE[0], 0.0, _SHARE_RANGE[0],
           math.log(_WAKE_RANGE_S[0])]  # fmt: skip
    high = [math.log(_KAPPA_RANGE[1]), np.inf, np.pi / 2, _DELAY_MAX_BEATS * beat_s,
            _BEND_RANGE[1], np.inf, _SHARE_RANGE[1], math.log(_WAKE_RANGE_S[1])]  # fmt: skip
    return np.array(low), np.array(high)


class _Problem:
    """The cost, its gradient and its curvature (Gauss and Newton's), as functions of one vector:
    the shared numbers, then (start, flow, log gain) of every trial."""

    def __init__(
        self,
        trials: Sequence[TrialSpeeds],
        prior: Prior,
        scatter: Scatter,
        weights: F64,
        centres: F64,
    ) -> None:
        count = len(trials)
        self.trials, self.weights = trials, weights
        self.groups = groups_of(trials, prior.model, scatter, weights)
        usual = [scatter.start_m_s, scatter.flow_m_s, scatter.gain]
        differ = np.maximum(usual, _SIGMA_MIN) / np.sqrt(weights)[:, None]
        own = np.column_stack([np.zeros(count), centres])
        self.centre = np.concatenate([vector_of(prior.model), own.ravel()])
        self.spread = np.concatenate([prior.sigma, differ.ravel()])
        low, high = _bounds(trials[0].beat_s)
        self.low = np.concatenate([low, np.tile([0.0, -np.inf, -np.inf], count)])
        self.high = np.concatenate([high, np.full(_CONDITIONS * count, np.inf)])

    def start(self, begin: F64 | None) -> F64:
        """The prior's centre, with what an earlier fit had found."""
        x: F64 = self.centre.copy()
        if begin is not None:
            x[: min(len(begin), len(x))] = begin[: len(x)]
        return np.clip(x, self.low, self.high)

    def conditions(self, x: F64, index: int) -> Conditions:
        start, flow, log_gain = x[_SHARED + _CONDITIONS * index :][:_CONDITIONS]
        return Conditions(max(float(start), 0.0), float(flow), math.exp(log_gain))

    def evaluated(self, x: F64) -> tuple[float, F64, F64]:
        """(cost, half its gradient, half its curvature)."""
        model = model_of(x[:_SHARED])
        off = (x - self.centre) / self.spread
        cost, gradient = float(off @ off), off / self.spread
        curvature = np.diag(1 / self.spread**2)
        for index, (squares, pull, both) in enumerate(self._squares(model, x)):
            at = _SHARED + _CONDITIONS * index
            own = slice(at, at + _CONDITIONS)
            cost += float(squares)
            gradient[:_SHARED] += pull[:_SHARED]
            gradient[own] += pull[_SHARED:]
            curvature[:_SHARED, :_SHARED] += both[:_SHARED, :_SHARED]
            curvature[:_SHARED, own] = both[:_SHARED, _SHARED:]
            curvature[own, :_SHARED] = both[_SHARED:, :_SHARED]
            curvature[own, own] += both[_SHARED:, _SHARED:]
        return cost, gradient, curvature

    def _squares(self, model: FishModel, x: F64) -> list[tuple[F64, F64, F64]]:
        """What ``TrialGroup.squares`` has of each trial, in their order."""
        found: list[tuple[F64, F64, F64]] = [(np.zeros(0),) * 3] * len(self.trials)
        for group in self.groups:
            rows = group.squares(model, [self.conditions(x, index) for index in group.at])
            for index, row in zip(group.at, zip(*rows, strict=True), strict=True):
                found[index] = row
        return found

    def solved(self, x: F64) -> Fit:
        """The answer that the vector stands for."""
        _, _, curvature = self.evaluated(x)
        covariance = np.linalg.inv(curvature)
        model = model_of(x[:_SHARED])
        conditions = [self.conditions(x, i) for i in range(len(self.trials))]
        residual = [
            trial.speed_m_s - model.beats(trial.amplitude_rad, trial.beat_s, given)
            for trial, given in zip(self.trials, conditions, strict=True)
        ]
        together = np.concatenate(residual)
        known = together[np.isfinite(together)]
        own = np.diag(covariance)[_SHARED:].reshape(-1, _CONDITIONS)
        return Fit(
            model=model,
            covariance=np.asarray(covariance[:_SHARED, :_SHARED], dtype=np.float64),
            conditions=conditions,
            condition_variance=own,
            residual_m_s=residual,
            rms_m_s=float(np.sqrt(np.mean(known**2))),
            beats=len(known),
            oddness=self._oddness(residual),
            vector=x,
        )

    def _oddness(self, residual: Sequence[F64]) -> F64:
        found = np.ones(len(self.trials))
        for group in self.groups:
            for index, white in zip(group.at, group.white, strict=True):
                if white.size:
                    left = residual[index][self.trials[index].measured]
                    found[index] = float(np.mean((white @ left) ** 2)) / self.weights[index]
        return found


def _levenberg_marquardt(problem: _Problem, x: F64) -> F64:
    """Projected onto the bounds, from ``x``."""
    cost, gradient, curvature = problem.evaluated(x)
    damping = 1e-3
    for _ in range(_ITERATIONS_MAX):
        pushed = ((x <= problem.low) & (gradient > 0)) | ((x >= problem.high) & (gradient < 0))
        free = ~pushed
        inner = curvature[np.ix_(free, free)]
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(inner + damping * np.diag(np.diag(inner)), gradient[free])
        moved = np.clip(x + step, problem.low, problem.high)
        new_cost, new_gradient, new_curvature = problem.evaluated(moved)
        if not new_cost < cost:
            if damping > 1e6:
                break
            damping *= 8
            continue
        gained = cost - new_cost
        x, cost, gradient, curvature = moved, new_cost, new_gradient, new_curvature
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

    Of all numbers, gains and flows at that distance from the best, in units of what is known of
    them, the one straight up the slope of the way. ``covariance``: as of a ``Fit``.
    """
    centre = np.r_[vector_of(model), 1.0, 0.0]
    whole = np.zeros((_SHARED + 2, _SHARED + 2))
    whole[:_SHARED, :_SHARED] = covariance
    whole[-2, -2], whole[-1, -1] = scatter.gain**2, scatter.flow_m_s**2
    sigma = np.sqrt(np.diag(whole))

    def fish_at(x: F64) -> tuple[FishModel, Conditions]:
        return model_of(x), Conditions(gain=max(float(x[-2]), 0.0), flow_m_s=float(x[-1]))

    def travel_at(x: F64) -> float:
        fish, conditions = fish_at(x)
        return travel_m(fish, amplitude_rad, beat_s, conditions)

    slope = np.zeros(len(centre))
    for i in np.flatnonzero(sigma > 0):
        step = np.zeros(len(centre))
        step[i] = sigma[i]
        slope[i] = (travel_at(centre + step) - travel_at(centre - step)) / (2 * sigma[i])
    spread = math.sqrt(float(slope @ whole @ slope))
    if spread == 0:
        return model, Conditions()
    return fish_at(centre + PESSIMISM * (whole @ slope) / spread)
