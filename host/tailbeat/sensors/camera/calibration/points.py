"""Places in the tank whose metres are known, and the area of the water: given or between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.csv import read_rows, read_table, value_of
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import Calibration, check_area, corners_of
from tailbeat.sensors.camera.marker.tags import anchors_of

_LARGER_MAX = 2.0  # than what the picture shows
_SHARED_MIN = 0.1  # with the hull of the points, of the smaller one
_WRITE = "Write --area LENGTH,WIDTH or --area X0,Y0,X1,Y1 in metres, in the frame of the points."


def rectangle(numbers: list[float]) -> F64:
    """An area (4, 2) from LENGTH,WIDTH (a corner at 0, 0) or X0,Y0,X1,Y1. Raises InputError."""
    if len(numbers) == 2:
        numbers = [0.0, 0.0, *numbers]
    if len(numbers) != 4 or not np.isfinite(numbers).all():
        raise InputError("that is no area", _WRITE)
    x0, y0, x1, y1 = numbers
    if not (x1 > x0 and y1 > y0):
        raise InputError("that area is empty", "X1 is larger than X0, Y1 than Y0; metres.")
    return corners_of(x0, y0, x1, y1)


def hull(places_m: F64) -> F64:
    """Corners (n, 2) of the least convex area with all the places."""
    found = cv2.convexHull(places_m.astype(np.float32), returnPoints=False)
    return places_m[np.ravel(found)]


def check_given_area(area_m: F64, places_m: F64) -> None:
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


def _square_m(corners: F64) -> float:
    return float(cv2.contourArea(corners.astype(np.float32)))


def _shared_square_m(one: F64, other: F64) -> float:
    shared, _ = cv2.intersectConvexConvex(one.astype(np.float32), other.astype(np.float32))
    return float(shared)


POINTS_MIN = 4
_BY_HAND, _BY_MARKER = ("u_px", "v_px", "x_m", "y_m"), ("id", "x_m", "y_m")
_COLUMNS = f"{','.join(_BY_HAND)} or {','.join(_BY_MARKER)}"
_FAR_M = 1000.0


@dataclass(frozen=True)
class TankPoint:
    """``name``: for messages. ``place_m``: x, y in the tank. ``pixel``: None = the centre of the
    marker ``id``, which is still to be found in a picture."""

    name: str
    place_m: tuple[float, float]
    pixel: tuple[float, float] | None = None
    id: int | None = None


def read_points(path: Path) -> list[TankPoint]:
    """From CSV with a header: pixels and metres, or ids of markers and metres. Raises InputError:
    no such table, not numbers, fewer than four points, one twice."""
    table = read_table(path, _COLUMNS)
    header = {cell.strip() for cell in table[0]} if table else set()
    columns = next((some for some in (_BY_HAND, _BY_MARKER) if header.issuperset(some)), None)
    if columns is None:
        raise InputError(f"{path} is no table of points", f"Its first line is {_COLUMNS}.")
    points = []
    for number, cells in read_rows(path, columns):
        named = zip(columns, cells, strict=True)
        values = [value_of(path.name, number, column, cell) for column, cell in named]
        points.append(_point(values, f"{path}, row {number}"))
    _check_distinct(points, path)
    if len(points) < POINTS_MIN:
        raise InputError(
            f"{path} has {len(points)} points, {POINTS_MIN} are needed",
            "Measure more of them, spread over the tank.",
        )
    return points


def located(
    points: list[TankPoint], seen: dict[int, tuple[float, float]] | None, name: str
) -> list[TankPoint]:
    """The points with their pixels; ``seen``: markers in the picture ``name``, None = no picture
    was given. Raises InputError when fewer than four are seen."""
    if all(point.pixel is not None for point in points):
        return points
    if seen is None:
        raise InputError(
            "the points are markers, and there is no picture of them",
            "Give a picture of the tank: --picture FILE",
        )
    found = [replace(point, pixel=seen[point.id]) for point in points if point.id in seen]
    if len(found) < POINTS_MIN:
        missing = ", ".join(str(p.id) for p in points if p.id not in seen)
        raise InputError(
            f"{name} shows {len(found)} of the {len(points)} markers (not: {missing}), "
            f"{POINTS_MIN} are needed",
            "Larger markers, more light, no glare, no water on them; all in the picture.",
        )
    return found


def tank_anchors(points: list[TankPoint]) -> dict[int, tuple[float, float]]:
    """Markers among located points that stay at the tank: id -> pixel."""
    return anchors_of({p.id: p.pixel for p in points if p.id is not None and p.pixel is not None})


def _point(values: list[float], where: str) -> TankPoint:
    *what, x, y = values
    if max(abs(x), abs(y)) > _FAR_M:
        raise InputError(f"{where}: {x:g}, {y:g} is not in a tank", "x_m and y_m are metres.")
    if len(what) == 2:
        return TankPoint(f"{what[0]:g}, {what[1]:g} px", (x, y), (what[0], what[1]))
    if not (what[0].is_integer() and 0 <= what[0] < 50):
        raise InputError(f"{where}: {what[0]:g} is no marker's id", "Ids are 0 to 49.")
    return TankPoint(f"marker {what[0]:g}", (x, y), None, int(what[0]))


def _check_distinct(points: list[TankPoint], path: Path) -> None:
    for kind in ("name", "place_m"):
        seen = set()
        for point in points:
            value = getattr(point, kind)
            if value in seen:
                x, y = point.place_m
                raise InputError(f"{path} has {point.name} at {x:g}, {y:g} m twice", "Once each.")
            seen.add(value)
