"""Makes a calibration from pictures of the board, known points in the tank, and a ruler."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import SCALE_ERROR_MAX, Calibration, Lens, check_sense
from tailbeat.sensors.camera.calibration.intrinsics import Intrinsics, find_intrinsics
from tailbeat.sensors.camera.calibration.plane import (
    CameraPlace,
    Plane,
    camera_place,
    fit_plane,
    raised,
)
from tailbeat.sensors.camera.calibration.points import (
    TankPoint,
    check_area_seen,
    check_given_area,
    hull,
    located,
    tank_anchors,
)
from tailbeat.sensors.camera.calibration.water import WATER, Refraction
from tailbeat.sensors.camera.marker.tags import RULER_IDS, anchors_of, find_markers
from tailbeat.sensors.camera.source.picture import Image, size_of

END_SIGMA_PX = 0.2
SIGMA_MAX = SCALE_ERROR_MAX / 2


@dataclass(frozen=True)
class RulerCheck:
    """``scale_error``: measured over true length, less one. ``sigma``: of that, from finding the
    ends within END_SIGMA_PX each."""

    name: str
    true_m: float
    measured_m: float
    sigma: float

    @property
    def scale_error(self) -> float:
        """Relative; positive = the calibration takes things for longer than they are."""
        return self.measured_m / self.true_m - 1


def check_ruler(calibration: Calibration, ruler: Ruler) -> RulerCheck:
    """Measures the ruler. Raises InputError when it is too short in the picture to tell half a
    percent. Whether the scale is right: ``refuse_scale``."""
    name, true_m, ends_px = ruler.name, ruler.true_m, ruler.ends_px
    if not 0 < true_m < np.inf:
        raise InputError(f"a ruler of {true_m:g} m cannot be", "Its length in metres.")
    width, height = calibration.size_px
    if not ((ends_px >= -0.5) & (ends_px <= [width - 0.5, height - 0.5])).all():
        raise InputError(
            f"{name}: the ruler's ends are not in the picture of {width}x{height}",
            "Give them as U1,V1,U2,V2 in pixels.",
        )
    slopes = [
        (_length(calibration, ends_px + step) - _length(calibration, ends_px - step)) / 2
        for step in np.eye(4).reshape(4, 2, 2)
    ]
    sigma = END_SIGMA_PX * float(np.linalg.norm(slopes)) / true_m
    if not sigma <= SIGMA_MAX:
        raise InputError(
            f"{name}: the ruler is too short in the picture to check by: {true_m:g} m "
            f"within {sigma * 100:.1f} %",
            "Use one as long as the tank allows, at least a quarter of the picture.",
        )
    return RulerCheck(name, true_m, _length(calibration, ends_px), sigma)


def refuse_scale(check: RulerCheck, known_camera: bool) -> None:
    """Raises InputError, with what can be wrong, when the scale is off by more than
    SCALE_ERROR_MAX. ``known_camera``: the lens is from pictures of the board."""
    if abs(check.scale_error) <= SCALE_ERROR_MAX:
        return
    board = "The camera was taken to be free of distortion: give pictures of the board (--board). "
    raise InputError(
        f"{check.name}: the ruler of {check.true_m:g} m measures {check.measured_m:.3f} m, "
        f"{check.scale_error * 100:+.1f} % (sigma {check.sigma * 100:.1f} %, at most "
        f"{SCALE_ERROR_MAX * 100:g} %)",
        f"{'' if known_camera else board}Is the ruler at the marker's height (if not the points, "
        "then --raise or --depth)? Are the points and the ruler's length typed right? Is it the "
        "same camera, zoom and setting?",
    )


def _length(calibration: Calibration, ends_px: F64) -> float:
    a, b = calibration.to_tank(ends_px)
    return float(np.hypot(*(b - a)))


_PREDICTED_MAX_M = 0.02
_NEEDS_BOARD = (
    "needs the camera's focal length. Points in one plane alone do not show how large "
    "things are above or below it"
)


@dataclass(frozen=True)
class Height:
    """Where the marker swims. ``raise_m``: how far its plane, or with ``depth_m`` the water's
    surface, is above the plane of the points. ``depth_m``: of the marker under the surface."""

    raise_m: float = 0.0
    depth_m: float = 0.0


@dataclass(frozen=True)
class Ruler:
    """``ends_px`` (2, 2): where its ends are in a picture called ``name``, of ``size_px`` (None =
    not known) and with the tank's ``anchors``: id -> centre in pixels."""

    name: str
    ends_px: F64
    true_m: float
    size_px: tuple[int, int] | None = None
    anchors: dict[int, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Calibrated:
    """``calibration``, and how good it is. ``mm_per_px``: in the middle of the picture. ``notes``:
    what a person should know."""

    calibration: Calibration
    intrinsics: Intrinsics | None
    plane: Plane
    points: tuple[str, ...]
    camera: CameraPlace | None
    rulers: tuple[RulerCheck, ...]
    mm_per_px: float
    notes: tuple[str, ...]


def calibrate(
    points: list[TankPoint],
    tank: tuple[str, Image],
    board: Iterable[tuple[str, Image]] = (),
    height: Height | None = None,
    area_m: F64 | None = None,
    rulers: list[Ruler] | None = None,
    look: Callable[[str], None] = lambda name: None,
) -> Calibrated:
    """``tank``: name of the picture the points are in, and that picture, grey. ``board``: pictures
    of the ChArUco board; none = the camera is taken to be without distortion. ``area_m``: corners
    (n, 2); None = the hull of the points. ``look`` is told each picture before it is looked at.
    Raises InputError for whatever does not fit, the ruler's scale included."""
    name, image = tank
    size_px = size_of(image)
    board = list(board)
    intrinsics = find_intrinsics(board, look) if board else None
    if intrinsics is not None:
        _check_same_size(intrinsics, size_px, name)
    lens = _lens(intrinsics, size_px)
    look(name)
    by_marker = any(point.pixel is None for point in points)
    here = located(points, find_markers(image, name) if by_marker else {}, name)
    pixels, places = _arrays(here, size_px, name)
    names = [point.name for point in here]
    known_camera = intrinsics is not None
    plane = fit_plane(lens, pixels, places, names, known_camera)
    camera = camera_place(lens, plane, pixels, places, names) if known_camera else None
    area = _area(area_m, places, list(plane.left_out))
    matrix, refraction, words = _marker_plane(plane, camera, height or Height())
    kept = [point for i, point in enumerate(here) if i not in plane.left_out]
    calibration = Calibration(
        size_px, lens.camera_matrix, lens.distortion, matrix, area, tank_anchors(kept),
        rms_px=intrinsics.rms_px if intrinsics else None, plane_rms_m=plane.rms_m, plane=words,
        refraction=refraction,
    )  # fmt: skip
    check_sense(calibration, "what comes out")
    check_area_seen(calibration)
    checks = check_scale(calibration, rulers or [])
    notes = _notes(intrinsics, plane, here, len(points) - len(here), bool(checks))
    if area_m is None:
        notes.append("the area is the hull of the points (--area is better)")
    if checks:
        worst = max((check.scale_error for check in checks), key=abs)
        calibration = replace(calibration, scale_error=worst)
    else:
        notes.append("the scale was not checked: lay a ruler into the tank (--ruler)")
    return Calibrated(
        calibration, intrinsics, plane, tuple(names), camera, checks, _mm_per_px(calibration),
        tuple(notes),
    )  # fmt: skip


def check_scale(calibration: Calibration, rulers: list[Ruler]) -> tuple[RulerCheck, ...]:
    """Measures the rulers. Raises InputError when one is off by more than SCALE_ERROR_MAX, or its
    picture is of another camera or of one that has been moved."""
    for ruler in rulers:
        if ruler.size_px is not None:
            calibration.check_size(ruler.size_px, ruler.name)
        calibration.check_anchors(ruler.anchors, ruler.name)
    checks = tuple(check_ruler(calibration, ruler) for ruler in rulers)
    for check in checks:
        refuse_scale(check, known_camera=calibration.rms_px is not None)
    return checks


def ruler_in(image: Image, name: str, true_m: float) -> Ruler:
    """The printed ruler's ends, found in a grey picture. Raises InputError when they are not both
    there."""
    seen = find_markers(image, name)
    if missing := [str(i) for i in RULER_IDS if i not in seen]:
        raise InputError(
            f"{name} does not show the ruler's marker{'s' * (len(missing) - 1)} "
            f"{' and '.join(missing)}",
            "Lay the ruler flat, wholly in view, without glare; print it: tailbeat camera print "
            "ruler",
        )
    ends_px = np.array([seen[i] for i in RULER_IDS])
    return Ruler(name, ends_px, true_m, size_of(image), anchors_of(seen))


def _check_same_size(intrinsics: Intrinsics, size_px: tuple[int, int], name: str) -> None:
    if intrinsics.size_px != size_px:
        ours, theirs = ("x".join(map(str, size)) for size in (size_px, intrinsics.size_px))
        raise InputError(
            f"{name} has {ours}, the pictures of the board have {theirs}",
            "Take all of them in the setting that films the fish; a film instead of a picture will "
            "do, too.",
        )


def _lens(intrinsics: Intrinsics | None, size_px: tuple[int, int]) -> Lens:
    """Without intrinsics the focal length is anything: without distortion it drops out."""
    if intrinsics is not None:
        return Lens(intrinsics.camera_matrix, intrinsics.distortion)
    width, height = size_px
    matrix = [[width, 0.0, (width - 1) / 2], [0.0, width, (height - 1) / 2], [0.0, 0.0, 1.0]]
    return Lens(np.array(matrix), np.zeros(5))


def _arrays(points: list[TankPoint], size_px: tuple[int, int], name: str) -> tuple[F64, F64]:
    pixels = np.array([point.pixel for point in points], dtype=float)
    outside = ((pixels < -0.5) | (pixels > np.array(size_px) - 0.5)).any(axis=1)
    if outside.any():
        where = points[int(np.argmax(outside))].name
        raise InputError(
            f"the point at {where} is not in {name} ({size_px[0]}x{size_px[1]})",
            "u counts to the right, v down, from the upper left corner.",
        )
    return pixels, np.array([point.place_m for point in points], dtype=float)


def _area(area_m: F64 | None, places: F64, left_out: list[int]) -> F64:
    good = np.delete(places, left_out, axis=0)
    if area_m is None:
        return hull(good)
    check_given_area(area_m, good)
    return area_m


def _marker_plane(
    plane: Plane, camera: CameraPlace | None, height: Height
) -> tuple[F64, Refraction | None, str]:
    if height.depth_m < 0:
        raise InputError("a depth is not negative", "Above the points: --raise METRES")
    if height.raise_m == 0 and height.depth_m == 0:
        return plane.tank_from_image, None, "the marker swims in the plane of the points"
    if camera is None:
        option = "--depth" if height.depth_m else "--raise"
        raise InputError(
            f"{option} {_NEEDS_BOARD}",
            "Give pictures of the board (--board), or lay the points at the marker's height.",
        )
    apparent = height.raise_m - height.depth_m / WATER
    moved = raised(plane.tank_from_image, camera, apparent)
    words = f"camera {camera.height_m:.2f} m above the points; "
    if not height.depth_m:
        return moved, None, f"{words}the marker's plane is {_above(height.raise_m)}"
    surface = f"; the surface is {_above(height.raise_m)}" if height.raise_m else ""
    refraction = Refraction(camera.foot_m, camera.height_m - height.raise_m, height.depth_m)
    return (
        moved,
        refraction,
        (
            f"{words}the marker is {height.depth_m * 1e3:.0f} mm under water: its light is taken "
            f"through a flat surface by Snell's law{surface}"
        ),
    )


def _above(raise_m: float) -> str:
    where = "above" if raise_m > 0 else "below"
    return f"{abs(raise_m) * 1e3:.0f} mm {where} the points"


def _notes(
    found: Intrinsics | None, plane: Plane, points: list[TankPoint], unseen: int, measured: bool
) -> list[str]:
    """What a person should know. ``measured``: the scale was checked with a ruler."""
    notes = []
    if found is None:
        notes.append(
            "no pictures of the board: the camera is taken to be free of distortion; near the "
            "picture's edges few are"
        )
    else:
        if found.unseen:
            notes.append(
                f"the board was never in the {', '.join(found.unseen)} of the picture: distortion "
                "there is a guess"
            )
        notes += [f"{name} was not used: {why}" for name, why in found.dropped.items()]
    for i, off_m in plane.left_out.items():
        x, y = points[i].place_m
        notes.append(
            f"{points[i].name} ({x:g}, {y:g} m) is {off_m * 1e3:.0f} mm off the others and was "
            "left out: check it"
        )
    if unseen:
        notes.append(f"{unseen} of the tank's markers were not seen")
    if plane.predicted_m is None:
        notes.append("four points always fit: with more of them, errors would show")
    elif plane.predicted_m > _PREDICTED_MAX_M and not measured:
        lens = "" if found else "the lens bends lines (--board), or "
        notes.append(
            f"each point is predicted by the others only within {plane.predicted_m * 1e3:.0f} mm "
            f"(good: below 10): {lens}a point is wrong. The error of the speeds is unknown"
        )
    return notes


def _mm_per_px(calibration: Calibration) -> float:
    width, height = calibration.size_px
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    cross = calibration.to_tank(middle + np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]]))
    steps = np.hypot(*(cross[1::2] - cross[::2]).T)
    return float(steps.mean() * 1e3)
