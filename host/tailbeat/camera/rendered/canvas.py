"""Draws sprites: polygons and markers in metres, smooth at their edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.marker.markers import MarkerKind
from tailbeat.camera.rendered.stamp import Layer, Sprite

cv2 = need_cv2()

_CARD, _INK = 232, 26  # greys of a print
_SMOOTH = 4  # samples per element while drawing
_NOTHING = 3  # elements around a sprite
_BITS = 4  # of fractions in OpenCV's places
_DICTIONARIES = {"aruco": "DICT_4X4_50", "apriltag": "DICT_APRILTAG_36h11"}


def card_m(side_m: float) -> float:
    """Half a side of the white card that a marker of that side is printed on."""
    return side_m * 2 / 3


def whole_elements(kind: MarkerKind, side_m: float, px_per_m: float) -> float:
    """About ``px_per_m``, so that the squares of the marker fall on whole elements of a sprite."""
    squares = 6 if kind == "blob" else _dictionary(kind).markerSize + 2
    return float(max(1, round(side_m / squares * px_per_m)) * squares / side_m)


class Canvas:
    """At least ``along_m`` (from, to) times ``half_m`` to either side; later things cover earlier
    ones. The origin falls between two elements."""

    def __init__(self, along_m: tuple[float, float], half_m: float, px_per_m: float) -> None:
        self._px_per_m = px_per_m
        self._left = int(np.floor(along_m[0] * px_per_m)) - _NOTHING
        self._top = -int(np.ceil(half_m * px_per_m)) - _NOTHING
        columns = int(np.ceil(along_m[1] * px_per_m)) + _NOTHING - self._left
        self._value: Layer = np.zeros((-2 * self._top * _SMOOTH, columns * _SMOOTH), np.float32)
        self._cover: Layer = np.zeros_like(self._value)

    def fill(self, corners_m: NDArray[np.float64], grey: float) -> None:
        """A polygon in one grey."""
        origin = np.array([self._left, self._top])
        places = (corners_m * self._px_per_m - origin) * _SMOOTH - 0.5
        points = [np.round(places * (1 << _BITS)).astype(np.int32)]
        cv2.fillPoly(self._value, points, grey, cv2.LINE_8, _BITS)
        cv2.fillPoly(self._cover, points, 1.0, cv2.LINE_8, _BITS)

    def print_marker(self, kind: MarkerKind, number: int, side_m: float) -> None:
        """Marker and card around the origin, the print's top towards x (the head)."""
        dictionary = _dictionary(kind)
        squares = dictionary.markerSize + 2
        tile = cv2.aruco.generateImageMarker(dictionary, number, squares, None, 1)
        each = round(side_m / squares * self._px_per_m) * _SMOOTH
        ink = np.kron(np.rot90(tile > 0, -1), np.ones((each, each)))
        margin = round(card_m(side_m) * self._px_per_m) * _SMOOTH - len(ink) // 2
        card = np.pad(np.where(ink > 0, _CARD, _INK), margin, constant_values=_CARD)
        half = len(card) // 2
        row, column = -self._top * _SMOOTH, -self._left * _SMOOTH
        there = np.s_[row - half : row + half, column - half : column + half]
        self._value[there], self._cover[there] = card, 1.0

    def sprite(self) -> Sprite:
        """What was drawn."""
        rows, columns = self._cover.shape
        size = (columns // _SMOOTH, rows // _SMOOTH)
        value = cv2.resize(self._value, size, interpolation=cv2.INTER_AREA)
        cover = cv2.resize(self._cover, size, interpolation=cv2.INTER_AREA)
        scale = self._px_per_m
        return Sprite(value, cover, scale, self._left / scale, self._top / scale)


def _dictionary(kind: MarkerKind) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[kind]))
