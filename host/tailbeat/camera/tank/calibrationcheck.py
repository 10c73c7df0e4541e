"""Whether a calibration makes sense: what no camera over a tank can have is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.errors import InputError

if TYPE_CHECKING:
    from tailbeat.camera.tank.calibration import Calibration, Floats

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


def check_area(area_m: Floats, name: str) -> None:
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


def _scale(matrix: Floats, rows: Floats, depth: Floats) -> tuple[Any, Any, Any]:
    """Of each point: metres per pixel along the longest and the shortest direction, and whether
    the tank is seen from above (> 0) or in a mirror."""
    at = (rows @ matrix[:2].T) / depth[:, None]
    jacobian = (matrix[None, :2, :2] - at[:, :, None] * matrix[2, :2]) / depth[:, None, None]
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values[:, 0], values[:, 1], np.sign(np.linalg.det(jacobian))


def _raster(size_px: tuple[int, int]) -> Floats:
    """Points all over the picture, its outermost corners included."""
    width, height = size_px
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, 41), np.linspace(-0.5, height - 0.5, 25))
    return np.column_stack([u.ravel(), v.ravel()])
