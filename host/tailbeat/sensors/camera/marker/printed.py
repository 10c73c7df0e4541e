"""The markers and the board that are printed, and finding them in pictures."""

from __future__ import annotations

from typing import Any

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import ANCHOR_ID_MIN
from tailbeat.sensors.camera.opencv import cv2, require_cv2
from tailbeat.sensors.camera.source.picture import Image

RULER_IDS = (30, 31)  # of ArUco DICT_4X4_50
ANCHOR_IDS = (40, 41, 42, 43)
BOARD_SQUARES = (6, 8)  # columns, rows
BOARD_MARKER = 0.75  # side of a board's marker over that of its square


def board(square_m: float = 1.0) -> Any:
    """The ChArUco board (cv2.aruco.CharucoBoard). Its markers are of another dictionary than
    those at the tank, so that neither is taken for the other."""
    aruco = cv2.aruco
    words = aruco.getPredefinedDictionary(aruco.DICT_5X5_100)
    return aruco.CharucoBoard(BOARD_SQUARES, square_m, square_m * BOARD_MARKER, words)


def anchors_of(markers: dict[int, tuple[float, float]]) -> dict[int, tuple[float, float]]:
    """Those that are fixed at the tank."""
    return {i: place for i, place in markers.items() if i >= ANCHOR_ID_MIN}


def find_markers(grey: Image, name: str) -> dict[int, tuple[float, float]]:
    """ArUco DICT_4X4_50 markers in a picture: id -> centre in pixels. Raises InputError when two
    have the same id."""
    require_cv2()
    from tailbeat.sensors.camera.marker.tags import TagReader, centre_of

    found: dict[int, tuple[float, float]] = {}
    for tag in TagReader("aruco").read(grey, wanted=lambda tag: False):  # the thorough search
        if tag.id in found:
            raise InputError(
                f"{name} shows marker {tag.id} twice",
                "Each id once: cover one of them, or print another.",
            )
        found[tag.id] = centre_of(tag.square)
    return found
