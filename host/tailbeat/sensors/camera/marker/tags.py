"""Printed markers (ArUco, AprilTag, the ChArUco board) and where they are in a picture.

OpenCV finds and decodes them. A marker's black square is measured by a robust straight line
through each of its sides.

Every side is crossed by 24 short profiles. The middle of a profile's rise from black to white is a
point of the side; a line that does not mind a few bad points goes through all of a side, and lines
meet in corners. Centre of a 25 pixel marker on pictures of known truth (tests/host/test_markers.py
draws them; noise 2 of 255, blur 0.6 px), RMS over 150: this 0.02 px, OpenCV's CORNER_REFINE_CONTOUR
0.11, SUBPIX 0.23, NONE 0.34, APRILTAG 0.65 (most of that a shift of 0.45 px in u and in v).

The marker is glued with its top towards the fish's head: the top of what OpenCV draws
(cv2.aruco.generateImageMarker). For AprilTags pupil-apriltags, with AprilRobotics' own code inside,
calls the other end the top (measured): with a tag that was not drawn by OpenCV look at the heading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import cv2, require_cv2
from tailbeat.sensors.camera.calibration.file import ANCHOR_ID_MIN
from tailbeat.sensors.camera.source.picture import Image

RULER_IDS = (30, 31)  # of ArUco DICT_4X4_50
ANCHOR_IDS = (40, 41, 42, 43)
BOARD_SQUARES = (6, 8)  # columns, rows
BOARD_MARKER = 0.75  # side of a board's marker over that of its square

TagKind = Literal["aruco", "apriltag"]


@dataclass(frozen=True, slots=True)
class TagFamily:
    """One kind of printed marker.

    ``name_cv2``: its dictionary in cv2.aruco. ``cells``: along a side, black border included.
    ``shared``: the ruler and the tank use ids of this family, too."""

    name_cv2: str
    cells: int
    ids: int
    shared: bool
    name: str
    fish_markers: str  # in messages

    def dictionary(self) -> Any:
        """OpenCV's (cv2.aruco.Dictionary)."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.name_cv2))

    @property
    def detected_ids(self) -> int:
        """Ids below this one can be on the fish."""
        return ANCHOR_ID_MIN if self.shared else self.ids

    @property
    def printed_ids(self) -> int:
        """Ids below this one are printed for the fish."""
        return min(RULER_IDS) if self.shared else self.ids


# Every printed marker: detection, sheets and the rendered tank read this table.
TAGS: dict[TagKind, TagFamily] = {
    "aruco": TagFamily("DICT_4X4_50", 6, 50, True, "ArUco 4x4", "ArUco 4x4 markers for the fish"),
    "apriltag": TagFamily(
        "DICT_APRILTAG_36h11", 8, 587, False, "AprilTag 36h11", "AprilTags 36h11"
    ),
}


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
    found: dict[int, tuple[float, float]] = {}
    for tag in TagReader("aruco").read(grey, wanted=lambda tag: False):  # the thorough search
        if tag.id in found:
            raise InputError(
                f"{name} shows marker {tag.id} twice",
                "Each id once: cover one of them, or print another.",
            )
        found[tag.id] = centre_of(tag.square)
    return found


@dataclass(frozen=True, slots=True)
class Detection:
    """A marker, in pixels of the distorted picture: u to the right, v down, (0, 0) in the middle of
    the first pixel.

    ``front_px`` is the middle of the marker's front edge (the one towards the fish's head), the
    front end of a blob. ``corners_px`` has shape (4, 2), clockwise as printed, from the front left;
    None for blobs. ``side_px`` is the mean length of the marker's sides, a blob's width.
    ``quality``: 1 = as sharp as can be, 0 = hardly believable. ``turns``: how often so far the
    detector took the other end for the head; then all it said before was the wrong way round.
    """

    centre_px: tuple[float, float]
    front_px: tuple[float, float]
    side_px: float
    quality: float
    corners_px: F64 | None = None
    turns: int = 0


@dataclass(frozen=True, slots=True)
class SearchWindow:
    """Part of a picture: pixels left <= u < right, top <= v < bottom, inside the picture."""

    left: int
    top: int
    right: int
    bottom: int


