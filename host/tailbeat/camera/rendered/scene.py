"""The simulated tank and its camera: what there is to see, and how well."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.camera.marker.markers import MarkerKind
from tailbeat.camera.tank.calibration import ANCHOR_ID_MIN, Calibration

START_M = 0.5  # from the wall behind the fish to its marker
RIM_M = 0.10  # width of the rim around the water, on which the anchors are
ANCHOR_SIDE_M = 0.06
ANCHOR_OUT_M = 0.05  # from the wall to the middle of an anchor, both ways


@dataclass(frozen=True)
class Scene:
    """All in SI units, pixels where it says so. Defaults: the thesis's tank (3 x 1.8 m) and a
    camera of 1280x720 that sees all of it, a little askew, with some lens distortion.

    The tank's frame as in tank/calibration.py: the fish starts at x = 0 with its marker, 0.5 m from
    the wall behind it, in the middle of the tank's width. The camera looks at the middle of the
    tank; ``tilt_rad`` and ``pan_rad`` lean it about the picture's u and v axis. The picture is just
    wide enough for the tank with its rim.
    """

    size_px: tuple[int, int] = (1280, 720)
    height_m: float = 2.6  # of the camera over the marker's plane
    tilt_rad: float = 0.03
    pan_rad: float = 0.02
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.0005, -0.0005, 0.0)
    tank_m: tuple[float, float] = (3.0, 1.8)
    marker: MarkerKind = "aruco"  # "blob": a plain bright hull
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

    def walls_m(self, out_m: float = 0.0) -> list[tuple[float, float]]:
        """Corners of the water, ``out_m`` beyond its edges: rear left, front left, front right,
        rear right, as seen by the fish."""
        length_m, width_m = self.tank_m
        rear_m, front_m = -START_M - out_m, length_m - START_M + out_m
        half_m = width_m / 2 + out_m
        return [(rear_m, -half_m), (front_m, -half_m), (front_m, half_m), (rear_m, half_m)]

    def anchors_m(self) -> dict[int, tuple[float, float]]:
        """Where the middles of the four markers on the rim are, by id."""
        return dict(enumerate(self.walls_m(ANCHOR_OUT_M), ANCHOR_ID_MIN))

    def calibration(self) -> Calibration:
        """The true one, with area, anchors (four markers at the corners) and scale error 0."""
        from tailbeat.camera.rendered.optics import true_calibration

        return true_calibration(self)
