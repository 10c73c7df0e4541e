"""The floor of a reference on a plant: the smallest max|e| any input can reach, noise-free.

The mean speed over a beat is nearly linear in ``w = vss(u)**2``, the square of the steady speed,
which is proportional to thrust and free of the dead zone. In w the minimax is found by a sequence
of linear programs inside a trust region, each around a finite-difference Jacobian of the C plant
(``sim_plant_beats``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.reference import Reference

Array = NDArray[np.float64]
Plant = Callable[[Array], Array]

_STEPS_MAX = 60
_TOLERANCE_M_S = 1e-6
_LP_SCALE = 100.0  # speeds of mm/s come near 1, where the solver's tolerances fit
_THETA_SAMPLES = 64


@dataclass(frozen=True)
class Floor:
    """What no learning law can beat on this plant with this reference."""

    minimax_m_s: float  # smallest max|e| over beats
    lsq_max_abs_m_s: float  # max|e| of the least-squares optimum
    minimax_input: NDArray[np.float32]  # amplitudes that reach it, rad, shape (beats,)
    where_s: float  # middle of the beat with the largest remaining error


def floor(config: Any, reference: Reference, amplitude_max_rad: float) -> Floor:
    """Computes the floor for a plant given as ``sim_config_t *``; takes about a second."""
    w_max, to_amplitude = _thrust_map(config, amplitude_max_rad)
    wanted = reference.speed_m_s.astype(np.float64)

    def plant(w: Array) -> Array:
        return plant_beats(config, to_amplitude(w), reference.beat_s)

    start = np.clip(wanted**2, 0, w_max)
    best, value = _minimax(plant, wanted, start, w_max)
    squares = _least_squares(plant, wanted, start, w_max)
    error = np.abs(wanted - plant(best))
    return Floor(
        minimax_m_s=float(value),
        lsq_max_abs_m_s=float(np.abs(wanted - plant(squares)).max()),
        minimax_input=to_amplitude(best).astype(np.float32),
        where_s=(float(np.flatnonzero(error >= 0.999 * value)[-1]) + 0.5) * reference.beat_s,
    )


def plant_beats(config: Any, amplitude_rad: Array, beat_s: float) -> Array:
    """Noise-free mean speed per beat, m/s, from rest, by the simulator's plant."""
    from tailbeat._native import ffi, lib

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


def _thrust_map(config: Any, amplitude_max: float) -> tuple[float, Plant]:
    """(largest w, w -> amplitude) for the plant."""
    from tailbeat._native import lib

    if config.plant == lib.SIM_PLANT_TANK:
        dead, slope = config.dead_zone_rad, config.slope_m_s_rad
        w_max = (slope * max(amplitude_max - dead, 1e-6)) ** 2

        def tank(w: Array) -> Array:
            amplitude = dead + np.sqrt(np.maximum(w, 0)) / slope
            return np.asarray(np.clip(amplitude, 0, amplitude_max))

        return w_max, tank
    grid = np.linspace(0, amplitude_max, 4001)
    speed = _thesis_steady_speed(config, grid)

    def thesis(w: Array) -> Array:
        return np.interp(np.sqrt(np.maximum(w, 0)), speed, grid)

    return float(speed[-1] ** 2), thesis


def _thesis_steady_speed(config: Any, amplitude: Array) -> Array:
    """sqrt(H1/(alpha+H2)) of (8.5)-(8.13) at 1 Hz; only a change of variable, so 1 Hz will do."""
    phase = 2 * np.pi * (np.arange(_THETA_SAMPLES) + 0.5) / _THETA_SAMPLES
    angle = amplitude[:, None] * np.sin(phase)
    heave = 2 / 3 * np.pi * amplitude[:, None] * config.body_length_m * np.cos(phase)
    half = config.water_density_kg_m3 * config.tail_area_m2 / 2
    h1 = half * np.mean((heave / np.cos(angle) ** 2) ** 2, axis=1)
    h2 = half * np.mean(np.tan(angle) ** 2, axis=1)
    steady: Array = np.sqrt(h1 / (config.drag_kg_m + h2))
    return steady


