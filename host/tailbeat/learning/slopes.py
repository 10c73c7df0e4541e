"""Beat means of many trials and their derivatives at once, with the bits that each alone has.

Trials of one length go through every step together. Products of matrices are those of the
single trial, one after the other inside one call, so that no sum changes its order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import (
    BY_DELAY,
    BY_KAPPA,
    BY_LINEAR,
    BY_SHARE,
    BY_START,
    BY_WAKE_S,
    NUMBERS,
    Conditions,
    FishModel,
    TrialSpeeds,
)
from tailbeat.learning.scatter import Scatter, beat_variance

_OF_EACH = 3  # start, flow, log gain


def speeds_and_slopes(
    model: FishModel, amplitude_rad: F64, beat_s: float, given: Sequence[Conditions]
) -> tuple[F64, F64]:
    """Beat means and their derivatives.

    Parameters
    ----------
    model : FishModel
        Of all the trials.
    amplitude_rad : ndarray, shape (trials, beats)
        As executed.
    beat_s : float
        Period of the tail.
    given : sequence of Conditions
        One for each trial.

    Returns
    -------
    speed_m_s : ndarray, shape (trials, beats)
        Over ground.
    by : ndarray, shape (trials, beats, 11)
        Derivatives by ``vector_of`` and (start, flow, log gain).
    """
    gain = np.array([one.gain for one in given])[:, None]
    squared_gain = np.array([one.gain**2 for one in given])[:, None]  # Python's own square
    flow = np.array([one.flow_m_s for one in given])[:, None]
    root = model.root(amplitude_rad)
    thrust = (gain * root) ** 2
    distance, by_w, by_model = model.distances(thrust, beat_s, [one.start_m_s for one in given])
    mean_by_w = np.diff(by_w, axis=1) / beat_s
    by = np.diff(by_model, axis=1) / beat_s
    by_root = 2 * root * squared_gain
    beyond = np.maximum(amplitude_rad - model.dead_zone_rad, 0.0)
    thrust_by = np.stack(
        [2 * thrust, -by_root * model.root_slope(amplitude_rad),
         by_root * model.slope_m_s_rad * beyond**2],
        axis=-1,
    )  # fmt: skip
    found = np.empty((*amplitude_rad.shape, len(NUMBERS) + _OF_EACH))
    found[..., (1, 2, 4)] = by_thrust = mean_by_w @ thrust_by
    found[..., 0] = by[..., BY_KAPPA] * model.kappa_per_m
    found[..., 3] = by[..., BY_DELAY]
    found[..., 5] = by[..., BY_LINEAR]
    found[..., 6] = by[..., BY_SHARE]
    found[..., 7] = by[..., BY_WAKE_S] * model.wake_s
    found[..., 8] = by[..., BY_START]
    found[..., 9] = 1.0
    found[..., 10] = by_thrust[..., 0]
    return np.diff(distance, axis=1) / beat_s + flow, found


def speed_and_slopes(model: FishModel, trial: TrialSpeeds, given: Conditions) -> tuple[F64, F64]:
    """Of one trial: shapes (beats,) and (beats, 11)."""
    speed, by = speeds_and_slopes(model, trial.amplitude_rad[None], trial.beat_s, [given])
    return speed[0], by[0]


@dataclass(frozen=True)
class TrialGroup:
    """Trials of as many beats, as many of them measured: one call for each step of them all.

    Attributes
    ----------
    at : list of int
        Their places among all trials.
    amplitude_rad : ndarray, shape (trials, beats)
    speed_m_s : ndarray, shape (trials, measured)
    seen : ndarray of bool, shape (trials, beats), or None
        Which beats are measured; None = all.
    white : ndarray, shape (trials, measured, measured)
        Makes the noise of the measured beats white and of size 1.
    """

    at: list[int]
    beat_s: float
    amplitude_rad: F64
    speed_m_s: F64
    seen: NDArray[np.bool_] | None
    white: F64

    def squares(self, model: FishModel, given: Sequence[Conditions]) -> tuple[F64, F64, F64]:
        """Of the white misses: their sum of squares, half its gradient and half its curvature by
        the eleven numbers, one for each trial."""
        speed, by = speeds_and_slopes(model, self.amplitude_rad, self.beat_s, given)
        if self.seen is not None:
            shape = self.speed_m_s.shape
            speed, by = speed[self.seen].reshape(shape), by[self.seen].reshape(*shape, -1)
        miss = self.white @ (speed - self.speed_m_s)[..., None]
        slopes = self.white @ by
        turned = slopes.transpose(0, 2, 1)
        costs = miss.transpose(0, 2, 1) @ miss
        return costs[:, 0, 0], (turned @ miss)[..., 0], turned @ slopes


def groups_of(
    trials: Sequence[TrialSpeeds], model: FishModel, scatter: Scatter, weights: F64
) -> list[TrialGroup]:
    """All ``trials``, put together; what weighs more has less noise.

    Parameters
    ----------
    trials : sequence of TrialSpeeds
        In any order.
    model, scatter : FishModel, Scatter
        What the noise of the beats is by.
    weights : ndarray, shape (trials,)
        How much each counts.
    """
    alike: dict[tuple[int, int, float], list[int]] = {}
    for index, trial in enumerate(trials):
        key = trial.beats, int(np.count_nonzero(trial.measured)), trial.beat_s
        alike.setdefault(key, []).append(index)
    groups = []
    for (beats, measured, beat_s), at in alike.items():
        own = [trials[i] for i in at]
        seen = np.array([trial.measured for trial in own])
        groups.append(
            TrialGroup(
                at=at,
                beat_s=beat_s,
                amplitude_rad=np.array([trial.amplitude_rad for trial in own]),
                speed_m_s=np.array([trial.speed_m_s[trial.measured] for trial in own]),
                seen=seen if measured < beats else None,
                white=_whiteners(own, seen, model, scatter, weights[at]),
            )
        )
    return groups


def _whiteners(
    trials: Sequence[TrialSpeeds],
    seen: NDArray[np.bool_],
    model: FishModel,
    scatter: Scatter,
    weights: F64,
) -> F64:
    """What makes the measured beats' noise white and of size 1, (trials, seen, seen)."""
    moving = scatter.moving(trials[0].beats, trials[0].beat_s)
    noise = [
        (moving + np.diag(beat_variance(trial, model, scatter)))[np.ix_(known, known)]
        for trial, known in zip(trials, seen, strict=True)
    ]
    white: F64 = np.linalg.inv(np.linalg.cholesky(np.array(noise) / weights[:, None, None]))
    return white
