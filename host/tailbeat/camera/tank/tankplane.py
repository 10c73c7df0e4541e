"""The plane of known points in the tank, and from it the plane in which the marker moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.tank.lens import Lens
from tailbeat.errors import InputError

Floats = NDArray[np.float64]

WATER = 1.33  # refractive index
RANSAC_FROM = 6
OUTLIER_M = 0.02
RMS_MAX_M = 0.02
_SPREAD_MIN = 0.01  # of the equations for a homography, smallest over largest singular value
_POSE_OFF_MAX_M = 0.03
_RIGHT = "x goes along the swim, y to the right of it (seen from above)."


@dataclass(frozen=True)
class Plane:
    """``tank_from_image`` (3, 3): undistorted pixels to metres in the plane of the points.
    ``off_m``: how far each point used is off. ``left_out``: index of a point that does not fit the
    others -> how far off it is. ``foretold_m``: the worst error with which the others foretell a
    point; None with four, which always fit."""

    tank_from_image: Floats
    off_m: Floats
    left_out: dict[int, float]
    foretold_m: float | None

    @property
    def rms_m(self) -> float:
        """How far the points used are off, root mean square."""
        return float(np.sqrt(np.mean(self.off_m**2)))


def fit_plane(lens: Lens, pixels: Floats, places_m: Floats, names: list[str]) -> Plane:
    """Least squares over at least four points: ``pixels`` (n, 2) of the distorted picture,
    ``places_m`` (n, 2). With six or more, single wrong ones are left out. Raises InputError: points
    on a line, seen in a mirror, or not fitting each other."""
    flat = lens.undistorted(pixels)
    _check_spread(flat, places_m)
    used = _inliers(flat, places_m)
    _check_spread(flat[used], places_m[used])
    matrix = _homography(flat[used], places_m[used])
    off = np.linalg.norm(_mapped(matrix, flat) - places_m, axis=1)
    left_out = {int(i): float(off[i]) for i in np.flatnonzero(~used)}
    plane = Plane(matrix, off[used], left_out, _foretold(flat[used], places_m[used]))
    _check_seen_from_above(matrix, flat)
    _check_fit(plane, [name for name, good in zip(names, used, strict=True) if good])
    return plane


@dataclass(frozen=True)
class CameraPlace:
    """Where the camera is: above the plane of the points, over ``foot_m`` (2,) of the tank.
    ``rms_m``: how far the points are off when only the camera's place may be chosen."""

    height_m: float
    foot_m: Floats
    rms_m: float


def camera_place(lens: Lens, plane: Plane, pixels: Floats, places_m: Floats) -> CameraPlace:
    """From the points used in ``plane`` and the camera's intrinsics. Raises InputError when these
    do not belong together."""
    cv2: Any = need_cv2()
    used = np.setdiff1d(np.arange(len(pixels)), list(plane.left_out))
    flat, places = lens.undistorted(pixels[used]), places_m[used]
    solid = np.column_stack([places, np.zeros(len(places))])
    good, turn, shift = cv2.solvePnP(solid, flat, lens.camera_matrix, None, flags=cv2.SOLVEPNP_IPPE)
    if good:
        turn, shift = cv2.solvePnPRefineLM(solid, flat, lens.camera_matrix, None, turn, shift)
    rotation = cv2.Rodrigues(turn)[0]
    matrix = np.linalg.inv(lens.camera_matrix @ np.column_stack([rotation[:, :2], shift]))
    off = np.linalg.norm(_mapped(matrix, flat) - places, axis=1)
    rms = float(np.sqrt(np.mean(off**2)))
    centre = -rotation.T @ shift.ravel()  # z of a frame with x forward, y to the right is down
    if not rms <= max(_POSE_OFF_MAX_M, 3 * plane.rms_m) or centre[2] >= 0:
        raise InputError(
            f"with the camera's intrinsics the tank's points are {rms * 1e3:.0f} mm off, without "
            f"them {plane.rms_m * 1e3:.0f} mm: the pictures of the board are of another camera, "
            "zoom or setting, or points are wrong",
            "Take the pictures of the board with the camera as it hangs over the tank.",
        )
    return CameraPlace(float(-centre[2]), np.asarray(centre[:2]), rms)