class Detector(Protocol):
    """Finds the fish's marker. May keep state between pictures (a background)."""

    def find(self, grey: Image, window: SearchWindow | None = None) -> list[Detection]:
        """All markers of the wanted kind in ``grey``, shape (height, width), or in its ``window``;
        positions count in the whole picture. Best first; [] = none."""


_PROFILES = 24
_ALONG = np.linspace(-0.44, 0.44, _PROFILES)  # of a side's length; its ends belong to two sides
_STEP_PX = 0.25
_REACH_CELLS = 0.75  # stays inside the black border, one cell wide
_REACH_PX = (1.75, 4.0)  # a detector's corners are off by up to 1 px
_ROUNDS = 2
_NOISE_MIN = 0.25  # of a profile's steepest rise; less is noise
_RESIDUAL_MIN_PX = 0.02


@dataclass(frozen=True, slots=True)
class Square:
    """``corners`` as given, but exact. ``residual_px``: RMS distance of the sides' points from
    their lines. ``contrast``: median rise from black to white across the sides, grey levels."""

    corners: F64
    residual_px: float
    contrast: float


def fit_square(grey: Image, corners: F64, cells: int) -> Square | None:
    """The square whose corners, clockwise, are near ``corners`` (4, 2); ``cells`` of the marker
    along a side, border included. None when there is no square in ``grey`` there."""
    for _ in range(_ROUNDS):
        along = np.roll(corners, -1, axis=0) - corners
        length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
        outward = np.column_stack([along[:, 1], -along[:, 0]]) / length
        reach = float(np.clip(_REACH_CELLS * length.mean() / cells, *_REACH_PX))
        offset_px, weight, rise = _edges(grey, corners, along, outward, reach)
        ends, residual_px = _lines(offset_px, weight)
        first = corners + outward * ends[:, :1]
        moved = _meet(first, along + outward * (ends[:, 1:] - ends[:, :1]))
        if not np.all(np.isfinite(moved)) or np.max(np.abs(moved - corners)) > _REACH_PX[1]:
            return None
        corners = moved
    return Square(corners, residual_px, float(np.median(rise)))


def _edges(
    grey: Image, corners: F64, along: F64, outward: F64, reach_px: float
) -> tuple[F64, F64, F64]:
    """By profiles across the sides of a guessed square, arrays (4, profiles): how far outward the
    edge is (px), how clear it is (0 = there is none), and its rise in grey levels."""
    steps = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX)
    base = corners[:, None] + (0.5 + _ALONG)[None, :, None] * along[:, None]
    points = base[:, :, None] + steps[None, None, :, None] * outward[:, None, None]
    rise = np.diff(_sample(grey, points), axis=2)
    steepest = rise.max(axis=2, keepdims=True)
    clear = np.where(rise > _NOISE_MIN * steepest, rise, 0.0) ** 2
    weight = clear.sum(axis=2)
    middle = (steps[1:] + steps[:-1]) / 2
    offset_px = (clear * middle).sum(axis=2) / np.maximum(weight, 1e-9)
    # One glaring profile must not outweigh its side.
    return offset_px, np.minimum(weight, _middle(weight)), np.clip(rise, 0, None).sum(axis=2)


def _sample(grey: Image, points: F64) -> F64:
    low = np.floor(points.min(axis=(0, 1, 2))).astype(int) - 1
    high = np.ceil(points.max(axis=(0, 1, 2))).astype(int) + 2
    low, high = np.maximum(low, 0), np.minimum(high, grey.shape[::-1])
    if np.any(high <= low):
        return np.zeros(points.shape[:3])
    # Of bytes, remap gives whole grey levels only.
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    at = (points - low).astype(np.float32).reshape(4 * _PROFILES, -1, 2)
    values = cv2.remap(part, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float64).reshape(points.shape[:3])


def _lines(offset_px: F64, clear: F64) -> tuple[F64, float]:
    """Robust lines through each side's points: their offsets at both ends, (4, 2), and the points'
    residual."""
    weight = clear
    for _ in range(3):
        total = np.maximum(weight.sum(axis=1), 1e-9)
        x_mean = (weight * _ALONG).sum(axis=1) / total
        y_mean = (weight * offset_px).sum(axis=1) / total
        x = _ALONG - x_mean[:, None]
        y = offset_px - y_mean[:, None]
        slope = (weight * x * y).sum(axis=1) / np.maximum((weight * x * x).sum(axis=1), 1e-9)
        residual = y - slope[:, None] * x
        tolerance = 2 * np.maximum(1.48 * _middle(np.abs(residual)), _RESIDUAL_MIN_PX)
        weight = clear / (1 + (residual / tolerance) ** 2)
    ends = y_mean[:, None] + slope[:, None] * (np.array([-0.5, 0.5]) - x_mean[:, None])
    return ends, float(np.sqrt((weight * residual**2).sum() / max(weight.sum(), 1e-9)))


