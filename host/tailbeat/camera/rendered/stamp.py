"""Puts a flat thing into a picture, wherever and however turned, without steps at its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image

cv2 = need_cv2()

Floats = NDArray[np.float64]
Layer = NDArray[np.float32]

FINER = 4  # samples per pixel, each way


@dataclass(frozen=True)
class Sprite:
    """``value`` is grey times ``cover`` (0..1); both have the same shape. Column 0 begins
    ``left_m`` and row 0 ``top_m`` from the thing's origin (x to the right, y down)."""

    value: Layer
    cover: Layer
    px_per_m: float
    left_m: float
    top_m: float

    def from_thing(self) -> Floats:
        """Metres to places in the arrays, whose elements have their middles at whole numbers."""
        s = self.px_per_m
        return np.array(
            [[s, 0, -s * self.left_m - 0.5], [0, s, -s * self.top_m - 0.5], [0, 0, 1.0]]
        )

    def corners_m(self) -> Floats:
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
    picture_from_thing: Sequence[Floats],
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


def _seen(layer: Layer, warps: Sequence[Floats], size: tuple[int, int], blur_px: float) -> Layer:
    finer = (size[0] * FINER, size[1] * FINER)
    drawn = cv2.warpPerspective(layer, warps[0], finer, flags=cv2.INTER_LINEAR)
    for warp in warps[1:]:
        drawn += cv2.warpPerspective(layer, warp, finer, flags=cv2.INTER_LINEAR)
    seen = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    if len(warps) > 1:
        seen /= len(warps)
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), blur_px) if blur_px > 0 else seen)


def _box(
    image: Image, sprite: Sprite, homographies: Sequence[Floats], blur_px: float
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
