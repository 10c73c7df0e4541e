"""The plane of known points in the tank, without those that are wrong, and that of the marker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import Lens, mapped

LEAVE_OUT_FROM = 6
OUTLIER_M = 0.02
_LEFT_MIN = 5
# With the camera's intrinsics and 2 mm of tape the second best is 1.5 times as far off as the best
# in all but a few per cent of the cases in which it is not far beyond any limit.
_CLEARLY = 1.5


@dataclass(frozen=True)
class PlaneFit:
    """A way to fit points. ``off_m(flat, places, used)``: how far each point (n,) is off when only
    those at the indices ``used`` are fitted; None = these tell nothing. ``rms_max_m``: of the
    points used. ``rigid``: only the camera's place is free, so that a wrong point cannot be made up
    for by a wrong plane."""

    off_m: Callable[[F64, F64, NDArray[np.intp]], F64 | None]
    rms_max_m: float
    rigid: bool

    def good(self, off_m: F64) -> bool:
        """Whether points that are so far off fit each other."""
        return bool(_rms(off_m) <= self.rms_max_m and off_m.max() <= OUTLIER_M)


@dataclass(frozen=True)
class _Without:
    left_out: int
    used: NDArray[np.intp]
    rms_m: float
    good: bool


def used_points(flat: F64, places: F64, names: list[str], fit: PlaneFit) -> NDArray[np.intp]:
    """Indices of the points that fit each other, all but at most a third; all when there is no such
    set or there are fewer than six. Raises InputError when it cannot be told which point is wrong.

    Leaves out one after the other the point without which the rest fits best."""
    everything = np.arange(len(flat))
    used = everything
    while max(_LEFT_MIN, len(flat) * 2 / 3) <= len(used) - 1 and len(flat) >= LEAVE_OUT_FROM:
        off = fit.off_m(flat, places, used)
        if off is None or fit.good(off[used]):
            return used
        ways = _ways(flat, places, used, fit)
        if not ways:
            return everything
        _check_unambiguous(ways, names, fit)
        used = ways[0].used
    off = fit.off_m(flat, places, used)
    return used if off is not None and fit.good(off[used]) else everything


def suspects(flat: F64, places: F64, fit: PlaneFit) -> list[int]:
    """Points without any one of which the others would fit; with fewer than five none, for four
    tell too little."""
    if len(flat) < _LEFT_MIN:
        return []
    return [way.left_out for way in _ways(flat, places, np.arange(len(flat)), fit) if way.good]


def _ways(flat: F64, places: F64, used: NDArray[np.intp], fit: PlaneFit) -> list[_Without]:
    """To leave out one more, the best first."""
    ways = []
    for i in used:
        rest = used[used != i]
        off = fit.off_m(flat, places, rest)
        if off is None:
            continue
        good = fit.good(off[rest]) and bool(off[i] > OUTLIER_M)
        ways.append(_Without(int(i), rest, _rms(off[rest]), good))
    return sorted(ways, key=lambda way: way.rms_m)


def _check_unambiguous(ways: list[_Without], names: list[str], fit: PlaneFit) -> None:
    near = [way for way in ways if way.good]
    if fit.rigid and near:
        near = [way for way in near if way.rms_m < _CLEARLY * ways[0].rms_m or way is ways[0]]
    if len(near) < 2:
        return
    blamed = " or ".join(names[way.left_out] for way in near)
    board = "; pictures of the board (--board) help to tell, and a lens that bends lines needs them"
    raise InputError(
        f"the tank's points do not fit each other. The wrong one is unknown: {blamed} "
        f"(without either the others fit within {OUTLIER_M * 1e3:.0f} mm)",
        f"Measure these anew, or more points{'' if fit.rigid else board}.",
    )


RMS_MAX_M = 0.02
_SPREAD_MIN = 0.01  # of the equations for a homography, smallest over largest singular value
# True points measured within 2 mm and found within 0.2 pixels are up to 6 mm off, with a focal
# length 2 % off and the camera tilted by 0.4 rad; one of six that is 50 mm wrong makes it 10 mm.
POSE_RMS_MAX_M = 0.01
_POSE_OVER_PLANE = 1.5  # of points measured less well
_SPAN_M_PX_MAX, _HEIGHT_MAX_M = 0.05, 20.0
_RIGHT = "x goes along the swimming direction, y to the right of it (seen from above)."


@dataclass(frozen=True)
class Plane:
    """``tank_from_image`` (3, 3): undistorted pixels to metres in the plane of the points.
    ``off_m``: how far each point used is off. ``left_out``: index of a point that does not fit the
    others -> how far off it is. ``predicted_m``: the worst error with which the others predict a
    point; None with four, which always fit."""

    tank_from_image: F64
    off_m: F64
    left_out: dict[int, float]
    predicted_m: float | None

    @property
    def rms_m(self) -> float:
        """How far the points used are off, root mean square."""
        return _rms(self.off_m)


def fit_plane(
    lens: Lens, pixels: F64, places_m: F64, names: list[str], known_camera: bool = False
) -> Plane:
    """Least squares over at least four points: ``pixels`` (n, 2) of the distorted picture,
    ``places_m`` (n, 2). With six or more, single wrong ones are left out; with ``known_camera``
    (``lens`` is from pictures of the board) those without which the camera's place fits best.
    Raises InputError: points on a line, seen in a mirror, not in metres, not fitting each other."""
    flat = lens.undistorted(pixels)
    _check_spread(flat, places_m)
    _check_metres(flat, places_m, lens if known_camera else None)
    fit = _fit(lens if known_camera else None)
    used = used_points(flat, places_m, names, fit)
    _check_spread(flat[used], places_m[used])
    matrix = _homography(flat[used], places_m[used])
    off = np.linalg.norm(mapped(matrix, flat) - places_m, axis=1)
    left_out = {int(i): float(off[i]) for i in np.setdiff1d(np.arange(len(flat)), used)}
    plane = Plane(matrix, off[used], left_out, _predicted(flat[used], places_m[used]))
    _check_seen_from_above(matrix, flat)
    _check_fit(plane, [names[i] for i in used])
    return plane


@dataclass(frozen=True)
class CameraPlace:
    """Where the camera is: above the plane of the points, over ``foot_m`` (2,) of the tank.
    ``rms_m``: how far the points are off when only the camera's place may be chosen."""

    height_m: float
    foot_m: F64
    rms_m: float


