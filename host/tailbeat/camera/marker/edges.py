"""Where a marker's black square ends, far below a pixel: a straight line through each of its sides.

Every side is crossed by 24 short profiles. The middle of a profile's rise from black to white is a
point of the side; a line that does not mind a few bad points goes through all of a side, and lines
meet in corners. Centre of a 25 pixel marker on pictures of known truth (tests/host/test_markers.py
draws them; noise 2 of 255, blur 0.6 px), RMS over 150: this 0.02 px, OpenCV's CORNER_REFINE_CONTOUR
0.11, SUBPIX 0.23, NONE 0.34, APRILTAG 0.65 (most of that a shift of 0.45 px in u and in v).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.marker.sighting import Points
from tailbeat.camera.pictures.picture import Image

Floats = NDArray[np.float64]

_PROFILES = 24
_ALONG = np.linspace(-0.44, 0.44, _PROFILES)  # of a side's length; its ends belong to two sides
_STEP_PX = 0.25
_REACH_CELLS = 0.75  # stays inside the black border, one cell wide
_REACH_PX = (1.75, 4.0)  # a detector's corners are off by up to 1 px
_ROUNDS = 2
_NOISE_FLOOR = 0.25  # of a profile's steepest rise; less is noise
_RESIDUAL_FLOOR_PX = 0.02


@dataclass(frozen=True, slots=True)
class Square:
    """``corners`` as given, but exact. ``residual_px``: RMS distance of the sides' points from
    their lines. ``contrast``: median rise from black to white across the sides, grey levels."""

    corners: Points
    residual_px: float
    contrast: float


@dataclass(frozen=True, slots=True)
class Sides:
    """Points found along the sides of a guessed square; arrays (4, profiles)."""

    starts: Points  # (4, 2)
    along: Points  # (4, 2), a side as a vector
    outward: Points  # (4, 2), unit vectors
    offset_px: Floats  # of the edge from the guessed side, outward
    weight: Floats  # how clear the edge is; 0 = there is none
    rise: Floats  # grey levels


def fit_square(grey: Image, corners: Points, cells: int) -> Square | None:
    """The square whose corners, clockwise, are near ``corners`` (4, 2); ``cells`` of the marker
    along a side, border included. None when there is no square in ``grey`` there."""
    for _ in range(_ROUNDS):
        sides = find_sides(grey, corners, cells)
        moved, residual_px = _through(sides)
        if not np.all(np.isfinite(moved)) or np.max(np.abs(moved - corners)) > _REACH_PX[1]:
            return None
        corners = moved
    return Square(corners, residual_px, float(np.median(sides.rise)))


def find_sides(grey: Image, corners: Points, cells: int) -> Sides:
    """Profiles across the sides of the square with these ``corners``."""
    along = np.roll(corners, -1, axis=0) - corners
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    outward = np.column_stack([along[:, 1], -along[:, 0]]) / length
    reach = float(np.clip(_REACH_CELLS * length.mean() / cells, *_REACH_PX))
    steps = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
    base = corners[:, None] + (0.5 + _ALONG)[None, :, None] * along[:, None]
    points = base[:, :, None] + steps[None, None, :, None] * outward[:, None, None]
    rise = np.diff(_sample(grey, points), axis=2)
    steepest = rise.max(axis=2, keepdims=True)
    clear = np.where(rise > _NOISE_FLOOR * steepest, rise, 0.0) ** 2
    weight = clear.sum(axis=2)
    middle = (steps[1:] + steps[:-1]) / 2
    offset = (clear * middle).sum(axis=2) / np.maximum(weight, 1e-9)
    # One glaring profile must not outweigh its side.
    weight = np.minimum(weight, _middle(weight))
    return Sides(corners, along, outward, offset, weight, np.clip(rise, 0, None).sum(axis=2))


def _sample(grey: Image, points: Floats) -> Floats:
    low = np.floor(points.min(axis=(0, 1, 2))).astype(int) - 1
    high = np.ceil(points.max(axis=(0, 1, 2))).astype(int) + 2
    low, high = np.maximum(low, 0), np.minimum(high, grey.shape[::-1])
    if np.any(high <= low):
        return np.zeros(points.shape[:3])
    # Of bytes, remap gives whole grey levels only.
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    at = (points - low).astype(np.float32).reshape(4 * _PROFILES, -1, 2)
    values = cv2.remap(part, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return np.asarray(values, np.float64).reshape(points.shape[:3])


def _through(sides: Sides) -> tuple[Points, float]:
    """The corners where robust lines through each side's points meet, and the points' residual."""
    weight = sides.weight
    for _ in range(3):
        total = np.maximum(weight.sum(axis=1), 1e-9)
        x_mean = (weight * _ALONG).sum(axis=1) / total
        y_mean = (weight * sides.offset_px).sum(axis=1) / total
        x = _ALONG - x_mean[:, None]
        y = sides.offset_px - y_mean[:, None]
        slope = (weight * x * y).sum(axis=1) / np.maximum((weight * x * x).sum(axis=1), 1e-9)
        residual = y - slope[:, None] * x
        spread = 1.48 * _middle(np.abs(residual))
        tolerance = 2 * np.maximum(spread, _RESIDUAL_FLOOR_PX)
        weight = sides.weight / (1 + (residual / tolerance) ** 2)
    ends = y_mean[:, None] + slope[:, None] * (np.array([-0.5, 0.5]) - x_mean[:, None])
    first = sides.starts + sides.outward * ends[:, :1]
    along = sides.along + sides.outward * (ends[:, 1:] - ends[:, :1])
    rms = float(np.sqrt((weight * residual**2).sum() / max(weight.sum(), 1e-9)))
    return _meet(first, along), rms


def _middle(values: Floats) -> Floats:
    """The median of each row, as a column; np.median takes 22 times as long for so few."""
    return np.asarray(np.sort(values, axis=1)[:, values.shape[1] // 2, None])


def _meet(points: Points, along: Points) -> Points:
    """Where each line meets the one before it."""
    before, direction = np.roll(points, 1, axis=0), np.roll(along, 1, axis=0)
    across = direction[:, 0] * along[:, 1] - direction[:, 1] * along[:, 0]
    gap = points - before
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / across
    return np.asarray(before + part[:, None] * direction)
