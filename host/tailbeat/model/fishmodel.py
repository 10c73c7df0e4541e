"""A fish in four numbers: dv/dt = kappa*(vss(u(t - delay))**2 - v*|v|), vss = slope*(u - dead)+.

Solved exactly by host/native/drag_model.c. Speeds of a swim are over ground: over water plus the
flow. The thrust's ripple within a beat and the servo are left out; what beat means feel of them
goes into the four numbers when they are fitted: on the simulated tank a 40 ms servo makes the
slope 3 % smaller, the dead zone 3 % larger and the delay 16 ms longer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.errors import InputError

Array = NDArray[np.float64]

PARAMS = ("kappa_per_m", "slope_m_s_rad", "dead_zone_rad", "delay_s")


@dataclass(frozen=True)
class FishModel:
    """``kappa_per_m`` alpha/M, > 0. ``slope_m_s_rad`` steady speed over amplitude beyond
    ``dead_zone_rad``, > 0. ``delay_s`` from a beat's begin to its thrust, >= 0."""

    kappa_per_m: float
    slope_m_s_rad: float
    dead_zone_rad: float
    delay_s: float

    def steady_m_s(self, amplitude_rad: ArrayLike) -> Array:
        """vss: the speed an amplitude settles at."""
        beyond = np.asarray(amplitude_rad, dtype=np.float64) - self.dead_zone_rad
        return self.slope_m_s_rad * np.maximum(beyond, 0.0)

    def amplitude_rad(self, steady_m_s: ArrayLike) -> Array:
        """The smallest amplitude that settles at a speed; the dead zone's edge for 0."""
        speed = np.maximum(np.asarray(steady_m_s, dtype=np.float64), 0.0)
        return self.dead_zone_rad + speed / self.slope_m_s_rad

    def beats(
        self,
        amplitude_rad: ArrayLike,
        beat_s: float,
        conditions: Conditions | None = None,
    ) -> Array:
        """Mean speed over ground per beat, m/s, shape (beats,)."""
        given = conditions or Conditions()
        w = (given.gain * self.steady_m_s(amplitude_rad)) ** 2
        distance, _, _ = self.distance(w, beat_s, given.start_m_s)
        mean: Array = np.diff(distance) / beat_s + given.flow_m_s
        return mean

    def distance(
        self, w: Array, beat_s: float, start_m_s: float = 0.0, parts: int = 1, slopes: bool = False
    ) -> tuple[Array, Array | None, Array | None]:
        """(distance over water, its derivatives to w, those to (kappa, delay, start)) at the
        ``beats * parts + 1`` ends of the parts of beats; None without ``slopes``. ``w``: thrust per
        beat as the square of the steady speed, >= 0."""
        from tailbeat._native import ffi, lib

        w = np.ascontiguousarray(w, dtype=np.float64)
        rows = len(w) * parts + 1
        distance = np.empty(rows)
        by_w = np.empty((rows, len(w))) if slopes else None
        by_model = np.empty((rows, 3)) if slopes else None

        def pointer(array: Array | None) -> object:
            return ffi.NULL if array is None else ffi.from_buffer("double[]", array)

        model = ffi.new("drag_model_t *", (self.kappa_per_m, self.delay_s, start_m_s, beat_s))
        if not lib.drag_model_distance(
            model, pointer(w), len(w), parts, pointer(distance), pointer(by_w), pointer(by_model)
        ):
            raise InputError(
                f"the model makes no sense: {self}.",
                "Look at its numbers; identify the fish again.",
            )
        return distance, by_w, by_model


@dataclass(frozen=True)
class Conditions:
    """What differs from swim to swim: the speed over water at its begin (>= 0), the flow along the
    tank, and a factor on the steady speed (battery, temperature)."""

    start_m_s: float = 0.0
    flow_m_s: float = 0.0
    gain: float = 1.0
