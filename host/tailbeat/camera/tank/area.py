"""The water the fish may be in: as given, or between the tank's points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.tank.calibration import Calibration
from tailbeat.camera.tank.calibrationcheck import check_area
from tailbeat.errors import InputError

Floats = NDArray[np.float64]

_LARGER_MAX = 2.0  # than what the picture shows
_SHARED_MIN = 0.1  # with the hull of the points, of the smaller one
_WRITE = "Write --area LENGTH,WIDTH or --area X0,Y0,X1,Y1 in metres, in the frame of the points."


def rectangle(numbers: list[float]) -> Floats:
    """An area (4, 2) from LENGTH,WIDTH (a corner at 0, 0) or X0,Y0,X1,Y1. Raises InputError."""
    if len(numbers) == 2:
        numbers = [0.0, 0.0, *numbers]
    if len(numbers) != 4 or not np.isfinite(numbers).all():
        raise InputError("that is no area", _WRITE)
    x0, y0, x1, y1 = numbers
    if not (x1 > x0 and y1 > y0):
        raise InputError("that area is empty", "X1 is larger than X0, Y1 than Y0; metres.")
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def hull(places_m: Floats) -> Floats:
    """Corners (n, 2) of the least convex area with all the places."""
    found = need_cv2().convexHull(places_m.astype(np.float32), returnPoints=False)
    return places_m[np.ravel(found)]


def check_given_area(area_m: Floats, places_m: Floats) -> None:
    """Raises InputError for corners (n, 2) that cannot be the water between or around the tank's
    points ``places_m``."""
    check_area(area_m, "the area given (--area)")
    least = min(_square_m(area_m), _square_m(hull(places_m)))
    if _shared_square_m(area_m, hull(places_m)) < _SHARED_MIN * least:
        raise InputError(
            "the area (--area) lies beside the tank's points: in it there would be none of the "
            "space between them",
            _WRITE,
        )


def check_area_seen(calibration: Calibration) -> None:
    """Raises InputError when the area is much larger than what the picture shows of the tank: the
    fish would never come near its walls."""
    assert calibration.area_m is not None
    width, height = calibration.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
    seen = hull(calibration.to_tank(np.column_stack([u.ravel(), v.ravel()])))
    larger = _square_m(calibration.area_m) / _square_m(seen)
    if larger > _LARGER_MAX:
        raise InputError(
            f"the area (--area) is {larger:.3g} times as large as what the picture shows: is it in "
            "metres?",
            _WRITE,
        )


def _square_m(corners: Floats) -> float:
    return float(need_cv2().contourArea(corners.astype(np.float32)))


def _shared_square_m(one: Floats, other: Floats) -> float:
    cv2 = need_cv2()
    shared, _ = cv2.intersectConvexConvex(one.astype(np.float32), other.astype(np.float32))
    return float(shared)