def _jacobian(plant: Plant, w: Array, at_w: Array, w_max: float) -> Array:
    """Forward differences; columns that sit at the upper end go backwards."""
    jacobian = np.empty((len(at_w), len(w)))
    for j in range(len(w)):
        step = 1e-4 * w_max if w[j] + 1e-4 * w_max <= w_max else -1e-4 * w_max
        moved = w.copy()
        moved[j] += step
        jacobian[:, j] = (plant(moved) - at_w) / step
    return jacobian


def _minimax(plant: Plant, wanted: Array, w: Array, w_max: float) -> tuple[Array, float]:
    speed = plant(w)
    best = float(np.abs(wanted - speed).max())
    radius, jacobian = 0.1 * w_max, None
    for _ in range(_STEPS_MAX):
        if jacobian is None:
            jacobian = _jacobian(plant, w, speed, w_max)
        step, predicted = _linear_step(jacobian, wanted - speed, w, w_max, radius)
        if step is None:
            radius /= 4
            continue
        moved = np.clip(w + step, 0, w_max)
        moved_speed = plant(moved)
        gain = best - float(np.abs(wanted - moved_speed).max())
        promised = best - predicted
        if gain > max(0.05 * promised, 0):
            w, speed, best, jacobian = moved, moved_speed, best - gain, None
            radius = min(radius * 2, w_max) if gain > 0.7 * promised else radius
        else:
            radius /= 4
        if promised < _TOLERANCE_M_S or radius < 1e-7 * w_max:
            break
    return w, best


def _linear_step(
    jacobian: Array, error: Array, w: Array, w_max: float, radius: float
) -> tuple[Array | None, float]:
    """Minimise t with |error - J d| <= t, 0 <= w + d <= w_max, |d| <= radius: (d, t)."""
    from scipy.optimize import linprog

    beats = len(w)
    slope = jacobian * w_max  # variables d / w_max are of order 1
    column = -np.ones((len(error), 1))
    low = np.maximum(-radius, -w) / w_max
    high = np.minimum(radius, w_max - w) / w_max
    found = linprog(
        np.r_[np.zeros(beats), 1.0],
        A_ub=_LP_SCALE * np.block([[-slope, column], [slope, column]]),
        b_ub=_LP_SCALE * np.r_[-error, error],
        bounds=[*zip(low, high, strict=True), (0, None)],
        method="highs",
    )
    if found.status != 0:
        return None, 0.0
    solution = np.asarray(found.x)
    return solution[:beats] * w_max, float(solution[beats])


def _least_squares(plant: Plant, wanted: Array, w: Array, w_max: float) -> Array:
    from scipy.optimize import least_squares

    def jacobian(z: Array) -> Array:
        return _jacobian(plant, z * w_max, plant(z * w_max), w_max) * w_max * _LP_SCALE

    def residual(z: Array) -> Array:
        return (plant(z * w_max) - wanted) * _LP_SCALE

    found = least_squares(
        residual,
        np.clip(w / w_max, 1e-6, 1 - 1e-6),
        jac=jacobian,
        bounds=(0, 1),
        x_scale=0.1,
        ftol=1e-10,
        xtol=1e-10,
        gtol=1e-10,
        max_nfev=100,
    )
    solution: Array = found.x * w_max
    return solution


def plant_config(plant: str, overrides: dict[str, float]) -> Any:
    """``sim_config_t *`` of a plant with its disturbances left as they are (the floor ignores
    them)."""
    from tailbeat._native import ffi, lib
    from tailbeat.transport.simulated import PLANTS, config_field

    config = ffi.new("sim_config_t *")
    lib.sim_config_default(config, PLANTS[plant])
    for name, value in overrides.items():
        if name != "seed":
            setattr(config, config_field(name), value)
    return config
