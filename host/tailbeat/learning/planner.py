"""The best amplitudes for a reference by a model: box-constrained least squares in thrust.

min over w of sum(cost(reference - f(w) - disturbance)), with 0 <= w <= w_max, f the beat means of
the model, w the thrust per beat (nearly linear, and free of the dead zone). The
cost is the square (``power`` 2), or a higher power of the error blurred by how trials scatter,
which draws the largest errors together. Projected Newton with the exact Jacobian of the model: each
step solves a quadratic program in the box by an active set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.learning.fish_model import Conditions, FishModel

_STEPS_MAX = 60
_HALVINGS_MAX = 30
_PIVOTS_MAX = 400
_RIDGE = 1e-10  # of the mean curvature: beats that nothing tells of stay where they are
_ROUGHLY = 1e-4  # of w_max: good enough to go on from
_DONE = 1e-8  # of w_max: no beat moves by more
# Amplitudes are rounded to it, so that computers whose sums differ in the last bit agree.
_STEP_RAD = 1e-5
_ROUNDING = 1e-13  # of a cost: near the optimum it cannot tell steps apart
_BLUR_MIN = 1e-12  # mm^2/s^2
_MM = 1e3  # costs are taken of errors in mm/s, whose powers stay within what floats hold


@dataclass(frozen=True)
class Plan:
    """``amplitude_rad``: within [0, amplitude_max_rad]. ``predicted_m_s``: what the model says the
    beats will be, disturbance included. ``max_abs_error_m_s``: of that prediction."""

    amplitude_rad: F64
    predicted_m_s: F64
    max_abs_error_m_s: float


def plan(
    model: FishModel,
    reference_m_s: ArrayLike,
    beat_s: float,
    amplitude_max_rad: float,
    disturbance_m_s: ArrayLike | None = None,
    conditions: Conditions | None = None,
    power: float = 2.0,
    scatter_m_s: float = 0.0,
    low_rad: ArrayLike = 0.0,
    high_rad: ArrayLike = np.inf,
) -> Plan:
    """Deterministic; costs 5 ms for 40 beats, 10 ms with ``power`` 6.

    ``low_rad``, ``high_rad``: narrower limits of the amplitude, of all beats or of each.
    ``power`` >= 2: the cost of an error e is (e**2 + scatter_m_s**2)**(power/2).
    Raises InputError when a value makes no sense.
    """
    wanted = np.asarray(reference_m_s, dtype=np.float64)
    given = conditions or Conditions()
    disturbance = np.broadcast_to(
        np.asarray(0.0 if disturbance_m_s is None else disturbance_m_s, np.float64), wanted.shape
    )
    _check(wanted, disturbance, amplitude_max_rad, power)
    strongest_rad = model.strongest_rad(amplitude_max_rad)
    w_max = float(model.thrust(strongest_rad))
    high = np.broadcast_to(np.clip(high_rad, 0.0, amplitude_max_rad), wanted.shape)
    low = np.minimum(np.maximum(low_rad, 0.0), high)
    w = np.zeros(len(wanted))
    if w_max > 0:
        target = wanted - given.flow_m_s - disturbance
        useful = np.minimum(low, strongest_rad), np.minimum(high, strongest_rad)
        box = model.thrust(useful[0]) / w_max, model.thrust(useful[1]) / w_max
        task = _Task(model, target, beat_s, given, w_max, box, power, scatter_m_s)
        w = w_max * task.solve()
    amplitude = np.clip(_amplitude(model, w, w_max, strongest_rad), low, high)
    predicted = model.beats(amplitude, beat_s, given) + disturbance
    return Plan(amplitude, predicted, float(np.abs(wanted - predicted).max()))


def _check(wanted: F64, disturbance: F64, amplitude_max_rad: float, power: float) -> None:
    fine = wanted.ndim == 1 and wanted.size and np.all(np.isfinite(wanted))
    if not (fine and np.all(np.isfinite(disturbance)) and amplitude_max_rad > 0 and power >= 2):
        raise InputError(
            "there is nothing to plan: a speed, the largest amplitude or the power makes no sense.",
            "Check the reference and AMP_MAX_RAD.",
        )


def _amplitude(model: FishModel, w: F64, w_max: float, strongest_rad: float) -> F64:
    """0 where there is no thrust, the map's amplitude elsewhere, never above the strongest one."""
    amplitude = model.amplitude_of_root(np.sqrt(w))
    amplitude = np.minimum(np.round(amplitude / _STEP_RAD) * _STEP_RAD, strongest_rad)
    amplitude[w >= w_max * (1 - _DONE)] = strongest_rad
    amplitude[w <= _DONE * w_max] = 0.0
    return amplitude


