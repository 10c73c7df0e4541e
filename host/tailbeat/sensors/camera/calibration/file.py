"""From pixels to metres in the tank: the file that ``tailbeat camera calibrate`` writes.

``Lens`` removes and adds a lens's distortion; ``Calibration`` also knows the plane of the marker.
``check_sense`` refuses what no camera over a tank can have.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core import decode
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain, write_whole
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.water import Refraction

_FAR_PX = 1e6
_ROUNDS, _CLOSE_PX = 60, 1e-7
_OUTSIDE = 1.05
_NOTHING = 1e-12


class Lens:
    """OpenCV's pinhole and Brown-Conrady model. ``camera_matrix`` (3, 3) without skew,
    ``distortion`` (5,): k1, k2, p1, p2, k3."""

    def __init__(self, camera_matrix: F64, distortion: F64) -> None:
        self.camera_matrix = np.ascontiguousarray(camera_matrix, dtype=np.float64)
        self.distortion = np.ascontiguousarray(distortion, dtype=np.float64)
        self.focal_px = self.camera_matrix[[0, 1], [0, 1]]
        self.middle_px = self.camera_matrix[:2, 2]
        self.straight = not self.distortion.any()

    def undistorted(self, points_px: F64) -> F64:
        """Pixels (n, 2) of the picture to pixels (n, 2) of the same camera without distortion."""
        points = _rows(points_px)
        if self.straight or not len(points):
            return points.reshape(-1, 2)
        matrix = self.camera_matrix
        found: F64 = cv2.undistortPoints(
            points, matrix, self.distortion, None, None, matrix, self._stop
        )
        return found.reshape(-1, 2)

    def distorted(self, points_px: F64) -> F64:
        """The way back. Points beyond where the model folds over are put outside the picture, in
        their direction, instead of somewhere in it."""
        points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        rays = np.ones((len(points), 3))
        rays[:, :2] = (points - self.middle_px) / self.focal_px
        return self.pixels(rays)

    def pixels(self, rays: F64) -> F64:
        """Where directions x, y, 1 in the camera's frame, (n, 3), are in the picture: (n, 2); as
        in ``distorted``."""
        if self.straight or not len(rays):
            return rays[:, :2] * self.focal_px + self.middle_px
        found: F64 = cv2.projectPoints(rays, _ZERO, _ZERO, self.camera_matrix, self.distortion)[0]
        found = found.reshape(-1, 2)
        if self.fold_radius < np.inf:
            self._put_outside(found, rays[:, :2])
        return found

    def determinant(self, points_px: F64) -> F64:
        """Of undistorted pixels (n, 2): the determinant of the distortion's derivative, 1 in the
        middle of a picture; -1 where the model folds over."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = ((_rows(points_px).reshape(-1, 2) - self.middle_px) / self.focal_px).T
        s = x * x + y * y
        radial = 1 + s * (k1 + s * (k2 + s * k3))
        slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3))  # of radial, over x or y
        a = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
        d = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
        b = x * y * slope + 2 * p1 * x + 2 * p2 * y
        found: F64 = np.where((s < self.fold_radius**2) & (a > 0), a * d - b * b, -1.0)
        return found

    @cached_property
    def fold_radius(self) -> float:
        """Distance from the axis, over the focal length, up to which distortion is monotonic."""
        k1, k2, _, _, k3 = self.distortion
        terms = np.array([7 * k3, 5 * k2, 3 * k1, 1.0])
        terms[np.abs(terms) < _NOTHING] = 0.0
        roots = np.roots(terms)
        turns = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        return float(np.sqrt(turns.min())) if len(turns) else np.inf

    @cached_property
    def _stop(self) -> tuple[int, int, float]:
        return (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ROUNDS, _CLOSE_PX)

    def _put_outside(self, found: F64, rays: F64) -> None:
        radius = np.sqrt(np.einsum("ij,ij->i", rays, rays))
        if radius.max() <= self.fold_radius:
            return
        k1, k2, _, _, k3 = self.distortion
        s = self.fold_radius**2
        edge = self.fold_radius * (1 + s * (k1 + s * (k2 + s * k3)))
        beyond = radius > self.fold_radius
        stretch = np.maximum(1.0, _OUTSIDE * edge / radius[beyond])[:, None]
        outside = self.middle_px + rays[beyond] * stretch * self.focal_px
        found[beyond] = np.clip(outside, -_FAR_PX, _FAR_PX)


_ZERO = np.zeros(3)


def _rows(points: F64) -> F64:
    """As OpenCV takes points."""
    return np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 2)


ANCHOR_ID_MIN = 40  # ArUco DICT_4X4_50 ids from here on are the tank's, not the fish's
SCALE_ERROR_MAX = 0.01
ANCHOR_OFF_MAX_M = 0.02

