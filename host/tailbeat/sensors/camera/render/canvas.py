"""Puts a flat thing into a picture, wherever and however turned, without steps at its edges.

Draws sprites: polygons and markers in metres, smooth at their edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F32, F64
from tailbeat.sensors.camera.marker.detector import MarkerKind
from tailbeat.sensors.camera.opencv import cv2
from tailbeat.sensors.camera.source.picture import Image

FINER = 4  # samples per pixel, each way


@dataclass(frozen=True)
class Sprite:
    """``value`` is grey times ``cover`` (0..1); both have the same shape. Column 0 begins
    ``left_m`` and row 0 ``top_m`` from the thing's origin (x to the right, y down)."""

    value: F32
    cover: F32
    px_per_m: float
    left_m: float
    top_m: float

    def from_thing(self) -> F64:
        """Metres to places in the arrays, whose elements have their middles at whole numbers."""
        s = self.px_per_m
        return np.array(
            [[s, 0, -s * self.left_m - 0.5], [0, s, -s * self.top_m - 0.5], [0, 0, 1.0]]
        )

    def corners_m(self) -> F64:
        """Of the arrays, shape (4, 2)."""
        rows, columns = self.cover.shape
        right_m = self.left_m + columns / self.px_per_m
        bottom_m = self.top_m + rows / self.px_per_m
        return np.array(
            [
                [self.left_m, self.top_m],
                [right_m, self.top_m],
                [right_m, bottom_m],
                [self.left_m, bottom_m],
            ]
        )


def stamp(
    image: Image,
    sprite: Sprite,
    picture_from_thing: Sequence[F64],
    blur_px: float = 0.0,
    gain: float = 1.0,
) -> None:
    """Draws ``sprite`` over ``image``, averaged over the homographies it had while the shutter was
    open. ``blur_px``: of the lens, standard deviation; ``gain``: how bright that corner is."""
    box = _box(image, sprite, picture_from_thing, blur_px)
    if box is None:
        return
    left, top, right, bottom = box
    size = (right - left, bottom - top)
    finer = np.array(
        [[FINER, 0, FINER * (0.5 - left) - 0.5], [0, FINER, FINER * (0.5 - top) - 0.5], [0, 0, 1.0]]
    )
    from_sprite = np.linalg.inv(sprite.from_thing())
    warps = [finer @ homography @ from_sprite for homography in picture_from_thing]
    value = _seen(sprite.value, warps, size, blur_px)
    cover = _seen(sprite.cover, warps, size, blur_px)
    under = image[top:bottom, left:right]
    under[:] = cv2.add(value * np.float32(gain) + under * (1 - cover), 0.0, dtype=cv2.CV_8U)


def _seen(layer: F32, warps: Sequence[F64], size: tuple[int, int], blur_px: float) -> F32:
    finer = (size[0] * FINER, size[1] * FINER)
    drawn = cv2.warpPerspective(layer, warps[0], finer, flags=cv2.INTER_LINEAR)
    for warp in warps[1:]:
        drawn += cv2.warpPerspective(layer, warp, finer, flags=cv2.INTER_LINEAR)
    seen = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    if len(warps) > 1:
        seen /= len(warps)
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), blur_px) if blur_px > 0 else seen)


def _box(
    image: Image, sprite: Sprite, homographies: Sequence[F64], blur_px: float
) -> tuple[int, int, int, int] | None:
    """Pixels left <= u < right, top <= v < bottom that it may touch; None = outside."""
    corners = np.concatenate(
        [cv2.perspectiveTransform(sprite.corners_m()[None], h)[0] for h in homographies]
    )
    margin = 1 + int(np.ceil(4 * blur_px))
    height, width = image.shape
    left, top = np.floor(corners.min(axis=0)).astype(int) - margin
    right, bottom = np.ceil(corners.max(axis=0)).astype(int) + margin + 1
    left, top, right, bottom = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
    return (left, top, right, bottom) if left < right and top < bottom else None


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
        self._value: F32 = np.zeros((-2 * self._top * _SMOOTH, columns * _SMOOTH), np.float32)
        self._cover: F32 = np.zeros_like(self._value)

    def fill(self, corners_m: F64, grey: float) -> None:
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