def raised(tank_from_image: Floats, camera: CameraPlace, raise_m: float) -> Floats:
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
    moved: Floats = shrink @ tank_from_image
    return moved


def refraction_error_m(height_m: float, depth_m: float, distance_m: float) -> float:
    """What taking a marker to be depth/1.33 under the water's surface, as it looks from straight
    above, puts it off at ``distance_m`` from the camera's foot. By Snell's law; positive = too far
    from the foot. ``height_m``: of the camera over the surface."""
    from scipy.optimize import brentq

    def out_m(surface_m: float) -> float:
        sine = surface_m / np.hypot(surface_m, height_m) / WATER
        return float(surface_m + depth_m * sine / np.sqrt(1 - sine**2))

    if distance_m <= 0 or depth_m <= 0:
        return 0.0
    surface_m = brentq(lambda s: out_m(s) - distance_m, 0.0, distance_m)
    return float(surface_m * (1 + depth_m / WATER / height_m) - distance_m)


def _inliers(flat: Floats, places: Floats) -> NDArray[np.bool_]:
    everything = np.ones(len(flat), dtype=bool)
    if len(flat) < RANSAC_FROM:
        return everything
    cv2 = need_cv2()
    _, mask = cv2.findHomography(flat, places, cv2.RANSAC, OUTLIER_M, maxIters=2000)
    used = np.ravel(mask).astype(bool) if mask is not None else ~everything
    if used.sum() < max(RANSAC_FROM - 1, 2 * len(flat) / 3):
        return everything  # most are wrong: their rms says so
    return used


def _foretold(flat: Floats, places: Floats) -> float | None:
    if len(flat) <= 4:
        return None
    worst = 0.0
    for i in range(len(flat)):
        rest = np.delete(np.arange(len(flat)), i)
        if _spread(flat[rest], places[rest]) < _SPREAD_MIN:
            continue
        matrix = _homography(flat[rest], places[rest])
        off = _mapped(matrix, flat[i : i + 1])[0] - places[i]
        worst = max(worst, float(np.hypot(*off)))
    return worst or None


def _homography(flat: Floats, places: Floats) -> Floats:
    found, _ = need_cv2().findHomography(flat, places, 0)
    if found is None:
        raise InputError("no plane fits the tank's points", "Check them.")
    matrix: Floats = found
    return matrix


def _mapped(matrix: Floats, points: Floats) -> Floats:
    found: Floats = need_cv2().perspectiveTransform(points.reshape(-1, 1, 2), matrix)
    return found.reshape(-1, 2)


def _check_spread(flat: Floats, places: Floats) -> None:
    if not _spread(flat, places) >= _SPREAD_MIN:
        raise InputError(
            "the tank's points do not tell a plane: too many of them lie on one line or in one "
            "place",
            "Four corners of a rectangle as large as the tank do best.",
        )


def _spread(flat: Floats, places: Floats) -> float:
    """How well the points determine a homography: 0 = not at all."""
    u, v = _normal(flat).T
    x, y = _normal(places).T
    one, nil = np.ones(len(u)), np.zeros(len(u))
    rows = np.concatenate(
        [
            np.column_stack([u, v, one, nil, nil, nil, -x * u, -x * v, -x]),
            np.column_stack([nil, nil, nil, u, v, one, -y * u, -y * v, -y]),
        ]
    )
    values = np.linalg.svd(rows, compute_uv=False)
    return float(values[7] / values[0])


def _normal(points: Floats) -> Floats:
    centred = points - points.mean(axis=0)
    size = np.sqrt((centred**2).mean())
    scaled: Floats = centred / size if size > 0 else centred
    return scaled


def _check_seen_from_above(matrix: Floats, flat: Floats) -> None:
    depth = np.column_stack([flat, np.ones(len(flat))]) @ matrix[2]
    if not (np.linalg.det(matrix) * depth > 0).all():
        raise InputError(
            "the tank's points are seen in a mirror: x and y are swapped, y is counted to the "
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
