"""Plants as the error bound sees them: noise-free beat means of a fish at rest, and their slopes.

The mean speed over a beat is nearly linear in ``w = vss(u)**2``, the square of the steady speed,
which is proportional to thrust and free of the dead zone; so w, and not the amplitude, is what the
bound is searched in.

The two best inputs on a plant: least squares, and minimax by a sequence of linear programs.

Both search w in 0 <= w <= w_max. A slew limit between neighbouring beats bounds w
from above by a concave function of the neighbour's, so what it allows is a convex set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.planner import box_step
from tailbeat.sim.config import DEFAULT_SEED, make_config

_DIFFERENCE = 1e-4  # of the largest w
_TABLE_POINTS = 200
_RUN_BEATS = 6
_SPEED_MIN_M_S = 1e-6  # below it a fish has no thrust; keeps w/w_max a number
_BISECTIONS = 20


class ModelPlant:
    """An identified fish; slopes are exact. ``w_max``: largest w, (m/s)**2. ``delay_s``: from a
    beat's begin to its thrust."""

    def __init__(self, model: FishModel, beat_s: float, amplitude_max_rad: float) -> None:
        strongest_rad = model.strongest_rad(amplitude_max_rad)
        self.w_max = max(float(model.root(strongest_rad)), _SPEED_MIN_M_S) ** 2
        self.delay_s = model.delay_s
        self._model, self._beat_s = model, beat_s
        self._amplitude_max = strongest_rad

    def amplitude_rad(self, w: F64) -> F64:
        """The smallest amplitude that gives w; for 0 the edge of the dead zone, from where thrust
        is soonest reached."""
        amplitude = self._model.amplitude_of_root(np.sqrt(np.maximum(w, 0)))
        return np.asarray(np.clip(amplitude, 0, self._amplitude_max))

    def thrust(self, amplitude_rad: F64) -> F64:
        """w of amplitudes, at most ``w_max``."""
        return np.minimum(self._model.thrust(amplitude_rad), self.w_max)

    def beats(self, w: F64) -> F64:
        """Mean speed of every beat, m/s."""
        distance, _, _ = self._model.distance(w, self._beat_s)
        mean: F64 = np.diff(distance) / self._beat_s
        return mean

    def slopes(self, w: F64, beats_m_s: F64) -> F64:
        """d beats[k] / d w[j], shape (beats, beats); ``beats_m_s`` = ``beats(w)``."""
        _, by_w, _ = self._model.distance(w, self._beat_s, slopes=True)
        assert by_w is not None
        slopes: F64 = np.diff(by_w, axis=0) / self._beat_s
        return slopes


class SimulatedPlant:
    """The simulator's plant, ``sim_config_t *``, with the face of ``ModelPlant``; slopes are finite
    differences of it."""

    def __init__(self, config: Any, beat_s: float, amplitude_max_rad: float) -> None:
        self._config, self._beat_s = config, beat_s
        self._amplitude_max = amplitude_max_rad
        tank = config.plant == lib.SIM_PLANT_TANK
        self.delay_s = float(config.delay_s) if tank else 0.0
        self._kappa_per_m: float = config.kappa_per_m if tank else config.drag_kg_m / config.mass_kg
        self._beats = math.ceil(self.delay_s / beat_s) + _RUN_BEATS
        edge = self._dead_zone_rad()
        self._amplitudes = np.linspace(edge, max(amplitude_max_rad, edge + 1e-6), _TABLE_POINTS)
        self._speeds = np.array([self._steady_m_s(a) for a in self._amplitudes])
        self._speeds[0] = 0.0
        self._keep_what_is_faster()
        self.w_max = max(float(self._speeds[-1]), _SPEED_MIN_M_S) ** 2

    def _keep_what_is_faster(self) -> None:
        """A map that falls again has a smaller amplitude for every speed it falls to."""
        before = np.r_[-1.0, np.maximum.accumulate(self._speeds)[:-1]]
        faster = self._speeds > before
        self._amplitudes, self._speeds = self._amplitudes[faster], self._speeds[faster]

    def _dead_zone_rad(self) -> float:
        """The largest amplitude without thrust: as commanded, a slow servo swings less."""
        low, high = 0.0, self._amplitude_max
        if self._steady_m_s(high) == 0:
            return high
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._steady_m_s(middle) > 0 else (middle, high)
        return low

    def _steady_m_s(self, amplitude_rad: float) -> float:
        """From the way a run from rest takes it: x = ln(cosh(kappa*vss*t))/kappa."""
        run = plant_beats(self._config, np.full(self._beats, amplitude_rad), self._beat_s)
        time_s = self._beats * self._beat_s - self.delay_s
        y = self._kappa_per_m * float(run.sum()) * self._beat_s
        root = math.sqrt(-math.expm1(-2 * y))
        return (y + math.log1p(root)) / (self._kappa_per_m * time_s)

    def amplitude_rad(self, w: F64) -> F64:
        amplitude = np.interp(np.sqrt(np.maximum(w, 0)), self._speeds, self._amplitudes)
        return np.asarray(np.clip(amplitude, 0, self._amplitude_max))

    def thrust(self, amplitude_rad: F64) -> F64:
        speed: F64 = np.interp(amplitude_rad, self._amplitudes, self._speeds)
        return speed**2

    def beats(self, w: F64) -> F64:
        return plant_beats(self._config, self.amplitude_rad(w), self._beat_s)

    def slopes(self, w: F64, beats_m_s: F64) -> F64:
        slopes = np.empty((len(w), len(w)))
        size = _DIFFERENCE * self.w_max
        for j in range(len(w)):
            step = size if w[j] + size <= self.w_max else -size
            moved = w.copy()
            moved[j] += step
            slopes[:, j] = (self.beats(moved) - beats_m_s) / step
        return slopes


