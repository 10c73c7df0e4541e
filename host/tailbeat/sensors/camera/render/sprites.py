"""Sprites of the rendered tank: the fish, its marker, what covers it, and what stands still.

Polygons and markers are drawn in metres, with smooth edges; greys of 255.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import corners_of
from tailbeat.sensors.camera.marker.detector import MARKERS, MarkerKind
from tailbeat.sensors.camera.marker.tags import TAGS, TagKind
from tailbeat.sensors.camera.render.scene import (
    ANCHOR_SIDE_M,
    RIM_M,
    Optics,
    Scene,
    along_edges,
    chance,
)
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
        return corners_of(self.left_m, self.top_m, right_m, bottom_m)


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


def card_m(side_m: float) -> float:
    """Half a side of the white card that a marker of that side is printed on."""
    return side_m * 2 / 3


def whole_elements(kind: MarkerKind, side_m: float, px_per_m: float) -> float:
    """About ``px_per_m``, so that the squares of the marker fall on whole elements of a sprite."""
    family = MARKERS[kind].family or TAGS["aruco"]
    return float(max(1, round(side_m / family.cells * px_per_m)) * family.cells / side_m)


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

    def print_marker(self, kind: TagKind, number: int, side_m: float) -> None:
        """Marker and card around the origin, the print's top towards x (the head)."""
        squares = TAGS[kind].cells
        tile = cv2.aruco.generateImageMarker(TAGS[kind].dictionary(), number, squares, None, 1)
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
        layers = (self._value, self._cover)
        value, cover = (cv2.resize(layer, size, interpolation=cv2.INTER_AREA) for layer in layers)
        scale = self._px_per_m
        return Sprite(value, cover, scale, self._left / scale, self._top / scale)


NOSE_M, TAIL_TIP_M = 0.20, -0.16  # from the marker's centre; a fish of 36 cm
LED_RADIUS_M, LED_RING_M = 0.006, 0.008
_HULL_HALF_M = 0.045
_OVERLAP_M = 0.001  # of the ring, on the card
_WIDEST_M = 0.02  # where along the hull
_TAIL_ROOT_M, _TAIL_END_M = 0.015, 0.005  # half widths of the plate

_HULL, _HULL_EDGE, _BACK, _TAIL, _EYE = 158, 120, 140, 142, 40
_RING, _LAMP_OFF = 18, 62
_FOAM = 205


@dataclass(frozen=True)
class Body:
    """Where things are along the fish, metres from the marker's centre; all of it follows from the
    marker's size."""

    marker_side_m: float

    @property
    def led_m(self) -> float:
        """Middle of the LED, behind the card."""
        return -card_m(self.marker_side_m) - LED_RING_M + _OVERLAP_M

    @property
    def hinge_m(self) -> float:
        """Of the tail, under the hull's end."""
        return self.led_m - LED_RING_M


def printed(kind: TagKind, number: int, side_m: float, px_per_m: float) -> Sprite:
    """The marker on its card, the print's top towards x (the head). ``px_per_m`` as of
    ``whole_elements``."""
    half_m = card_m(side_m)
    canvas = Canvas((-half_m, half_m), half_m, px_per_m)
    canvas.print_marker(kind, number, side_m)
    return canvas.sprite()


def body(scene: Scene, led: float, px_per_m: float) -> Sprite:
    """The stiff part of the fish with marker and LED, lit for ``led`` of the exposure."""
    where = Body(scene.marker_side_m)
    half_m = max(_HULL_HALF_M, card_m(scene.marker_side_m))
    canvas = Canvas((where.hinge_m, NOSE_M), half_m, px_per_m)
    along = np.linspace(where.hinge_m, NOSE_M, 80)
    for part, grey in ((1.0, _HULL_EDGE), (0.86, _HULL), (0.3, _BACK)):
        half = part * _half_width(along)
        canvas.fill(np.concatenate([np.c_[along, half], np.c_[along, -half][::-1]]), grey)
    for side in (-1, 1):
        canvas.fill(_ring(NOSE_M - 0.03, side * 0.019, 0.004), _EYE)
    if MARKERS[scene.marker].family is not None:
        canvas.print_marker(cast(TagKind, scene.marker), scene.marker_id, scene.marker_side_m)
    if scene.led:
        canvas.fill(_ring(where.led_m, 0, LED_RING_M), _RING)
        canvas.fill(_ring(where.led_m, 0, LED_RADIUS_M), _LAMP_OFF + led * (255 - _LAMP_OFF))
    return canvas.sprite()


def tail(where: Body, px_per_m: float) -> Sprite:
    """The plate, from its hinge backward (x = 0 is the hinge)."""
    end_m = TAIL_TIP_M - where.hinge_m
    canvas = Canvas((end_m, 0.01), _TAIL_ROOT_M, px_per_m)
    along = np.array([0.01, 0.4 * end_m, 0.75 * end_m, end_m])
    half = np.array([_TAIL_ROOT_M, 0.7 * _TAIL_ROOT_M, _TAIL_END_M, 0.8 * _TAIL_END_M])
    canvas.fill(np.concatenate([np.c_[along, half], np.c_[along, -half][::-1]]), _TAIL)
    return canvas.sprite()


