"""The simulated tank and its camera: what there is to see, and where in the picture it is."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import ANCHOR_ID_MIN, Calibration
from tailbeat.sensors.camera.marker.detector import MarkerKind


def chance(*names: int | str) -> float:
    """Uniform in [0, 1), the same for the same names on every computer."""
    text = "/".join(map(str, names)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=6).digest(), "big") / 2.0**48


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
        optics, anchors = Optics(self), self.anchors_m()
        places = optics.pixels(np.array(list(anchors.values())))
        at = {key: (float(u), float(v)) for key, (u, v) in zip(anchors, places, strict=True)}
        return Calibration(
            size_px=self.size_px,
            camera_matrix=optics.camera_matrix,
            distortion=optics.distortion,
            tank_from_image=optics.tank_from_image,
            area_m=np.array(self.walls_m(), dtype=np.float64),
            anchors=at,
            scale_error=0.0,
            rms_px=0.0,
            plane_rms_m=0.0,
            plane=_PLANE,
            camera="rendered",
        )


_PLANE = "simulated: the tank's frame is the plane of the marker, nothing to correct"
_EDGE_POINTS = 25
_LINE = np.linspace(-0.5, 0.5, 5)
_PATCH = np.stack(np.meshgrid(_LINE, _LINE), axis=-1).reshape(-1, 2)  # of a square of side 1


class Optics:
    """A pinhole with Brown-Conrady distortion over the middle of the tank. z counts downward from
    the marker's plane."""

    def __init__(self, scene: Scene) -> None:
        self.distortion = np.array(scene.distortion, dtype=np.float64)
        self._turn, self._shift = _pose(scene)
        self.camera_matrix = np.eye(3)
        width, height = scene.size_px
        half = np.array([(width - 1) / 2, (height - 1) / 2])
        seen = self.pixels(along_edges(scene.walls_m(RIM_M)))
        focal_px = float((half / np.abs(seen).max(axis=0)).min())
        self.camera_matrix = np.array([[focal_px, 0, half[0]], [0, focal_px, half[1]], [0, 0, 1.0]])
        self.px_per_m = focal_px / scene.height_m

    def pixels(self, points_m: F64, depth_m: float = 0.0) -> F64:
        """Points (n, 2) of the tank, so deep below the marker's plane, to pixels (n, 2)."""
        deep = np.column_stack([points_m, np.full(len(points_m), depth_m)])
        found, _ = cv2.projectPoints(
            deep, self._turn, self._shift, self.camera_matrix, self.distortion
        )
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    @property
    def tank_from_image(self) -> F64:
        """Undistorted pixels to the marker's plane, (3, 3)."""
        turn, _ = cv2.Rodrigues(self._turn)
        image_from_tank = self.camera_matrix @ np.column_stack([turn[:, :2], self._shift])
        inverse = np.linalg.inv(image_from_tank)
        return np.asarray(inverse / inverse[2, 2])

    def near(self, centre_m: tuple[float, float], heading_rad: float, side_m: float) -> F64:
        """The homography (3, 3) from metres around ``centre_m`` (x along the heading) to pixels.

        Distortion is no homography; within a square of ``side_m`` this one is within 0.02 pixels.
        """
        patch = side_m * _PATCH
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        tank = patch @ np.array([[c, s], [-s, c]]) + np.array(centre_m)
        found, _ = cv2.findHomography(patch, self.pixels(tank), 0)
        return np.asarray(found, dtype=np.float64)


def along_edges(corners: list[tuple[float, float]]) -> F64:
    """Points all along the edges of a polygon: what distortion bends."""
    ends = np.array([*corners, corners[0]], dtype=np.float64)
    parts = [np.linspace(a, b, _EDGE_POINTS, endpoint=False) for a, b in pairwise(ends)]
    return np.concatenate(parts)


def _pose(scene: Scene) -> tuple[F64, F64]:
    """The tank as the camera sees it: rotation vector and translation."""
    tilt, _ = cv2.Rodrigues(np.array([scene.tilt_rad, 0.0, 0.0]))
    pan, _ = cv2.Rodrigues(np.array([0.0, scene.pan_rad, 0.0]))
    turn = tilt @ pan
    axis = turn[2]
    middle = np.append(np.mean(scene.walls_m(), axis=0), 0.0)
    place = middle - axis * (scene.height_m / axis[2])
    vector, _ = cv2.Rodrigues(turn)
    return np.asarray(vector, dtype=np.float64).ravel(), np.asarray(-turn @ place)
