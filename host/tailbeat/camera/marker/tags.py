"""Printed markers: ArUco and AprilTag, found and decoded by OpenCV, measured by edges.py.

The marker is glued with its top towards the fish's head: the top of what OpenCV draws
(cv2.aruco.generateImageMarker). For AprilTags pupil-apriltags, with AprilRobotics' own code inside,
calls the other end the top (measured): with a tag that was not drawn by OpenCV look at the heading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from tailbeat.camera.marker.edges import Square, fit_square
from tailbeat.camera.marker.sighting import Points, Sighting, Window
from tailbeat.camera.pictures.picture import Image

TagKind = Literal["aruco", "apriltag"]

_DICTIONARY = {"aruco": cv2.aruco.DICT_4X4_50, "apriltag": cv2.aruco.DICT_APRILTAG_36h11}
CELLS = {"aruco": 6, "apriltag": 8}  # along a side, black border included

_SIDE_MIN_PX = 10  # smaller ones are never decoded
_SMALL_WINDOW_PX = 400  # up to there a window is doubled before it is searched
_DEEP_EVERY = 10  # fruitless searches of the whole picture

# Quality 1 needs all of these; see quality().
_CELL_GOOD_PX, _CELL_BAD_PX = 4.0, 1.5
_CONTRAST_GOOD = 80.0
_RESIDUAL_BAD_PX = 0.4


@dataclass(frozen=True, slots=True)
class Tag:
    """One marker that was decoded: its number and its black square."""

    id: int
    square: Square


class TagReader:
    """Reads all markers of one kind.

    The whole picture is searched as it is; when that finds nothing wanted, the first and every
    tenth time at double size as well (four times the time): markers under 20 pixels or a little
    out of focus are decoded only so. Windows up to 400 pixels are always doubled.
    """

    def __init__(self, kind: TagKind) -> None:
        self._dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY[kind])
        self._cells = CELLS[kind]
        self._fruitless = 0

    def read(
        self,
        grey: Image,
        window: Window | None = None,
        wanted: Callable[[Tag], bool] = lambda tag: True,
    ) -> list[Tag]:
        """All markers in ``grey`` or its ``window``; searches harder when none is ``wanted``."""
        if window is not None:
            small = max(window.right - window.left, window.bottom - window.top)
            return self._read(grey, window, 2 if small <= _SMALL_WINDOW_PX else 1)
        whole = Window(0, 0, grey.shape[1], grey.shape[0])
        tags = self._read(grey, whole, 1)
        if any(wanted(tag) for tag in tags):
            self._fruitless = 0
            return tags
        self._fruitless += 1
        return tags if self._fruitless % _DEEP_EVERY != 1 else self._read(grey, whole, 2)

    def _read(self, grey: Image, window: Window, zoom: int) -> list[Tag]:
        part = grey[window.top : window.bottom, window.left : window.right]
        if min(part.shape) < _SIDE_MIN_PX:
            return []
        if zoom != 1:
            part = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)  # type: ignore[assignment]
        found, ids, _ = self._detector(max(part.shape), zoom).detectMarkers(part)
        if not found:
            return []
        shift = np.array([window.left, window.top], float)
        guesses = [(np.asarray(f[0], float) + 0.5) / zoom - 0.5 + shift for f in found]
        squares = [fit_square(grey, guess, self._cells) for guess in guesses]
        return [Tag(int(i), s) for i, s in zip(ids.ravel(), squares, strict=True) if s is not None]

    def _detector(self, longest_px: int, zoom: int) -> cv2.aruco.ArucoDetector:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        parameters.minMarkerPerimeterRate = 4 * _SIDE_MIN_PX * zoom / longest_px
        # At its default of 0.125 doubled ArUco markers of 60 pixels were missed in 7 of 60 pictures
        # (12 of 60 with blur 1 px and noise 4), at 0.02 in none.
        parameters.minMarkerDistanceRate = 0.02
        return cv2.aruco.ArucoDetector(self._dictionary, parameters)


class TagDetector:
    """Finds the fish's marker (sighting.Detector). ``belongs``: which ids can be the fish's."""

    def __init__(self, kind: TagKind, belongs: Callable[[int], bool]) -> None:
        self._reader = TagReader(kind)
        self._cells = CELLS[kind]
        self._belongs = belongs
        self.other_ids: set[int] = set()  # of this kind, seen but not the fish's

    def find(self, grey: Image, window: Window | None = None) -> list[Sighting]:
        """All of the fish's markers, best first."""
        tags = self._reader.read(grey, window, lambda tag: self._belongs(tag.id))
        self.other_ids.update(tag.id for tag in tags if not self._belongs(tag.id))
        mine = [sighting_of(tag.square, self._cells) for tag in tags if self._belongs(tag.id)]
        return _once(sorted(mine, key=lambda sighting: -sighting.quality))


def sighting_of(square: Square, cells: int) -> Sighting:
    """The square as a sighting; its front edge is between the first two corners."""
    corners = square.corners
    side_px = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())
    centre, front = _middles(corners)
    return Sighting(centre, front, side_px, quality(square, side_px / cells), corners)


def centre_of(square: Square) -> tuple[float, float]:
    """The picture of the square's centre, in pixels."""
    return _middles(square.corners)[0]


def quality(square: Square, cell_px: float) -> float:
    """1 = as sharp as can be, 0 = hardly believable; the product of three:

    size: 0 where a cell is 1.5 pixels wide, 1 from 4 pixels; contrast: rise from black to white
    over 80 grey levels, at most 1; straightness: 1 / (1 + (RMS residual of the sides / 0.4 px)^2).
    """
    size = np.clip((cell_px - _CELL_BAD_PX) / (_CELL_GOOD_PX - _CELL_BAD_PX), 0, 1)
    contrast = np.clip(square.contrast / _CONTRAST_GOOD, 0, 1)
    straight = 1 / (1 + (square.residual_px / _RESIDUAL_BAD_PX) ** 2)
    return float(size * contrast * straight)


def _middles(corners: Points) -> tuple[tuple[float, float], tuple[float, float]]:
    """The pictures of the square's centre and of the middle of its front edge."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    # Around their mean the corners keep their precision in the float32 that OpenCV wants.
    around = corners.mean(axis=0)
    to_picture = cv2.getPerspectiveTransform(square, (corners - around).astype(np.float32))
    pictures = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 1.0]]) @ to_picture.T
    centre, front = pictures[:, :2] / pictures[:, 2:] + around
    return (float(centre[0]), float(centre[1])), (float(front[0]), float(front[1]))


def _once(sightings: list[Sighting]) -> list[Sighting]:
    """Without those that lie on a better one."""
    kept: list[Sighting] = []
    for one in sightings:
        if all(_apart(one, other) > max(one.side_px, other.side_px) / 2 for other in kept):
            kept.append(one)
    return kept


def _apart(one: Sighting, other: Sighting) -> float:
    return float(np.hypot(*np.subtract(one.centre_px, other.centre_px)))
