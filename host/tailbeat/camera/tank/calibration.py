"""From pixels to metres in the tank: one file, made by ``tailbeat camera calibrate``."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.tank.lens import Lens
from tailbeat.errors import InputError, reason
from tailbeat.lasting import write_whole

Floats = NDArray[np.float64]

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
    camera_matrix: Floats
    distortion: Floats
    tank_from_image: Floats
    area_m: Floats | None = None
    anchors: dict[int, tuple[float, float]] = field(default_factory=dict)
    scale_error: float | None = None
    rms_px: float | None = None
    plane_rms_m: float | None = None
    plane: str = ""
    camera: str = ""
    made_at: str = ""

    def to_tank(self, points_px: Floats) -> Floats:
        """Pixels (n, 2) of the distorted picture to metres (n, 2)."""
        flat = self.lens.undistorted(points_px)
        return _mapped(self._to_tank, flat)

    def to_pixels(self, points_m: Floats) -> Floats:
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
    def _to_tank(self) -> Floats:
        matrix = np.asarray(self.tank_from_image, dtype=np.float64)
        middle = (self.size_px[0] / 2, self.size_px[1] / 2, 1.0)
        return np.ascontiguousarray(matrix / (matrix[2] @ middle))

    @cached_property
    def _to_rays(self) -> Floats:
        """From the tank to directions x, y, 1 in the camera's frame, times their depth, which is
        near 1 in the middle of the picture."""
        to_image = np.linalg.inv(self._to_tank)
        rays: Floats = np.linalg.inv(np.asarray(self.camera_matrix, dtype=np.float64)) @ to_image
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
        from tailbeat.camera.tank.calibrationcheck import check_sense

        check_sense(self, "this calibration")
        write_whole(path, json.dumps(_document(self), indent=1, allow_nan=False) + "\n")


def load_calibration(path: Path) -> Calibration:
    """Reads a file of ``save``. Raises InputError when it is none or makes no sense."""
    from tailbeat.camera.tank.calibrationcheck import check_sense

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


def _array(raw: dict[str, Any], name: str, shape: tuple[int, ...]) -> Floats:
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


def _mapped(homography: Floats, points: Floats) -> Floats:
    if not len(points):
        return np.empty((0, 2))
    found: Floats = need_cv2().perspectiveTransform(points.reshape(-1, 1, 2), homography)
    return found.reshape(-1, 2)


def _size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
