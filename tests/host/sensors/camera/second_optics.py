"""A camera over waves, for tests: rays, not the projection that the host tool inverts.

The lens is a fisheye (equisolid angle, r = 2 f sin(angle / 2)), not OpenCV's polynomial. A ray
meets the moving surface, is refracted there by Snell's law in vector form, and goes on to the
marker's plane. Nothing here comes from tailbeat: NumPy only.

Frame: x along the swim, y to the right of it, z down from the still surface; metres and seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AIR_OVER_WATER = 1.0 / 1.33
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Waves:
    """Deep-water waves: a sum of sines with the dispersion relation omega^2 = g k.

    ``height_m``: standard deviation of the surface times sqrt(2), the amplitude of one sine of the
    same power. Wavelengths lie between ``shortest_m`` and ``longest_m``.
    """

    height_m: float = 0.0
    seed: int = 0
    count: int = 7
    shortest_m: float = 0.18
    longest_m: float = 0.9
    _parts: tuple[Floats, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        random = np.random.default_rng((self.seed, 77))
        length_m = np.exp(
            random.uniform(np.log(self.shortest_m), np.log(self.longest_m), self.count)
        )
        towards = random.uniform(-np.pi, np.pi, self.count)
        number = 2 * np.pi / length_m
        share = random.uniform(0.5, 1.0, self.count)
        size_m = self.height_m * share / np.sqrt(np.sum(share**2))
        phase = random.uniform(0, 2 * np.pi, self.count)
        rate = np.sqrt(GRAVITY_M_S2 * number)
        parts = number * np.cos(towards), number * np.sin(towards), rate, size_m, phase
        object.__setattr__(self, "_parts", parts)

    def slopes(self, x_m: Floats, y_m: Floats, t_s: Floats | float) -> tuple[Floats, Floats]:
        """The surface's slope (upward along x and y) at places and times of one shape."""
        down, right = np.zeros(np.shape(x_m)), np.zeros(np.shape(x_m))
        if self.height_m > 0:
            for kx, ky, rate, size_m, phase in zip(*self._parts, strict=True):
                steep = -size_m * np.sin(kx * x_m + ky * y_m - rate * t_s + phase)
                down += kx * steep
                right += ky * steep
        return down, right


@dataclass(frozen=True)
class Optics:
    """A fisheye above the water. ``focal_px``: of the equisolid projection; the lens's axis leans
    by ``lean_rad`` about the picture's v and u axis; the camera is ``height_m`` above (``x_m``,
    ``y_m``)."""

    size_px: tuple[int, int] = (960, 540)
    focal_px: float = 760.0
    height_m: float = 2.0
    x_m: float = 1.0
    y_m: float = 0.0
    lean_rad: tuple[float, float] = (0.02, -0.03)
    middle_off_px: tuple[float, float] = (4.0, -3.0)

    def turn(self) -> Floats:
        """(3, 3), from the camera's frame (u right, v down, z along the axis) to the tank's."""
        a, b = self.lean_rad
        about_v = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        about_u = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        return np.asarray(about_v @ about_u, np.float64)

    def rays(self, u_px: Floats, v_px: Floats) -> Floats:
        """Unit vectors (3, ...) in the tank's frame through pixels."""
        du, dv = u_px - self.middle_px[0], v_px - self.middle_px[1]
        far = np.hypot(du, dv)
        angle = 2 * np.arcsin(np.clip(far / (2 * self.focal_px), 0, 0.999))
        aside = np.sin(angle) / np.maximum(far, 1e-12)
        inner = np.stack([du * aside, dv * aside, np.cos(angle)])
        return np.asarray(np.einsum("ij,j...->i...", self.turn(), inner), np.float64)

    @property
    def middle_px(self) -> tuple[float, float]:
        """Where the axis meets the picture."""
        return (
            (self.size_px[0] - 1) / 2 + self.middle_off_px[0],
            (self.size_px[1] - 1) / 2 + self.middle_off_px[1],
        )

    def seen_at(
        self, u_px: Floats, v_px: Floats, depth_m: float, waves: Waves, t_s: Floats | float
    ) -> tuple[Floats, Floats]:
        """What a pixel sees at ``depth_m`` under the still surface (negative: above it, in air)."""
        ray = self.rays(u_px, v_px)
        to_surface = (self.height_m + min(depth_m, 0.0)) / ray[2]
        x_m, y_m = self.x_m + ray[0] * to_surface, self.y_m + ray[1] * to_surface
        if depth_m <= 0:
            return x_m, y_m
        down, right = waves.slopes(x_m, y_m, t_s)
        normal = np.stack([down, right, np.ones_like(down)])  # into the water, z is down
        normal /= np.sqrt((normal**2).sum(axis=0))
        cos_air = (normal * ray).sum(axis=0)
        cos_water = np.sqrt(1 - AIR_OVER_WATER**2 * (1 - cos_air**2))
        bent = AIR_OVER_WATER * ray + (cos_water - AIR_OVER_WATER * cos_air) * normal
        way = depth_m / bent[2]
        return x_m + bent[0] * way, y_m + bent[1] * way

    def pixels_of(self, places_m: Floats, depth_m: float) -> Floats:
        """Where points (n, 2) are seen under still water, (n, 2): pixels moved by what they miss,
        until they miss nothing. The scale differs by less than a third over the picture."""
        scale, still = self.focal_px / self.height_m, Waves()
        found = np.array(self.middle_px) + scale * (places_m - np.array([self.x_m, self.y_m]))
        for _ in range(30):
            seen = np.column_stack(self.seen_at(found[:, 0], found[:, 1], depth_m, still, 0.0))
            found = found + scale * (places_m - seen)
        return np.asarray(found, np.float64)
