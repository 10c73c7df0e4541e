"""From pixels to metres in the tank: one file, made by ``tailbeat camera calibrate``.

Whether a calibration makes sense: what no camera over a tank can have is refused.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera.calibration.lens import Lens
from tailbeat.sensors.camera.opencv import cv2

ANCHOR_ID_MIN = 40  # ArUco DICT_4X4_50 ids from here on are the tank's, not the fish's
SCALE_ERROR_MAX = 0.01
ANCHOR_OFF_MAX_M = 0.02

_FORMAT, _VERSION = "tailbeat camera calibration", 1
_BYTES_MAX = 1_000_000
_HORIZON = 1e-6
_MAKE_ONE = "Make one: tailbeat camera calibrate"


@dataclass(frozen=True)
class Calibration:
    """A camera over a tank.

    The tank's frame: x along the swim direction from the start, y to the right, both in the plane
    in which the marker moves; metres. Pixels as in marker/sighting.py.

    ``camera_matrix`` (3, 3) and ``distortion`` (5,) are OpenCV's pinhole and Brown-Conrady model;
    ``tank_from_image`` (3, 3) maps undistorted pixels (of the same camera_matrix) to the tank.
    ``area_m`` (n, 2): corners of the water the fish may be in, n >= 3, convex; None = not known.
    ``anchors``: id of a marker that is fixed at the tank -> its centre in pixels when calibrated.
    ``scale_error``: by the ruler, relative; None = never checked. ``rms_px``: of the intrinsics,
    None = a camera taken to be without distortion. ``plane_rms_m``: of the tank's points.
    ``plane``: in words, where the marker's plane is and how that was dealt with.
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

    def to_tank(self, points_px: F64) -> F64:
        """Pixels (n, 2) of the distorted picture to metres (n, 2)."""
        flat = self.lens.undistorted(points_px)
        return _mapped(self._to_tank, flat)

    def to_pixels(self, points_m: F64) -> F64:
        """Metres (n, 2) to pixels (n, 2) of the distorted picture; the inverse of to_tank within
        1e-3 pixels everywhere in the picture. Points that the camera cannot see lie outside it."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
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
                "Film with the camera and the setting that were calibrated, or calibrate anew: "
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
                f"in {name} anchor {both[worst]} is {off_m[worst] * 100:.0f} cm from where it was "
                "when the camera was calibrated: camera or anchor has been moved, or it is another "
                "camera",
                "Put it back, or calibrate anew: tailbeat camera calibrate",
            )
        return float(off_m[worst])

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all. Raises InputError when the calibration makes no
        sense or the file cannot be written."""
        check_sense(self, "this calibration")
        write_whole(path, json.dumps(_document(self), indent=1, allow_nan=False) + "\n")


def load_calibration(path: Path) -> Calibration:
    """Reads a file of ``save``. Raises InputError when it is none or makes no sense."""
    try:
        with path.open("rb") as file:
            data = file.read(_BYTES_MAX + 1)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {reason(error)}", _MAKE_ONE) from error
    try:
        raw = json.loads(data.decode("utf-8")) if len(data) <= _BYTES_MAX else None
    except (ValueError, RecursionError):
        raw = None
    if not isinstance(raw, dict) or raw.get("format") != _FORMAT:
        raise InputError(f"{path} is no calibration of a camera", _MAKE_ONE)
    if raw.get("version") != _VERSION:
        raise InputError(
            f"{path} has version {str(raw.get('version'))[:20]}, this tailbeat reads {_VERSION}",
            "Use the tailbeat that wrote it, or calibrate anew.",
        )
    try:
        found = _from_document(raw)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path} is damaged: {what}", _MAKE_ONE) from error
    check_sense(found, str(path))
    return found


def _document(calibration: Calibration) -> dict[str, Any]:
    raw = asdict(calibration)
    for name in ("camera_matrix", "distortion", "tank_from_image", "area_m"):
        raw[name] = None if raw[name] is None else np.asarray(raw[name], dtype=float).tolist()
    raw["anchors"] = {str(i): list(place) for i, place in sorted(calibration.anchors.items())}
    return {"format": _FORMAT, "version": _VERSION} | raw


def _from_document(raw: dict[str, Any]) -> Calibration:
    area = raw.get("area_m")
    width, height = _array(raw, "size_px", (2,))
    return Calibration(
        size_px=(int(width), int(height)),
        camera_matrix=_array(raw, "camera_matrix", (3, 3)),
        distortion=_array(raw, "distortion", (5,)),
        tank_from_image=_array(raw, "tank_from_image", (3, 3)),
        area_m=None if area is None else _array(raw, "area_m", (len(area), 2)),
        anchors=_anchors(raw.get("anchors", {})),
        scale_error=_number(raw, "scale_error"),
        rms_px=_number(raw, "rms_px"),
        plane_rms_m=_number(raw, "plane_rms_m"),
        plane=str(raw.get("plane", "")),
        camera=str(raw.get("camera", "")),
        made_at=str(raw.get("made_at", "")),
    )


def _anchors(raw: Any) -> dict[int, tuple[float, float]]:
    if not isinstance(raw, dict):
        raise TypeError("its anchors are no list of ids and places")
    found = {}
    for name in raw:
        u, v = _array(raw, name, (2,))
        found[int(name)] = (float(u), float(v))
    return found


