"""From pixels to metres in the tank: one file, made by ``tailbeat camera calibrate``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ANCHOR_ID_MIN = 40  # ArUco DICT_4X4_50 ids from here on are the tank's, not the fish's
SCALE_ERROR_MAX = 0.01


@dataclass(frozen=True)
class Calibration:
    """A camera over a tank.

    The tank's frame: x along the swim direction from the start, y to the right, both in the plane
    in which the marker moves; metres. Pixels as in sighting.py.

    ``camera_matrix`` (3, 3) and ``distortion`` (5,) are OpenCV's pinhole and Brown-Conrady model;
    ``tank_from_image`` (3, 3) maps undistorted pixels (of the same camera_matrix) to the tank.
    ``area_m`` (n, 2): corners of the water the fish may be in, n >= 3, convex; None = not known.
    ``anchors``: id of a marker that is fixed at the tank -> its centre in pixels when calibrated.
    ``scale_error``: by the ruler, relative; None = never checked. ``rms_px``: of the intrinsics,
    None = a camera taken to be without distortion. ``plane_rms_m``: of the tank's points.
    ``plane``: in words, where the marker's plane is and how that was dealt with.
    """

    size_px: tuple[int, int]
    camera_matrix: Floats
    distortion: Floats
    tank_from_image: Floats
    area_m: Floats | None = None
    anchors: dict[int, tuple[float, float]] = field(default_factory=dict)
    scale_error: float | None = None
    rms_px: float | None = None
    plane_rms_m: float | None = None
    plane: str = ""
    camera: str = ""
    made_at: str = ""

    def to_tank(self, points_px: Floats) -> Floats:
        """Pixels (n, 2) of the distorted picture to metres (n, 2)."""
        raise NotImplementedError

    def to_pixels(self, points_m: Floats) -> Floats:
        """Metres (n, 2) to pixels (n, 2) of the distorted picture; the inverse of to_tank within
        1e-3 pixels everywhere in the picture."""
        raise NotImplementedError

    def check_size(self, size_px: tuple[int, int], name: str) -> None:
        """Raises InputError when pictures of that size are not this camera's."""
        raise NotImplementedError

    def check_anchors(self, seen: dict[int, tuple[float, float]], name: str) -> float | None:
        """How far (m, the worst) anchors seen in a picture are from where they were when this was
        made; None when fewer than two are known and seen. Raises InputError beyond 2 cm: the camera
        has been moved or is another one."""
        raise NotImplementedError

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all."""
        raise NotImplementedError


def load_calibration(path: Path) -> Calibration:
    """Reads a file of ``save``. Raises InputError when it is none or makes no sense."""
    raise NotImplementedError