def foam(side_m: float, seed: int, px_per_m: float) -> Sprite:
    """A patch of foam over the half of a marker with y > 0, card included."""
    half_m = side_m * 0.75
    canvas = Canvas((-half_m, half_m), half_m, px_per_m)
    canvas.fill(corners_of(-half_m, 0, half_m, half_m), _FOAM)
    for k in range(70):
        x, y, size, grey = (chance(seed, "foam", k, what) for what in "xysg")
        radius_m = half_m * (0.06 + 0.12 * size)
        inside_m = half_m - radius_m
        place = (2 * x - 1) * inside_m, radius_m + y * (half_m - 2 * radius_m)
        canvas.fill(_ring(*place, radius_m), _FOAM - 45 + 90 * grey)
    return canvas.sprite()


def _half_width(along_m: F64) -> F64:
    """A blunt head and a narrow stern."""
    ahead = np.maximum(0, (along_m - _WIDEST_M) / (NOSE_M - _WIDEST_M))
    astern = (_WIDEST_M - along_m) / 0.2
    shape = np.where(ahead > 0, np.sqrt(np.clip(1 - ahead**2.4, 0, 1)), 1 - 2.2 * astern**2)
    return np.asarray(_HULL_HALF_M * shape)


def _ring(x_m: float, y_m: float, radius_m: float) -> F64:
    around = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    return np.column_stack([x_m + radius_m * np.cos(around), y_m + radius_m * np.sin(around)])


_FLOOR_M = 0.4  # how deep 0.5 m of water look, in air
_TILE_M = 0.3
_ROOM, _RIM, _WALLS, _FLOOR, _JOINT = 48, 172, (84, 66, 92, 74), 100, 88
_SPECKLE = 2.5  # standard deviation of the floor's texture
_DIM = 0.22  # how much darker the picture's corners are
_FINE = 2  # samples per pixel
_SHIFT = 4


def backdrop(scene: Scene, optics: Optics) -> Image:
    """The empty tank, as the lens draws it, without waves and noise."""
    fine = _surfaces(scene, optics)
    grey = cv2.resize(fine, scene.size_px, interpolation=cv2.INTER_AREA)
    grey += _speckle(scene, optics)
    grey *= dimming(scene)
    if scene.blur_px > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), scene.blur_px)
    image: Image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    px_per_m = whole_elements("aruco", ANCHOR_SIDE_M, FINER * optics.px_per_m)
    for number, place in scene.anchors_m().items():
        tile = printed("aruco", number, ANCHOR_SIDE_M, px_per_m)
        stamp(image, tile, [optics.near(place, 0.0, ANCHOR_SIDE_M)], scene.blur_px)
    return image


def water(scene: Scene, optics: Optics) -> Image:
    """255 where there is water, 0 elsewhere."""
    mask: Image = np.zeros(scene.size_px[::-1], np.uint8)
    points = optics.pixels(along_edges(scene.walls_m()))
    cv2.fillPoly(mask, [np.round(points).astype(np.int32)], 255)
    return mask


def dimming(scene: Scene) -> F32:
    """How bright each pixel is against the middle one."""
    width, height = scene.size_px
    u = np.linspace(-1, 1, width, dtype=np.float32) ** 2
    v = np.linspace(-1, 1, height, dtype=np.float32)[:, None] ** 2
    return np.asarray(1 - np.float32(_DIM / 2) * (u + v))


def _surfaces(scene: Scene, optics: Optics) -> F32:
    width, height = scene.size_px
    fine: F32 = np.full((height * _FINE, width * _FINE), _ROOM, np.float32)
    rim, edge = scene.walls_m(RIM_M), scene.walls_m()
    _fill(fine, optics.pixels(along_edges(rim)), _RIM)
    for k, grey in enumerate(_WALLS):
        line = np.linspace(edge[k], edge[(k + 1) % 4], 25)
        top, bottom = (optics.pixels(line, depth_m) for depth_m in (0.0, _FLOOR_M))
        _fill(fine, np.concatenate([top, bottom[::-1]]), grey)
    _fill(fine, optics.pixels(along_edges(edge), _FLOOR_M), _FLOOR)
    _joints(fine, scene, optics)
    return fine


def _joints(fine: F32, scene: Scene, optics: Optics) -> None:
    """Lines between the floor's tiles."""
    (left, top), _, (right, bottom), _ = scene.walls_m()
    x, y = np.arange(left + _TILE_M, right, _TILE_M), np.arange(top + _TILE_M, bottom, _TILE_M)
    lines = [np.linspace((at, top), (at, bottom), 25) for at in x]
    lines += [np.linspace((left, at), (right, at), 25) for at in y]
    for line in lines:
        points = [_fixed(optics.pixels(line, _FLOOR_M))]
        cv2.polylines(fine, points, False, _JOINT, _FINE, cv2.LINE_8, _SHIFT)


def _fill(fine: F32, points_px: F64, grey: float) -> None:
    cv2.fillPoly(fine, [_fixed(points_px)], grey, cv2.LINE_8, _SHIFT)


def _fixed(points_px: F64) -> NDArray[np.int32]:
    """Pixels to the finer picture, in OpenCV's fractions."""
    return np.round(((points_px + 0.5) * _FINE - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _speckle(scene: Scene, optics: Optics) -> F32:
    chances = np.random.default_rng([scene.seed, 1])
    width, height = scene.size_px
    rough = chances.standard_normal((height, width), dtype=np.float32)
    sigma = 0.006 * optics.px_per_m
    fine = cv2.GaussianBlur(rough, (0, 0), sigma)
    coarse = cv2.GaussianBlur(rough, (0, 0), 8 * sigma)
    return np.asarray(_SPECKLE * (fine / fine.std() + coarse / coarse.std()), dtype=np.float32)