def _number(raw: dict[str, Any], name: str) -> float | None:
    return None if raw.get(name) is None else float(_array(raw, name, ()))


def _array(raw: dict[str, Any], name: str, shape: tuple[int, ...]) -> F64:
    """Raises KeyError, or ValueError unless these are numbers in that shape. Text that looks like
    a number is none."""
    try:
        array = np.array(raw[name])
    except ValueError:  # rows of different lengths
        array = np.array(None)
    if array.dtype.kind not in "iuf" or array.shape != shape:
        words = " x ".join(map(str, shape)) + " numbers" if shape else "a number"
        raise ValueError(f"its {name} should be {words}")
    if not np.isfinite(array).all():
        raise ValueError(f"its {name} is not finite")
    return array.astype(np.float64)


def _mapped(homography: F64, points: F64) -> F64:
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
_ANEW = "Calibrate anew: tailbeat camera calibrate"


def check_sense(calibration: Calibration, name: str) -> None:
    """Raises InputError, with ``name`` of the file, for a camera, a plane or an area that cannot
    be. Everything is to be finite and of the right shape already, or InputError says so, too."""
    _check_numbers(calibration, name)
    _check_camera(calibration, name)
    _check_lens(calibration, name)
    _check_plane(calibration, name)
    if calibration.area_m is not None:
        check_area(calibration.area_m, name)


def check_area(area_m: F64, name: str) -> None:
    """Raises InputError unless the corners (n, 2) are those of a convex area, n >= 3, in order."""
    area = np.asarray(area_m, dtype=float)
    if area.ndim != 2 or area.shape[1] != 2 or len(area) < 3:
        raise InputError(f"{name}: an area has at least three corners x, y", _ANEW)
    if not (np.abs(area) <= _FAR_M).all():
        raise InputError(f"{name}: that area is not in a tank", _ANEW)
    sides = np.roll(area, -1, axis=0) - area
    after = np.roll(sides, -1, axis=0)
    cross = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
    turn = np.arctan2(cross, (sides * after).sum(axis=1))
    once_round = abs(abs(turn.sum()) - 2 * np.pi) < _TURN_RAD  # a star turns more than once
    one_way = (turn >= -_TURN_RAD).all() or (turn <= _TURN_RAD).all()
    if not (sides.any(axis=1).all() and once_round and one_way):
        raise InputError(f"{name}: the area is not convex, or its corners are out of order", _ANEW)


def _check_numbers(calibration: Calibration, name: str) -> None:
    shapes = {"camera_matrix": (3, 3), "distortion": (5,), "tank_from_image": (3, 3)}
    for what, shape in shapes.items():
        array = np.asarray(getattr(calibration, what), dtype=float)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{name}: {what} should be {shape} finite numbers", _ANEW)
    for what in ("scale_error", "rms_px", "plane_rms_m"):
        value = getattr(calibration, what)
        if value is not None and not np.isfinite(value):
            raise InputError(f"{name}: {what} is not finite", _ANEW)


def _check_camera(calibration: Calibration, name: str) -> None:
    width, height = calibration.size_px
    if not (1 < width <= SIDE_PX_MAX and 1 < height <= SIDE_PX_MAX):
        raise InputError(f"{name}: pictures of {width}x{height} pixels cannot be", _ANEW)
    matrix = np.asarray(calibration.camera_matrix)
    plain = np.array_equal(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1])
    focal = matrix[[0, 1], [0, 1]]
    if not plain or not ((focal > 1) & (focal < _FOCAL_PX_MAX)).all():
        raise InputError(f"{name}: that camera matrix is no pinhole's", _ANEW)
    if not (0 <= matrix[0, 2] <= width and 0 <= matrix[1, 2] <= height):
        raise InputError(
            f"{name}: the lens's axis lies outside the picture: it is another camera's matrix, or "
            "the pictures of the board said too little",
            "Take more pictures of the board, tilted, in all parts of the picture.",
        )


def _check_lens(calibration: Calibration, name: str) -> None:
    if not (np.abs(calibration.distortion) <= _DISTORTION_MAX).all():
        raise InputError(f"{name}: no lens distorts like that", _ANEW)
    lens, points = calibration.lens, _raster(calibration.size_px)
    flat = lens.undistorted(points)
    with np.errstate(all="ignore"):
        folded = not (lens.determinant(flat) > _FOLD_MARGIN).all()
        off_px = np.abs(lens.distorted(flat) - points).max()
    if folded or not off_px <= _INVERSE_PX:
        raise InputError(
            f"{name}: the model of the lens folds over before the picture's corners (two places on "
            "the water would be one pixel)",
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
        raise InputError(f"{name}: the homography is singular", _ANEW)
    depth = rows @ matrix[2]
    if not (np.sign(depth) == np.sign(depth[0])).all() or depth[0] == 0:
        raise InputError(
            f"{name}: the plane's horizon lies in the picture: the camera does not look down on "
            "the tank, or the points are wrong",
            "Check the tank's points; the camera should look down.",
        )
    long, short, sign = _scale(matrix, rows, depth)
    if (sign < 0).any():
        raise InputError(
            f"{name}: the tank would be seen in a mirror: x and y are swapped, or y is counted to "
            "the left",
            "x goes along the swim, y to the right of it (seen from above).",
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