def _middle(values: F64) -> F64:
    """The median of each row, as a column; np.median takes 22 times as long for so few."""
    return np.asarray(np.sort(values, axis=1)[:, values.shape[1] // 2, None])


def _meet(points: F64, along: F64) -> F64:
    """Where each line meets the one before it."""
    before, direction = np.roll(points, 1, axis=0), np.roll(along, 1, axis=0)
    across = direction[:, 0] * along[:, 1] - direction[:, 1] * along[:, 0]
    gap = points - before
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / across
    return np.asarray(before + part[:, None] * direction)


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
        self._dictionary = TAGS[kind].dictionary()
        self._cells = TAGS[kind].cells
        self._fruitless = 0

    def read(
        self,
        grey: Image,
        window: SearchWindow | None = None,
        wanted: Callable[[Tag], bool] = lambda tag: True,
    ) -> list[Tag]:
        """All markers in ``grey`` or its ``window``; searches harder when none is ``wanted``."""
        if window is not None:
            small = max(window.right - window.left, window.bottom - window.top)
            return self._read(grey, window, 2 if small <= _SMALL_WINDOW_PX else 1)
        whole = SearchWindow(0, 0, grey.shape[1], grey.shape[0])
        tags = self._read(grey, whole, 1)
        if any(wanted(tag) for tag in tags):
            self._fruitless = 0
            return tags
        self._fruitless += 1
        return tags if self._fruitless % _DEEP_EVERY != 1 else self._read(grey, whole, 2)

    def _read(self, grey: Image, window: SearchWindow, zoom: int) -> list[Tag]:
        part = grey[window.top : window.bottom, window.left : window.right]
        if min(part.shape) < _SIDE_MIN_PX:
            return []
        if zoom != 1:
            part = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
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
    """Finds the fish's marker (tags.Detector). ``belongs``: which ids can be the fish's."""

    def __init__(self, kind: TagKind, belongs: Callable[[int], bool]) -> None:
        self._reader = TagReader(kind)
        self._cells = TAGS[kind].cells
        self._belongs = belongs
        self.other_ids: set[int] = set()  # of this kind, seen but not the fish's

    def find(self, grey: Image, window: SearchWindow | None = None) -> list[Detection]:
        """All of the fish's markers, best first."""
        tags = self._reader.read(grey, window, lambda tag: self._belongs(tag.id))
        self.other_ids.update(tag.id for tag in tags if not self._belongs(tag.id))
        mine = [detection_of(tag.square, self._cells) for tag in tags if self._belongs(tag.id)]
        return _once(sorted(mine, key=lambda detection: -detection.quality))


def detection_of(square: Square, cells: int) -> Detection:
    """The square as a detection; its front edge is between the first two corners."""
    corners = square.corners
    side_px = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())
    centre, front = _middles(corners)
    return Detection(centre, front, side_px, quality(square, side_px / cells), corners)


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


def _middles(corners: F64) -> tuple[tuple[float, float], tuple[float, float]]:
    """The pictures of the square's centre and of the middle of its front edge."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    # Around their mean the corners keep their precision in the float32 that OpenCV wants.
    around = corners.mean(axis=0)
    to_picture = cv2.getPerspectiveTransform(square, (corners - around).astype(np.float32))
    pictures = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 1.0]]) @ to_picture.T
    centre, front = pictures[:, :2] / pictures[:, 2:] + around
    return (float(centre[0]), float(centre[1])), (float(front[0]), float(front[1]))


def _once(detections: list[Detection]) -> list[Detection]:
    """Without those that lie on a better one."""
    kept: list[Detection] = []
    for one in detections:
        apart = [np.hypot(*np.subtract(one.centre_px, other.centre_px)) for other in kept]
        sides = [max(one.side_px, other.side_px) for other in kept]
        if all(px > side / 2 for px, side in zip(apart, sides, strict=True)):
            kept.append(one)
    return kept