def camera_place(
    lens: Lens, plane: Plane, pixels: F64, places_m: F64, names: list[str]
) -> CameraPlace:
    """From the points used in ``plane`` and the camera's intrinsics. Raises InputError when these
    do not belong together."""
    used = np.setdiff1d(np.arange(len(pixels)), list(plane.left_out))
    flat, places = lens.undistorted(pixels[used]), places_m[used]
    rotation, shift = _pose(lens, flat, places)
    off = np.linalg.norm(mapped(_seen_by(lens, rotation, shift), flat) - places, axis=1)
    rms = _rms(off)
    centre = np.asarray(-rotation.T @ shift)  # z of a frame with x forward, y to the right is down
    if not rms <= max(POSE_RMS_MAX_M, _POSE_OVER_PLANE * plane.rms_m) or centre[2] >= 0:
        wrong = [names[used[i]] for i in suspects(flat, places, _fit(lens))]
        _refuse_pose(rms, plane.rms_m, wrong)
    return CameraPlace(float(-centre[2]), np.asarray(centre[:2]), rms)


def _refuse_pose(rms_m: float, plane_rms_m: float, wrong: list[str]) -> None:
    compared = (
        f"with the camera's intrinsics the tank's points are {rms_m * 1e3:.0f} mm off, without "
        f"them {plane_rms_m * 1e3:.0f} mm: "
    )
    if wrong:
        raise InputError(
            f"{compared}{' or '.join(wrong)} is wrong (without it the others fit)",
            "Measure it anew, or more points: from six on a wrong one is left out.",
        )
    raise InputError(
        f"{compared}the pictures of the board are of another camera, zoom or setting, or points "
        "are wrong",
        "Take the pictures of the board with the camera in its place over the tank. Check what was "
        "measured and typed.",
    )


def _pose(lens: Lens, flat: F64, places: F64) -> tuple[F64, F64]:
    """Rotation (3, 3) and shift (3,) from the tank's frame to the camera's."""
    solid, matrix = np.column_stack([places, np.zeros(len(places))]), lens.camera_matrix
    good, turn, shift = cv2.solvePnP(solid, flat, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    if good:
        turn, shift = cv2.solvePnPRefineLM(solid, flat, matrix, None, turn, shift)
    return np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift)


def _seen_by(lens: Lens, rotation: F64, shift: F64) -> F64:
    """Undistorted pixels to the tank, for a camera at that place."""
    from_tank = lens.camera_matrix @ np.column_stack([rotation[:, :2], shift])
    return np.asarray(np.linalg.inv(from_tank), dtype=np.float64)


def _fit(lens: Lens | None) -> PlaneFit:
    """With the camera's intrinsics only its place is free, without them any homography."""

    def off_m(flat: F64, places: F64, used: NDArray[np.intp]) -> F64 | None:
        if _spread(flat[used], places[used]) < _SPREAD_MIN:
            return None
        if lens is None:
            matrix = _homography(flat[used], places[used])
        else:
            matrix = _seen_by(lens, *_pose(lens, flat[used], places[used]))
        return np.asarray(np.linalg.norm(mapped(matrix, flat) - places, axis=1))

    return PlaneFit(off_m, RMS_MAX_M if lens is None else POSE_RMS_MAX_M, lens is not None)