Plant = ModelPlant | SimulatedPlant


def plant_beats(config: Any, amplitude_rad: F64, beat_s: float) -> F64:
    """Noise-free mean speed per beat, m/s, from rest, by the simulator's plant."""
    amplitude = np.ascontiguousarray(amplitude_rad, dtype=np.float64)
    mean = np.empty_like(amplitude)
    fine = lib.sim_plant_beats(
        config,
        ffi.cast("double *", ffi.from_buffer(amplitude)),
        len(amplitude),
        beat_s,
        ffi.cast("double *", ffi.from_buffer(mean, require_writable=True)),
    )
    if not fine:
        raise InputError(
            "the plant's settings make no sense.", "Look at the values given by --set."
        )
    return mean


def plant_config(plant: str, overrides: dict[str, float]) -> Any:
    """``sim_config_t *`` of a plant; ``overrides``: fields of it, ``seed`` may be among them."""
    others = {name: value for name, value in overrides.items() if name != "seed"}
    return make_config(plant, overrides.get("seed", DEFAULT_SEED), others)


_STEPS_MAX = 60
_HALVINGS_MAX = 20
_TOLERANCE_M_S = 1e-6
_MM = 1e3  # speeds in mm/s and w/w_max are of order 1, where solvers' tolerances fit
_RIDGE = 1e-9  # of the mean curvature: a beat whose thrust comes too late stays where it is
_TANGENT_MIN = 1e-4  # of w_max: the slew limit's tangent is upright at 0


@dataclass(frozen=True)
class Task:
    """``slew_rad``: largest change of the amplitude between neighbouring beats; None = any."""

    plant: Plant
    wanted_m_s: F64
    slew_rad: float | None = None

    def error(self, w: F64) -> F64:
        """Reference minus speed per beat, m/s."""
        return self.wanted_m_s - self.plant.beats(w)

    def start(self) -> F64:
        """The static inverse."""
        return self.admissible(self.wanted_m_s**2)

    def admissible(self, w: F64) -> F64:
        """The nearest input below ``w`` that keeps to the limits; ``w`` itself if it does."""
        w = np.clip(w, 0.0, self.plant.w_max)
        if self.slew_rad is None:
            return w
        amplitude = self.plant.amplitude_rad(w)
        for order in (range(1, len(w)), range(len(w) - 2, -1, -1)):
            for k in order:
                neighbour = k - 1 if order.step > 0 else k + 1
                amplitude[k] = min(amplitude[k], amplitude[neighbour] + self.slew_rad)
        return np.minimum(w, self.plant.thrust(amplitude))

    def slew(self, w: F64) -> tuple[F64, F64]:
        """(room, slopes) of the slew limits in x = w/w_max: room >= 0 is admissible."""
        beats, w_max = len(w), self.plant.w_max
        assert self.slew_rad is not None
        at = np.maximum(w, _TANGENT_MIN * w_max)
        size = 1e-3 * at
        highest, beyond = self._neighbours_most(at), self._neighbours_most(at + size)
        tangent = (beyond - highest) / size
        first, second = np.arange(beats - 1), np.arange(1, beats)
        of, limits = np.r_[first, second], np.r_[second, first]
        room = (highest + tangent * (w - at))[of] - w[limits]
        slopes = np.zeros((2 * (beats - 1), beats))
        rows = np.arange(len(of))
        slopes[rows, of] = tangent[of]
        slopes[rows, limits] = -1.0
        return room / w_max, slopes

    def _neighbours_most(self, w: F64) -> F64:
        amplitude = self.plant.amplitude_rad(w)
        assert self.slew_rad is not None
        return self.plant.thrust(amplitude + self.slew_rad)


