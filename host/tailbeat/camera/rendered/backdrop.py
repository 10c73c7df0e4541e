"""What stands still: floor, walls, rim and the anchors on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image
from tailbeat.camera.rendered.canvas import whole_elements
from tailbeat.camera.rendered.optics import Optics, along_edges
from tailbeat.camera.rendered.scene import ANCHOR_SIDE_M, RIM_M, Scene
from tailbeat.camera.rendered.sprites import printed
from tailbeat.camera.rendered.stamp import FINER, stamp

cv2 = need_cv2()

Grey = NDArray[np.float32]

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


def dimming(scene: Scene) -> Grey:
    """How bright each pixel is against the middle one."""
    width, height = scene.size_px
    u = np.linspace(-1, 1, width, dtype=np.float32) ** 2
    v = np.linspace(-1, 1, height, dtype=np.float32)[:, None] ** 2
    return np.asarray(1 - np.float32(_DIM / 2) * (u + v))


def _surfaces(scene: Scene, optics: Optics) -> Grey:
    width, height = scene.size_px
    fine: Grey = np.full((height * _FINE, width * _FINE), _ROOM, np.float32)
    rim, edge = scene.walls_m(RIM_M), scene.walls_m()
    _fill(fine, optics.pixels(along_edges(rim)), _RIM)
    for k, grey in enumerate(_WALLS):
        line = np.linspace(edge[k], edge[(k + 1) % 4], 25)
        top, bottom = (optics.pixels(line, depth_m) for depth_m in (0.0, _FLOOR_M))
        _fill(fine, np.concatenate([top, bottom[::-1]]), grey)
    _fill(fine, optics.pixels(along_edges(edge), _FLOOR_M), _FLOOR)
    _joints(fine, scene, optics)
    return fine


def _joints(fine: Grey, scene: Scene, optics: Optics) -> None:
    """Lines between the floor's tiles."""
    (left, top), _, (right, bottom), _ = scene.walls_m()
    x, y = np.arange(left + _TILE_M, right, _TILE_M), np.arange(top + _TILE_M, bottom, _TILE_M)
    lines = [np.linspace((at, top), (at, bottom), 25) for at in x]
    lines += [np.linspace((left, at), (right, at), 25) for at in y]
    for line in lines:
        points = [_fixed(optics.pixels(line, _FLOOR_M))]
        cv2.polylines(fine, points, False, _JOINT, _FINE, cv2.LINE_8, _SHIFT)


def _fill(fine: Grey, points_px: NDArray[np.float64], grey: float) -> None:
    cv2.fillPoly(fine, [_fixed(points_px)], grey, cv2.LINE_8, _SHIFT)


def _fixed(points_px: NDArray[np.float64]) -> NDArray[np.int32]:
    """Pixels to the finer picture, in OpenCV's fractions."""
    places = (points_px + 0.5) * _FINE - 0.5
    return np.round(places * (1 << _SHIFT)).astype(np.int32)


def _speckle(scene: Scene, optics: Optics) -> Grey:
    chances = np.random.default_rng([scene.seed, 1])
    width, height = scene.size_px
    rough = chances.standard_normal((height, width), dtype=np.float32)
    sigma = 0.006 * optics.px_per_m
    fine = cv2.GaussianBlur(rough, (0, 0), sigma)
    coarse = cv2.GaussianBlur(rough, (0, 0), 8 * sigma)
    return np.asarray(_SPECKLE * (fine / fine.std() + coarse / coarse.std()), dtype=np.float32)