def raised(tank_from_image: F64, camera: CameraPlace, raise_m: float) -> F64:
    """The homography of the parallel plane ``raise_m`` above. Raises InputError when the camera
    would be in it.

    A ray from the camera to a place in the lower plane goes through the upper one nearer to the
    camera's foot, by the ratio of the heights."""
    share = 1 - raise_m / camera.height_m
    if not 0.02 < share < 50:
        raise InputError(
            f"the camera is {camera.height_m:.2f} m above the points: a plane {raise_m:.2f} m "
            "above them cannot be",
            "Heights are metres; above the points is positive.",
        )
    x, y = camera.foot_m
    shrink = np.array([[share, 0, (1 - share) * x], [0, share, (1 - share) * y], [0, 0, 1.0]])
    moved: F64 = shrink @ tank_from_image
    return moved


def _predicted(flat: F64, places: F64) -> float | None:
    if len(flat) <= 4:
        return None
    worst = 0.0
    for i in range(len(flat)):
        rest = np.delete(np.arange(len(flat)), i)
        if _spread(flat[rest], places[rest]) < _SPREAD_MIN:
            continue
        matrix = _homography(flat[rest], places[rest])
        off = mapped(matrix, flat[i : i + 1])[0] - places[i]
        worst = max(worst, float(np.hypot(*off)))
    return worst or None


def _rms(off_m: F64) -> float:
    """Root mean square; infinite for points that do not fit each other at all."""
    rms = float(np.sqrt(np.mean(off_m**2)))
    return rms if np.isfinite(rms) else np.inf


def _homography(flat: F64, places: F64) -> F64:
    found, _ = cv2.findHomography(flat, places, 0)
    if found is None:
        raise InputError("no plane fits the tank's points", "Check them.")
    matrix: F64 = found
    return matrix


def _check_spread(flat: F64, places: F64) -> None:
    if not _spread(flat, places) >= _SPREAD_MIN:
        raise InputError(
            "the tank's points do not tell a plane: too many of them lie on one line or in one "
            "place",
            "Four corners of a rectangle as large as the tank do best.",
        )


def _spread(flat: F64, places: F64) -> float:
    """How well the points determine a homography: 0 = not at all."""
    (u, v), (x, y) = _normal(flat).T, _normal(places).T
    one, nil = np.ones(len(u)), np.zeros(len(u))
    across = np.column_stack([u, v, one, nil, nil, nil, -x * u, -x * v, -x])
    down = np.column_stack([nil, nil, nil, u, v, one, -y * u, -y * v, -y])
    values = np.linalg.svd(np.concatenate([across, down]), compute_uv=False)
    return float(values[7] / values[0])


def _normal(points: F64) -> F64:
    centred: F64 = points - points.mean(axis=0)
    return centred / (float(np.sqrt((centred**2).mean())) or 1.0)


def _check_metres(flat: F64, places: F64, lens: Lens | None) -> None:
    """By the distances between all pairs, of which one wrong point changes few."""
    first, second = np.triu_indices(len(flat), 1)
    metres = np.linalg.norm(places[first] - places[second], axis=1)
    pixels = np.linalg.norm(flat[first] - flat[second], axis=1)
    m_px = float(np.median(metres / np.maximum(pixels, 1e-9)))
    height_m = m_px * float(lens.focal_px.mean()) if lens is not None else 0.0
    if m_px <= _SPAN_M_PX_MAX and height_m <= _HEIGHT_MAX_M:
        return
    above = f", the camera about {height_m:.0f} m above them" if lens is not None else ""
    raise InputError(
        f"by the tank's points (--points) a pixel would be {m_px * 1e3:.0f} mm{above}: are they in "
        "metres, not centimetres?",
        f"x_m and y_m are metres; up to {_SPAN_M_PX_MAX * 1e3:.0f} mm a pixel and "
        f"{_HEIGHT_MAX_M:.0f} m of height can be.",
    )


def _check_seen_from_above(matrix: F64, flat: F64) -> None:
    depth = np.column_stack([flat, np.ones(len(flat))]) @ matrix[2]
    if not (np.linalg.det(matrix) * depth > 0).all():
        raise InputError(
            "the tank's points are mirrored. x and y are swapped, y is counted to the "
            "left, or two points are swapped",
            _RIGHT,
        )


def _check_fit(plane: Plane, names: list[str]) -> None:
    if not plane.rms_m <= RMS_MAX_M:
        worst = int(np.argmax(plane.off_m))
        raise InputError(
            f"the tank's points do not fit each other: {plane.rms_m * 1e3:.0f} mm off (RMS), "
            f"worst {names[worst]}, {plane.off_m[worst] * 1e3:.0f} mm",
            "Check what was measured and typed; a wide-angle lens needs --board PICTURES, too.",
        )