_FORMAT, _VERSION = "tailbeat camera calibration", 1
_HORIZON = 1e-6
_BENT_PER_RMS = 4.0  # 0.7 pi over half of the area
_MAKE_ONE = "Make one: tailbeat camera calibrate"


@dataclass(frozen=True)
class Calibration:
    """A camera over a tank.

    The tank's frame: x along the swim direction from the start, y to the right, both in the plane
    in which the marker moves; metres. Pixels as in marker/tags.py.

    ``camera_matrix`` (3, 3) and ``distortion`` (5,) are OpenCV's pinhole and Brown-Conrady model;
    ``tank_from_image`` (3, 3) maps undistorted pixels (of the same camera_matrix) to the tank.
    ``area_m`` (n, 2): corners of the water the fish may be in, n >= 3, convex; None = not known.
    ``anchors``: id of a marker that is fixed at the tank -> its centre in pixels when calibrated.
    ``scale_error``: by the ruler, relative; None = never checked. ``rms_px``: of the intrinsics,
    None = a camera taken to be without distortion. ``plane_rms_m``: of the tank's points.
    ``plane``: in words, where the marker's plane is and how that was dealt with. ``refraction``:
    None = the marker is not under water, or the points were; else the homography is to the plane in
    which it seems to be.
    """

    size_px: tuple[int, int]
    camera_matrix: F64
    distortion: F64
    tank_from_image: F64
    area_m: F64 | None = None
    anchors: dict[int, tuple[float, float]] = field(default_factory=dict)
    scale_error: float | None = None
    rms_px: float | None = None
    plane_rms_m: float | None = None
    plane: str = ""
    camera: str = ""
    made_at: str = ""
    refraction: Refraction | None = None

    def to_tank(self, points_px: F64) -> F64:
        """Pixels (n, 2) of the distorted picture to metres (n, 2)."""
        flat = self.lens.undistorted(points_px)
        places = mapped(self._to_tank, flat)
        return places if self.refraction is None else self.refraction.true(places)

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the scale from place to place, relative, as far as the misfit of
        the tank's points tells it. A homography through a dozen points is off by about 0.7 of their
        RMS, this way and that over half of the area. 0 = only four points, or no area."""
        if not self.plane_rms_m or self.area_m is None:
            return 0.0
        extent_m = float(np.ptp(np.asarray(self.area_m), axis=0).max())
        return _BENT_PER_RMS * self.plane_rms_m / extent_m

    def to_pixels(self, points_m: F64) -> F64:
        """Metres (n, 2) to pixels (n, 2) of the distorted picture; the inverse of to_tank within
        1e-3 pixels everywhere in the picture. Points that the camera cannot see lie outside it."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        if self.refraction is not None:
            points = self.refraction.apparent(points)
        rays = points @ self._to_rays[:, :2].T + self._to_rays[:, 2]
        return self.lens.pixels(rays / np.maximum(rays[:, 2:], _HORIZON))

    @cached_property
    def lens(self) -> Lens:
        """The camera without the tank."""
        return Lens(self.camera_matrix, self.distortion)

    @cached_property
    def _to_tank(self) -> F64:
        matrix = np.asarray(self.tank_from_image, dtype=np.float64)
        middle = (self.size_px[0] / 2, self.size_px[1] / 2, 1.0)
        return np.ascontiguousarray(matrix / (matrix[2] @ middle))

    @cached_property
    def _to_rays(self) -> F64:
        """From the tank to directions x, y, 1 in the camera's frame, times their depth, which is
        near 1 in the middle of the picture."""
        to_image = np.linalg.inv(self._to_tank)
        rays: F64 = np.linalg.inv(np.asarray(self.camera_matrix, dtype=np.float64)) @ to_image
        return rays

    def check_size(self, size_px: tuple[int, int], name: str) -> None:
        """Raises InputError when pictures of that size are not this camera's."""
        if tuple(size_px) != tuple(self.size_px):
            raise InputError(
                f"{name} has pictures of {_size(size_px)}, the calibration is for "
                f"{_size(self.size_px)}: another camera or another setting of it",
                "Film with the camera and the setting that were calibrated, or calibrate again: "
                "tailbeat camera calibrate",
            )

    def check_anchors(self, seen: dict[int, tuple[float, float]], name: str) -> float | None:
        """How far (m, the worst) anchors seen in a picture are from where they were when this was
        made; None when fewer than two are known and seen. Raises InputError beyond 2 cm: the camera
        has been moved or is another one."""
        both = sorted(self.anchors.keys() & seen.keys())
        if len(both) < 2:
            return None
        then = self.to_tank(np.array([self.anchors[i] for i in both]))
        now = self.to_tank(np.array([seen[i] for i in both]))
        off_m = np.linalg.norm(now - then, axis=1)
        worst = int(np.argmax(off_m))
        if not off_m[worst] <= ANCHOR_OFF_MAX_M:
            raise InputError(
                f"in {name} anchor {both[worst]} is {off_m[worst] * 100:.0f} cm from its place at "
                "calibration. The camera or the anchor has moved, or it is another camera",
                "Put it back, or calibrate again: tailbeat camera calibrate",
            )
        return float(off_m[worst])

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all. Raises InputError when the calibration makes no
        sense or the file cannot be written."""
        check_sense(self, "this calibration")
        held = replace(self, anchors=dict(sorted(self.anchors.items())))
        document = {"format": _FORMAT, "version": _VERSION} | plain(held)
        write_whole(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def load_calibration(path: Path) -> Calibration:
    """Reads a file of ``save``. Raises InputError when it is none or makes no sense."""

    def this_version(document: Any) -> Any:
        if not isinstance(document, dict) or document.get("format") != _FORMAT:
            raise InputError(f"{path} is no calibration of a camera", _MAKE_ONE)
        if document.get("version") != _VERSION:
            raise InputError(
                f"{path} has version {str(document.get('version'))[:20]}, this tailbeat reads "
                f"{_VERSION}",
                "Use the tailbeat that wrote it, or calibrate again.",
            )
        return document

    found = decode.read(path, Calibration, _MAKE_ONE, prepare=this_version)
    check_sense(found, str(path))
    return found


def corners_of(left: float, top: float, right: float, bottom: float) -> F64:
    """Corners (4, 2) of a box, in order around it."""
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def mapped(homography: F64, points: F64) -> F64:
    """The points (n, 2), sent through the homography (3, 3)."""
    if not len(points):
        return np.empty((0, 2))
    found: F64 = cv2.perspectiveTransform(points.reshape(-1, 1, 2), homography)
    return found.reshape(-1, 2)


def _size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"


SIDE_PX_MAX = 20_000
_FOCAL_PX_MAX, _DISTORTION_MAX, _FAR_M = 1e6, 100.0, 1000.0
_INVERSE_PX = 1e-3
_FOLD_MARGIN = 0.05  # nearer to a fold, one pixel is twenty: no measuring there
_SCALE_M_PX = (1e-6, 1.0)
_TURN_RAD, _TINY = 1e-6, 1e-30
_STRETCH_MAX = 50.0  # of a pixel on the water, long side over short: seen almost edge-on
_SHAPES: dict[str, tuple[int, ...]] = {
    "camera_matrix": (3, 3),
    "distortion": (5,),
    "tank_from_image": (3, 3),
    "scale_error": (),
    "rms_px": (),
    "plane_rms_m": (),
}
_AGAIN = "Calibrate again: tailbeat camera calibrate"


def check_sense(calibration: Calibration, name: str) -> None:
    """Raises InputError, with ``name`` of the file, for a camera, a plane or an area that cannot
    be. Everything is to be finite and of the right shape already, or InputError says so, too."""
    _check_numbers(calibration, name)
    _check_camera(calibration, name)
    _check_lens(calibration, name)
    _check_plane(calibration, name)
    if calibration.area_m is not None:
        check_area(calibration.area_m, name)
    if calibration.refraction is not None:
        _check_refraction(calibration.refraction, name)


def check_area(area_m: F64, name: str) -> None:
    """Raises InputError unless the corners (n, 2) are those of a convex area, n >= 3, in order."""
    area = np.asarray(area_m, dtype=float)
    if area.ndim != 2 or area.shape[1] != 2 or len(area) < 3:
        raise InputError(f"{name}: an area has at least three corners x, y", _AGAIN)
    if not (np.abs(area) <= _FAR_M).all():
        raise InputError(f"{name}: that area is not in a tank", _AGAIN)
    sides = np.roll(area, -1, axis=0) - area
    after = np.roll(sides, -1, axis=0)
    cross = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    turn = np.arctan2(cross, (sides * after).sum(axis=1))
    once_round = abs(abs(turn.sum()) - 2 * np.pi) < _TURN_RAD  # a star turns more than once
    one_way = (turn >= -_TURN_RAD).all() or (turn <= _TURN_RAD).all()
    if not (sides.any(axis=1).all() and once_round and one_way):
        raise InputError(f"{name}: the area is not convex, or its corners are out of order", _AGAIN)


def _check_refraction(bent: Refraction, name: str) -> None:
    foot = np.asarray(bent.foot_m)
    if foot.shape != (2,) or not (np.abs(foot) <= _FAR_M).all():
        raise InputError(f"{name}: refraction.foot_m should be 2 numbers, in a tank", _AGAIN)
    if not (0 < bent.over_water_m <= _FAR_M and 0 <= bent.depth_m <= bent.over_water_m):
        raise InputError(
            f"{name}: a marker {bent.depth_m:g} m under water cannot be seen right by a camera "
            f"{bent.over_water_m:g} m above it",
            "Heights are metres; the camera hangs higher than the marker is deep.",
        )


def _check_numbers(calibration: Calibration, name: str) -> None:
    for what, shape in _SHAPES.items():
        value = getattr(calibration, what)
        if value is None:
            continue
        array = np.asarray(value, dtype=float)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{name}: {what} should be {_words(shape)}, finite", _AGAIN)
    if not all(np.isfinite(place).all() for place in calibration.anchors.values()):
        raise InputError(f"{name}: an anchor's place should be finite", _AGAIN)


def _words(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) + " numbers" if shape else "a number"


def _check_camera(calibration: Calibration, name: str) -> None:
    width, height = calibration.size_px
    if not (1 < width <= SIDE_PX_MAX and 1 < height <= SIDE_PX_MAX):
        raise InputError(f"{name}: pictures of {width}x{height} pixels cannot be", _AGAIN)
    matrix = np.asarray(calibration.camera_matrix)
    plain = np.array_equal(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1])
    focal = matrix[[0, 1], [0, 1]]
    if not plain or not ((focal > 1) & (focal < _FOCAL_PX_MAX)).all():
        raise InputError(f"{name}: that camera matrix is no pinhole's", _AGAIN)
    if not (0 <= matrix[0, 2] <= width and 0 <= matrix[1, 2] <= height):
        raise InputError(
            f"{name}: the lens's axis lies outside the picture. It is another camera's matrix, or "
            "the pictures of the board are too few",
            "Take more pictures of the board, tilted, in all parts of the picture.",
        )


def _check_lens(calibration: Calibration, name: str) -> None:
    if not (np.abs(calibration.distortion) <= _DISTORTION_MAX).all():
        raise InputError(f"{name}: no lens distorts like that", _AGAIN)
    lens, points = calibration.lens, _raster(calibration.size_px)
    flat = lens.undistorted(points)
    with np.errstate(all="ignore"):
        folded = not (lens.determinant(flat) > _FOLD_MARGIN).all()
        off_px = np.abs(lens.distorted(flat) - points).max()
    if folded or not off_px <= _INVERSE_PX:
        raise InputError(
            f"{name}: the model of the lens folds over before the picture's corners: two places on "
            "the water share one pixel",
            "Take more pictures of the board, with the board in the picture's corners, too.",
        )


def _check_plane(calibration: Calibration, name: str) -> None:
    matrix = np.asarray(calibration.tank_from_image, dtype=float)
    flat = calibration.lens.undistorted(_raster(calibration.size_px))
    rows = np.column_stack([flat, np.ones(len(flat))])
    size = np.abs(matrix).max()
    matrix = matrix / (size if size > _TINY else 1.0)
    values = np.linalg.svd(matrix @ np.diag([*calibration.size_px, 1.0]), compute_uv=False)
    if not (values[2] > 1e-9 * values[0] and _TINY < size < 1 / _TINY):
        raise InputError(f"{name}: the homography is singular", _AGAIN)
    depth = rows @ matrix[2]
    if not (np.sign(depth) == np.sign(depth[0])).all() or depth[0] == 0:
        raise InputError(
            f"{name}: the plane's horizon lies in the picture. The camera does not look down on "
            "the tank, or the points are wrong",
            "Check the tank's points; the camera should look down.",
        )
    long, short, sign = _scale(matrix, rows, depth)
    if (sign < 0).any():
        raise InputError(
            f"{name}: the tank appears mirrored. x and y are swapped, or y is counted to the left",
            "x goes along the swimming direction, y to the right of it (seen from above).",
        )
    sensible = short.min() >= _SCALE_M_PX[0] and long.max() <= _SCALE_M_PX[1]
    if not sensible or (long / short).max() > _STRETCH_MAX:
        raise InputError(
            f"{name}: the homography makes no sense: a pixel is {short.min() * 1e3:.3g} to "
            f"{long.max() * 1e3:.3g} mm on the water",
            "Check the tank's points: pixels in pixels, places in metres.",
        )


def _scale(matrix: F64, rows: F64, depth: F64) -> tuple[Any, Any, Any]:
    """Of each point: metres per pixel along the longest and the shortest direction, and whether
    the tank is seen from above (> 0) or in a mirror."""
    at = (rows @ matrix[:2].T) / depth[:, None]
    jacobian = (matrix[None, :2, :2] - at[:, :, None] * matrix[2, :2]) / depth[:, None, None]
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values[:, 0], values[:, 1], np.sign(np.linalg.det(jacobian))


def _raster(size_px: tuple[int, int]) -> F64:
    """Points all over the picture, its outermost corners included."""
    width, height = size_px
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, 41), np.linspace(-0.5, height - 0.5, 25))
    return np.column_stack([u.ravel(), v.ravel()])
