"""A marker under water: where it is, from where it seems to be through the still surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64

WATER = 1.33  # refractive index
_ROUNDS = 25  # each leaves less than a fifth of the error, down to a depth of the camera's height


@dataclass(frozen=True)
class Refraction:
    """A camera ``over_water_m`` above the point ``foot_m`` (2,) of the tank, and a marker
    ``depth_m`` under the surface. From straight above, the marker seems to be depth / WATER deep:
    an apparent place is where its ray, not bent, meets that plane."""

    foot_m: F64
    over_water_m: float
    depth_m: float

    def true(self, apparent_m: F64) -> F64:
        """Apparent places (n, 2) to places of the marker (n, 2), by Snell's law."""
        aside = apparent_m - self.foot_m
        seen_m = np.linalg.norm(aside, axis=1, keepdims=True)
        surface = 1 / (1 + self.depth_m / WATER / self.over_water_m)  # share of the way, in air
        place: F64 = self.foot_m + aside * surface * (1 + self._bent(surface * seen_m))
        return place

    def apparent(self, true_m: F64) -> F64:
        """The inverse of ``true``."""
        aside = true_m - self.foot_m
        far_m = np.linalg.norm(aside, axis=1, keepdims=True)
        share = np.ones_like(far_m)
        for _ in range(_ROUNDS):
            share = 1 / (1 + self._bent(share * far_m))
        stretched = 1 + self.depth_m / WATER / self.over_water_m
        place: F64 = self.foot_m + aside * share * stretched
        return place

    def _bent(self, surface_m: F64) -> F64:
        """Way in the water over way in the air, both as seen from above, of a ray that meets the
        surface at ``surface_m`` from the foot."""
        slant = WATER**2 * (surface_m**2 + self.over_water_m**2) - surface_m**2
        return np.asarray(self.depth_m / np.sqrt(slant))
