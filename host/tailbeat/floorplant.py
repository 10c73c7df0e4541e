"""Plants as the floor sees them: noise-free beat means of a fish at rest, and their slopes.

The mean speed over a beat is nearly linear in ``w = vss(u)**2``, the square of the steady speed,
which is proportional to thrust and free of the dead zone; so w, and not the amplitude, is what the
floor is searched in.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.model.fishmodel import FishModel

Array = NDArray[np.float64]

_DIFFERENCE = 1e-4  # of the largest w
_TABLE_POINTS = 200
_RUN_BEATS = 6
_SPEED_MIN_M_S = 1e-6  # below it a fish has no thrust; keeps w/w_max a number
_BISECTIONS = 20


class Plant(Protocol):
    """``w_max``: largest w, (m/s)**2. ``delay_s``: from a beat's begin to its thrust."""

    @property
    def w_max(self) -> float: ...

    @property
    def delay_s(self) -> float: ...

    def amplitude_rad(self, w: Array) -> Array:
        """The smallest amplitude that gives w; for 0 the edge of the dead zone, from where thrust
        is soonest reached."""
        ...

    def thrust(self, amplitude_rad: Array) -> Array:
        """w of amplitudes, at most ``w_max``."""
        ...

    def beats(self, w: Array) -> Array:
        """Mean speed of every beat, m/s."""
        ...

    def slopes(self, w: Array, beats_m_s: Array) -> Array:
        """d beats[k] / d w[j], shape (beats, beats); ``beats_m_s`` = ``beats(w)``."""
        ...


class ModelPlant:
    """An identified fish; slopes are exact."""

    def __init__(self, model: FishModel, beat_s: float, amplitude_max_rad: float) -> None:
        self.w_max = max(float(model.steady_m_s(amplitude_max_rad)), _SPEED_MIN_M_S) ** 2
        self.delay_s = model.delay_s
        self._model, self._beat_s = model, beat_s
        self._amplitude_max = amplitude_max_rad

    def amplitude_rad(self, w: Array) -> Array:
        amplitude = self._model.amplitude_rad(np.sqrt(np.maximum(w, 0)))
        return np.asarray(np.clip(amplitude, 0, self._amplitude_max))

    def thrust(self, amplitude_rad: Array) -> Array:
        return np.minimum(self._model.steady_m_s(amplitude_rad) ** 2, self.w_max)

    def beats(self, w: Array) -> Array:
        distance, _, _ = self._model.distance(w, self._beat_s)
        mean: Array = np.diff(distance) / self._beat_s
        return mean

    def slopes(self, w: Array, beats_m_s: Array) -> Array:
        _, by_w, _ = self._model.distance(w, self._beat_s, slopes=True)
        assert by_w is not None
        slopes: Array = np.diff(by_w, axis=0) / self._beat_s
        return slopes


class SimulatedPlant:
    """The simulator's plant, ``sim_config_t *``; slopes are finite differences of it."""

    def __init__(self, config: Any, beat_s: float, amplitude_max_rad: float) -> None:
        from tailbeat._native import lib

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

    def amplitude_rad(self, w: Array) -> Array:
        amplitude = np.interp(np.sqrt(np.maximum(w, 0)), self._speeds, self._amplitudes)
        return np.asarray(np.clip(amplitude, 0, self._amplitude_max))

    def thrust(self, amplitude_rad: Array) -> Array:
        speed: Array = np.interp(amplitude_rad, self._amplitudes, self._speeds)
        return speed**2

    def beats(self, w: Array) -> Array:
        return plant_beats(self._config, self.amplitude_rad(w), self._beat_s)

    def slopes(self, w: Array, beats_m_s: Array) -> Array:
        slopes = np.empty((len(w), len(w)))
        size = _DIFFERENCE * self.w_max
        for j in range(len(w)):
            step = size if w[j] + size <= self.w_max else -size
            moved = w.copy()
            moved[j] += step
            slopes[:, j] = (self.beats(moved) - beats_m_s) / step
        return slopes


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
