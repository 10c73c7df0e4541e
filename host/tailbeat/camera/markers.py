"""The three ways to see the fish: ArUco, AprilTag, and a blob that moves before a still background."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tailbeat.camera.sighting import Detector

MarkerKind = Literal["aruco", "apriltag", "blob"]
KINDS: tuple[MarkerKind, ...] = ("aruco", "apriltag", "blob")


@dataclass(frozen=True, slots=True)
class Marker:
    """What is on the fish. aruco = DICT_4X4_50, apriltag = 36h11. ``side_m``: of the printed black
    square; None = not known, then its size is not checked. ``id`` None = any, as long as there is
    only one beside the tank's anchors (ids ANCHOR_ID_MIN and up, calibration.py)."""

    kind: MarkerKind = "aruco"
    id: int | None = None
    side_m: float | None = None


def detector_for(marker: Marker) -> Detector:
    """The detector of that kind. Raises InputError for ids the dictionary does not have."""
    raise NotImplementedError
