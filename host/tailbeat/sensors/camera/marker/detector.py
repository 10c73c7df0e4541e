"""The kinds of marker on a fish: printed tags, and a blob moving before a still background."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import cv2, require_cv2
from tailbeat.sensors.camera.calibration.file import ANCHOR_ID_MIN, Calibration
from tailbeat.sensors.camera.marker.blob import BlobDetector
from tailbeat.sensors.camera.marker.tags import TAGS, Detector, TagDetector, TagFamily, TagKind

MarkerKind = Literal[TagKind, "blob"]
_BODY_WIDTH_M = 0.09  # of the thesis's fish; half and double are taken as well
_SIDE_MAX_M = 1.0


@dataclass(frozen=True, slots=True)
class Marker:
    """What is on the fish. aruco = DICT_4X4_50, apriltag = 36h11. ``side_m``: of the printed black
    square, or the width of the body of a blob; None = not known, then its size is not checked (a
    blob's never is, it only tells what to look for). ``id`` None = any, as long as there is
    only one beside the tank's anchors (ids ANCHOR_ID_MIN and up, tank/calibration.py)."""

    kind: MarkerKind = "aruco"
    id: int | None = None
    side_m: float | None = None


def detector_for(marker: Marker, calibration: Calibration | None = None) -> Detector:
    """The detector of that kind; a blob's knows from ``calibration`` where the water is and how big
    the fish appears. Raises InputError for ids the dictionary does not have or that are the tank's,
    sizes that are none, and without OpenCV."""
    require_cv2()
    if marker.side_m is not None and not 0 < marker.side_m < _SIDE_MAX_M:
        raise InputError(
            f"a marker {marker.side_m * 1000:g} mm wide makes no sense",
            "Give the length of the printed black square's side: --marker-side, in metres.",
        )
    return MARKERS[marker.kind].make(marker, calibration)


def _tag_detector(marker: Marker, calibration: Calibration | None) -> Detector:
    family = TAGS[cast(TagKind, marker.kind)]
    _check_id(marker.id, family)

    def belongs(number: int) -> bool:
        if marker.id is not None:
            return number == marker.id
        return not family.shared or number < ANCHOR_ID_MIN

    return TagDetector(cast(TagKind, marker.kind), belongs)


def _check_id(number: int | None, family: TagFamily) -> None:
    if number is None or 0 <= number < family.detected_ids:
        return
    tank = f" (from {ANCHOR_ID_MIN} on they are the tank's)" if family.shared else ""
    raise InputError(
        f"there is no marker {number}: {family.fish_markers} have the ids 0 to "
        f"{family.detected_ids - 1}{tank}",
        "Print one of those, or leave the id away when there is only one marker in the water.",
    )


def _blob_detector(marker: Marker, calibration: Calibration | None) -> Detector:
    if calibration is None:
        return BlobDetector()

    middle_px = np.array(calibration.size_px) / 2
    places = calibration.to_tank(middle_px + np.array([[0.0, 0.0], [1.0, 0.0]]))
    metres_per_px = float(np.linalg.norm(places[1] - places[0]))
    water = None
    if calibration.area_m is not None:
        water = np.zeros(calibration.size_px[::-1], np.uint8)
        outline = np.rint(calibration.to_pixels(calibration.area_m)).astype(np.int32)
        cv2.fillPoly(water, [outline], (255,))
    return BlobDetector((marker.side_m or _BODY_WIDTH_M) / metres_per_px, water)


@dataclass(frozen=True, slots=True)
class MarkerType:
    """How a kind of marker is detected. ``family`` None = nothing is printed. ``whole_image``: the
    detector must see each whole image, and it can mistake the tail for the head."""

    make: Callable[[Marker, Calibration | None], Detector]
    family: TagFamily | None = None
    whole_image: bool = False


# Every kind of marker on a fish; the names are those of --marker.
MARKERS: dict[MarkerKind, MarkerType] = {
    **{kind: MarkerType(_tag_detector, family) for kind, family in TAGS.items()},
    "blob": MarkerType(_blob_detector, whole_image=True),
}
KINDS: tuple[MarkerKind, ...] = tuple(MARKERS)
