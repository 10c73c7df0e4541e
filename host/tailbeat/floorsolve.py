"""The two best inputs on a plant: least squares, and minimax by a sequence of linear programs.

Both search w (``floorplant``) in 0 <= w <= w_max. A slew limit between neighbouring beats bounds w
from above by a concave function of the neighbour's, so what it allows is a convex set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.floorplant import Plant

Array = NDArray[np.float64]

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
    wanted_m_s: Array
    slew_rad: float | None = None

    def error(self, w: Array) -> Array:
        """Reference minus speed per beat, m/s."""
        return self.wanted_m_s - self.plant.beats(w)

    def start(self) -> Array:
        """The static inverse."""
        return self.admissible(self.wanted_m_s**2)

    def admissible(self, w: Array) -> Array:
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

    def slew(self, w: Array) -> tuple[Array, Array]:
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

    def _neighbours_most(self, w: Array) -> Array:
        amplitude = self.plant.amplitude_rad(w)
        assert self.slew_rad is not None
        return self.plant.thrust(amplitude + self.slew_rad)


def least_squares(task: Task) -> Array:
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


def _squares_step(task: Task, w: Array, jacobian: Array, error: Array) -> Array:
    """d(w/w_max) of the linearised problem."""
    from tailbeat.model.planner import box_step

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


def _bounded_quadratic(hessian: Array, gradient: Array, rows: Array, limit: Array) -> Array:
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


def minimax(task: Task, start: Array) -> Array:
    """w of the smallest max|e|, by linear programs inside a trust region from ``start``."""
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
        if promised < _TOLERANCE_M_S or radius < 1e-7:
            break
    return w


def _minimax_step(
    task: Task, w: Array, jacobian: Array, error: Array, radius: float
) -> tuple[Array | None, float]:
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
