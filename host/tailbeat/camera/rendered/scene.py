"""The simulated tank and its camera: what there is to see, and how well."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.camera.calibration import Calibration
from tailbeat.camera.markers import MarkerKind


@dataclass(frozen=True)
class Scene:
    """All in SI units, pixels where it says so. Defaults: the thesis's tank (3 x 1.8 m) and a camera
    of 1280x720 that sees all of it, a little askew, with some lens distortion.

    The tank's frame as in calibration.py: the fish starts at x = 0 with its marker, 0.5 m from the
    wall behind it, in the middle of the tank's width.
    """

    size_px: tuple[int, int] = (1280, 720)
    height_m: float = 2.6  # of the camera over the marker's plane
    tilt_rad: float = 0.03
    pan_rad: float = 0.02
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.0005, -0.0005, 0.0)
    tank_m: tuple[float, float] = (3.0, 1.8)
    marker: MarkerKind = "aruco"
    marker_id: int = 7
    marker_side_m: float = 0.06
    exposure_s: float = 0.01  # tells how far motion blurs; the LED's share comes with the truth
    pixel_noise: float = 2.0  # standard deviation, of 255
    blur_px: float = 0.6
    ripples: float = 0.5  # 0 = a mirror; how bright the waves on the water are
    glare: float = 0.0  # 0..1: size of a bright spot that wanders over the tank
    hidden: float = 0.0  # part of the pictures in which half of the marker is covered
    led: bool = True
    fish: int = 1  # 2: another one with the same marker swims beside it
    seed: int = 1

    def calibration(self) -> Calibration:
        """The true one, with area, anchors (four markers at the corners) and scale error 0."""
        raise NotImplementedError