@dataclass(frozen=True)
class _Point:
    cost: float
    gradient: F64
    hessian: F64


@dataclass(frozen=True)
class _Task:
    """In x = w/w_max, from 0 to 1, and errors in mm/s."""

    model: FishModel
    target_m_s: F64  # the speed over water that is wanted
    beat_s: float
    conditions: Conditions
    w_max: float
    box: tuple[F64, F64]
    power: float
    scatter_m_s: float

    def solve(self) -> F64:
        """The optimum, and the lower limit where thrust comes too late to matter."""
        low, high = self.box
        x = np.clip(np.maximum(self.target_m_s, 0) ** 2 / self.w_max, low, high)
        if self.power > 2:  # from far away Newton's steps on a high power are short
            x = replace(self, power=2.0).descend(x, _ROUGHLY)
        x = self.descend(x, _DONE)
        _, jacobian = self._errors(x)
        return np.where(np.any(jacobian != 0, axis=0), x, low)

    def descend(self, x: F64, done: float) -> F64:
        """Newton steps from ``x`` until no beat moves by more than ``done``."""
        at = self._at(x)
        low, high = self.box
        for _ in range(_STEPS_MAX):
            step = box_step(at.hessian, at.gradient, low - x, high - x)
            share = 1.0
            for _ in range(_HALVINGS_MAX):
                moved = np.clip(x + share * step, low, high)
                found = self._at(moved)
                if found.cost <= at.cost * (1 + _ROUNDING):
                    break
                share /= 2
            else:
                return x
            way = float(np.abs(moved - x).max())
            x, at = moved, found
            if way < done:
                break
        return x

    def _at(self, x: F64) -> _Point:
        error, jacobian = self._errors(x)
        blurred = np.maximum(error**2 + (_MM * self.scatter_m_s) ** 2, _BLUR_MIN)
        p = self.power
        high = blurred ** (p / 2 - 1)
        slope = p * error * high
        curvature = p * high * (1 + (p - 2) * error**2 / blurred)
        hessian = (jacobian.T * curvature) @ jacobian
        mean_curvature = float(np.trace(hessian)) / len(x)
        hessian[np.diag_indices(len(x))] += _RIDGE * (mean_curvature or 1.0)
        return _Point(
            cost=float(blurred @ high),
            gradient=-(jacobian.T @ slope),
            hessian=hessian,
        )

    def _errors(self, x: F64) -> tuple[F64, F64]:
        """(target - speed, mm/s; derivative of the speed to x, mm/s)."""
        thrust = self.w_max * self.conditions.gain**2
        distance, by_w, _ = self.model.distance(
            thrust * x, self.beat_s, self.conditions.start_m_s, slopes=True
        )
        assert by_w is not None
        speed = np.diff(distance) / self.beat_s
        jacobian = np.diff(by_w, axis=0) * (_MM * thrust / self.beat_s)
        return _MM * (self.target_m_s - speed), jacobian


def box_step(hessian: F64, gradient: F64, low: F64, high: F64) -> F64:
    """min 0.5*d'Hd + g'd with low <= d <= high, low <= 0 <= high, H positive definite.

    A primal active set: the free block is solved, the step ends at the first bound that is met and
    that beat is fixed; at an optimum of the free block the fixed beat that wants inside most is let
    go.
    """
    d = np.zeros_like(gradient)
    movable = low < high
    free = movable & ((d > low) | (gradient < 0)) & ((d < high) | (gradient > 0))
    tiny = 1e-12 * (np.abs(gradient).max() + 1e-300)
    for _ in range(_PIVOTS_MAX):
        pull = hessian @ d + gradient
        if free.any():
            move = np.zeros_like(d)
            move[free] = -np.linalg.solve(hessian[np.ix_(free, free)], pull[free])
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(move < 0, (low - d) / move, (high - d) / move)
            room = np.where(free & (move != 0), room, np.inf)
            first = int(np.argmin(room))
            if room[first] < 1:
                d = np.clip(d + room[first] * move, low, high)
                d[first] = low[first] if move[first] < 0 else high[first]
                free[first] = False
                continue
            d = np.clip(d + move, low, high)
            pull = hessian @ d + gradient
        inward = np.where(free | ~movable, 0.0, np.where(d <= low, -pull, pull))
        best = int(np.argmax(inward))
        if inward[best] <= tiny:
            return d
        free[best] = True
    return d