def least_squares(task: Task) -> F64:
    """w of the smallest sum of squared errors: Gauss-Newton steps inside the limits."""
    w = task.start()
    error = task.error(w)
    for _ in range(_STEPS_MAX):
        jacobian = task.plant.slopes(w, task.wanted_m_s - error) * (task.plant.w_max * _MM)
        step = task.plant.w_max * _squares_step(task, w, jacobian, error * _MM)
        share, better = 1.0, None
        for _ in range(_HALVINGS_MAX):
            moved = task.admissible(w + share * step)
            found = task.error(moved)
            if found @ found < error @ error:
                better = (moved, found)
                break
            share /= 2
        if better is None:
            return w
        gain = error @ error - better[1] @ better[1]
        w, error = better
        if gain < _TOLERANCE_M_S**2:
            break
    return w


def _squares_step(task: Task, w: F64, jacobian: F64, error: F64) -> F64:
    """d(w/w_max) of the linearised problem."""

    hessian = jacobian.T @ jacobian
    hessian[np.diag_indices(len(w))] += _RIDGE * (np.trace(hessian) / len(w) + 1.0)
    gradient = -jacobian.T @ error
    low = -w / task.plant.w_max
    high = 1 + low
    if task.slew_rad is None:
        return box_step(hessian, gradient, low, high)
    room, slopes = task.slew(w)
    eye = np.eye(len(w))
    return _bounded_quadratic(
        hessian, gradient, np.vstack([-slopes, eye, -eye]), np.r_[np.maximum(room, 0), high, -low]
    )


def _bounded_quadratic(hessian: F64, gradient: F64, rows: F64, limit: F64) -> F64:
    """min 0.5*d'Hd + g'd with rows @ d <= limit, limit >= 0, H positive definite.

    As a least distance problem by non-negative least squares (Lawson and Hanson, Solving Least
    Squares Problems, ch. 23).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    root = np.linalg.cholesky(hessian)
    free = -solve_triangular(root, gradient, lower=True)
    across = -solve_triangular(root, rows.T, lower=True)
    below = -limit - across.T @ free
    scale = np.linalg.norm(np.vstack([across, below]), axis=0)
    matrix = np.vstack([across, below]) / scale
    push, _ = nnls(matrix, np.r_[np.zeros(len(free)), 1.0])
    rest = matrix @ push
    rest[-1] -= 1
    return np.asarray(solve_triangular(root.T, free - rest[:-1] / rest[-1], lower=False))


def minimax(task: Task, start: F64, tolerance_m_s: float = _TOLERANCE_M_S) -> F64:
    """w of the smallest max|e|, by linear programs inside a trust region from ``start``, until one
    promises less than ``tolerance_m_s``."""
    w_max = task.plant.w_max
    w, error, jacobian = start, task.error(start), None
    best = float(np.abs(error).max())
    radius = 0.1
    for _ in range(_STEPS_MAX):
        if jacobian is None:
            jacobian = task.plant.slopes(w, task.wanted_m_s - error) * w_max
        step, predicted = _minimax_step(task, w, jacobian, error, radius)
        if step is None:
            radius /= 4
            continue
        moved = task.admissible(w + step * w_max)
        found = task.error(moved)
        gain, promised = best - float(np.abs(found).max()), best - predicted
        if gain > max(0.05 * promised, 0):
            w, error, best, jacobian = moved, found, best - gain, None
            radius = min(radius * 2, 1.0) if gain > 0.7 * promised else radius
        else:
            radius /= 4
        if promised < tolerance_m_s or radius < 1e-7:
            break
    return w


def _minimax_step(
    task: Task, w: F64, jacobian: F64, error: F64, radius: float
) -> tuple[F64 | None, float]:
    """Minimise t with |error - J d| <= t inside the limits and |d| <= radius: (d, t)."""
    from scipy.optimize import linprog

    beats, x = len(w), w / task.plant.w_max
    column = -np.ones((len(error), 1))
    rows = [_MM * np.block([[-jacobian, column], [jacobian, column]])]
    right = [_MM * np.r_[-error, error]]
    if task.slew_rad is not None:
        room, slopes = task.slew(w)
        rows.append(np.c_[-slopes, np.zeros(len(room))])
        right.append(np.maximum(room, 0.0))
    found = linprog(
        np.r_[np.zeros(beats), 1.0],
        A_ub=np.vstack(rows),
        b_ub=np.concatenate(right),
        bounds=[
            *zip(np.maximum(-radius, -x), np.minimum(radius, 1 - x), strict=True),
            (0, None),
        ],
        method="highs",
    )
    if found.status != 0:
        return None, 0.0
    solution = np.asarray(found.x)
    return solution[:beats], float(solution[beats])
