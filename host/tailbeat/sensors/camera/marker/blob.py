"""What the tank looks like without the fish, learned while the fish swims.

A fish without a marker: the one thing that moves before a still background.

Good for a look, not for the best of figures: what of the tail is as wide as the body moves the
blob's middle, and the background behind the fish is never known well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.marker.tags import Detection, SearchWindow
from tailbeat.sensors.camera.source.picture import Image

_LEARNED_PER_PICTURE = 0.01  # of what the picture shows there: the sun moves, the fish is faster
_THRESHOLD_MIN = 10.0  # grey levels
_THRESHOLD_SIGMAS = 5.0
_SPECK_PX, _CRACK_PX = 3, 5

Mask = NDArray[np.uint8]  # 0 or 255
Choose = Callable[[Mask, F32], Mask | None]


class Background:
    """A running mean of what does not move; pictures of one size, grey."""

    def __init__(self, first: Image, fish_px: float, choose: Choose) -> None:
        """Takes the ``first`` picture for the background, but not the fish in it: ``choose`` gets
        all that stands out from its surroundings, three times as wide as a fish of ``fish_px``,
        with the difference, and says which part of it is the fish (None = cannot tell)."""
        self._mean = first.astype(np.float32)
        around = _surroundings(first, fish_px)
        stands_out = cv2.absdiff(first, around).astype(np.float32)
        fish = choose(_clean(stands_out), stands_out)
        if fish is not None:
            grown = cv2.dilate(fish, np.ones((_CRACK_PX, _CRACK_PX), np.uint8)) > 0
            self._mean[grown] = around[grown]

    def changed(self, grey: Image) -> tuple[Mask, F32]:
        """Where ``grey`` is not the background, and by how many grey levels."""
        difference = np.asarray(cv2.absdiff(grey.astype(np.float32), self._mean), np.float32)
        return _clean(difference), difference

    def learn(self, grey: Image, fish: Mask) -> None:
        """Follows slow changes wherever the ``fish`` is not."""
        elsewhere = cv2.bitwise_not(cv2.dilate(fish, np.ones((9, 9), np.uint8)))
        cv2.accumulateWeighted(grey, self._mean, _LEARNED_PER_PICTURE, elsewhere)


def _surroundings(grey: Image, fish_px: float) -> Image:
    # A median over more than twice a stripe's width does not see the stripe. At half the size, to
    # be cheaper: 1.5 fishes there are 3 here.
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    around = cv2.medianBlur(small, int(np.clip(1.5 * fish_px, 5, 255)) // 2 * 2 + 1)
    return np.asarray(cv2.resize(around, grey.shape[::-1]), np.uint8)


def _clean(difference: F32) -> Mask:
    sigma = 1.48 * float(np.median(difference[::4, ::4]))
    there = difference > max(_THRESHOLD_MIN, _THRESHOLD_SIGMAS * sigma)
    mask = there.astype(np.uint8) * np.uint8(255)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((_CRACK_PX, _CRACK_PX), np.uint8))
    return np.asarray(closed, np.uint8)


_SHRINK = 2  # four times cheaper
# A body that would be narrower is looked at in full size. At half size one of 11 pixels turned
# 6 mrad (RMS) by itself, and its tail was too thin to be seen; of 22 pixels 2.5 mrad.
_WIDTH_MIN_PX = 20
_HULL = 0.7  # of a blob's width: what is narrower is the tail, which turns against the body
_WIDTHS = (0.4, 2.0)  # of the known body width
_LENGTHS = (1.8, 10.0)  # of the blob's own width; a curled fish is shorter
_AREAS = (2e-4, 2e-2)  # of the picture, when the width is not known
_SIMILAR = 0.4  # of the clearest one's weight: could be a second fish, weaker ones are waves
_CANDIDATES = 6
_GLARING = 245  # a reflection, no fish
_WIDTH_UNKNOWN = 1 / 30  # of the picture's width
_RIM_PX = 4  # around a region, to see what it stands out from
_CONTRAST_MIN, _CONTRAST_GOOD = 10.0, 40.0  # grey levels
_CORE = 0.5
_QUALITY_MAX = 0.5
_VOTE_KEPT = 0.98
_VOTE_NEEDED = 0.5  # widths swum backwards


Box = tuple[slice, slice]
Labels = NDArray[np.int32]
There = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Region:
    box: Box
    mask: Mask  # in the box
    area_px: float
    middle: F64  # (2,)
    axis: F64  # (2,), unit, towards the head by shape: the tail is thin
    length_px: float
    width_px: float
    contrast: float

    @property
    def weight(self) -> float:
        """How clearly it is there: big waves are faint, glitter is small."""
        return self.area_px * self.contrast


class BlobDetector:
    """Finds what moves (tags.Detector); look at every picture with it, in order.

    In the first picture the fish is the one thing of a fish's shape that stands out from its
    surroundings; it is seen from then on. When there is none or more than one, the fish is seen
    once it has left the place where it lay, about a body length on. The hole it leaves in the
    background is no fish: in the picture it does not stand out from its rim. Lying still for long
    does no harm later.
    """

    def __init__(self, width_px: float | None = None, water: Mask | None = None) -> None:
        """``width_px``: the body's width; ``water``: 255 where the fish can be, a whole picture."""
        self._shrink = 1 if width_px is not None and width_px < _SHRINK * _WIDTH_MIN_PX else _SHRINK
        self._width_px = None if width_px is None else width_px / self._shrink
        self._water = None if water is None else _shrunk(water, self._shrink)
        self._background: Background | None = None
        self._axis: F64 | None = None
        self._middle: F64 | None = None
        self._vote = 0.0
        self._turns = 0

    def find(self, grey: Image, window: SearchWindow | None = None) -> list[Detection]:
        """Everything that could be the fish, the clearest first. A ``window`` saves no time."""
        small = _shrunk(grey, self._shrink)
        if self._background is None:
            width_px = self._width_px or _WIDTH_UNKNOWN * small.shape[1]
            self._background = Background(small, width_px, lambda m, d: self._only_one(m, d, small))
        regions = self._moving(small)
        fish = np.zeros_like(small)
        for region in regions:
            fish[region.box] |= region.mask
        self._background.learn(small, fish)
        found = [self._detection(region, first=k == 0) for k, region in enumerate(regions)]
        return [one for one in found if window is None or _inside(one, window)]

    def _moving(self, small: Image) -> list[_Region]:
        assert self._background is not None
        real = self._regions(*self._background.changed(small), small)
        real.sort(key=lambda region: -region.weight)
        return [region for region in real if region.weight >= _SIMILAR * real[0].weight]

    def _only_one(self, mask: Mask, difference: F32, small: Image) -> Mask | None:
        regions = self._regions(mask, difference, small)
        if len(regions) != 1:
            return None
        fish = np.zeros_like(small)
        fish[regions[0].box] = regions[0].mask
        return fish

    def _regions(self, mask: Mask, difference: F32, small: Image) -> list[_Region]:
        """Those that could be a fish, by their size and shape; the biggest first."""
        if self._water is not None:
            mask = mask & self._water
        count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        areas = stats[:, cv2.CC_STAT_AREA]
        order = sorted(range(1, count), key=lambda k: -areas[k])[:_CANDIDATES]
        least = _AREAS[0] * mask.size if self._width_px is None else self._width_px**2
        boxes = {k: _box(stats[k]) for k in order if areas[k] >= least}
        cores = {k: (box, _core(labels[box] == k, difference[box])) for k, box in boxes.items()}
        found = [_region(box, there, small) for box, there in cores.values()]
        return [region for region in found if self._plausible(region, mask.size)]

    def _plausible(self, region: _Region, picture_px: int) -> bool:
        if region.contrast < _CONTRAST_MIN:
            return False
        if not _LENGTHS[0] <= region.length_px / region.width_px <= _LENGTHS[1]:
            return False
        if self._width_px is None:
            return region.area_px <= _AREAS[1] * picture_px
        return _WIDTHS[0] <= region.width_px / self._width_px <= _WIDTHS[1]

    def _detection(self, region: _Region, first: bool) -> Detection:
        axis = self._towards_head(region) if first else region.axis
        front = region.middle + axis * region.length_px / 2
        centre = (region.middle + 0.5) * self._shrink - 0.5
        front = (front + 0.5) * self._shrink - 0.5
        quality = _QUALITY_MAX * float(np.clip(region.contrast / _CONTRAST_GOOD, 0, 1))
        return Detection(
            (float(centre[0]), float(centre[1])),
            (float(front[0]), float(front[1])),
            region.width_px * self._shrink,
            quality,
            turns=self._turns,
        )

    def _towards_head(self, region: _Region) -> F64:
        """The end that was the head before, the thicker one at first; swimming backwards for long
        turns it around."""
        axis = region.axis
        if self._axis is not None and self._middle is not None:
            axis = axis if axis @ self._axis >= 0 else -axis
            self._vote = _VOTE_KEPT * self._vote + float(axis @ (region.middle - self._middle))
            if self._vote < -_VOTE_NEEDED * region.width_px:
                axis, self._vote = -axis, 0.0
                self._turns += 1
        self._axis, self._middle = axis, region.middle
        return axis


def _box(stats: Labels) -> Box:
    left, top, width, height = (int(n) for n in stats[: cv2.CC_STAT_AREA])
    rows = slice(max(top - _RIM_PX, 0), top + height + _RIM_PX)
    return rows, slice(max(left - _RIM_PX, 0), left + width + _RIM_PX)


def _core(there: There, difference: F32) -> There:
    """The biggest part of it that stands out by half as much as its middle value: without the waves
    that touch the fish."""
    level = _CORE * float(np.median(difference[there]))
    clear = (there & (difference > level)).astype(np.uint8)
    clear = cv2.morphologyEx(clear, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    clear = cv2.morphologyEx(clear, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(clear)
    if count < 2:
        return there
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _region(box: Box, there: There, small: Image) -> _Region:
    whole_middle, _, _, whole_width_px = _ellipse(there)
    middle, axis, length_px, width_px = _ellipse(_hull(there, whole_width_px))
    axis = -axis if axis @ (middle - whole_middle) < 0 else axis
    middle = middle + np.array([box[1].start, box[0].start])
    mask = there.astype(np.uint8) * np.uint8(255)
    contrast = _contrast(mask, small[box])
    area_px = float(np.count_nonzero(there))
    return _Region(box, mask, area_px, middle, axis, length_px, width_px, contrast)


def _ellipse(there: There) -> tuple[F64, F64, float, float]:
    """Middle, long axis, length and width of the ellipse with the same second moments."""
    v, u = np.nonzero(there)
    points = np.column_stack([u, v]).astype(float)
    middle = points.mean(axis=0)
    away = points - middle
    values, vectors = np.linalg.eigh(away.T @ away / len(away) + np.eye(2) / 12)
    width_px, length_px = 4 * np.sqrt(values)
    return middle, vectors[:, 1], float(length_px), float(width_px)


def _hull(there: There, width_px: float) -> There:
    """Without the tail."""
    reach = round(_HULL * width_px / 2)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    # Beyond the box there is nothing: the rim keeps the closing from growing into it.
    mask = np.pad(there.astype(np.uint8), reach)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc)
    hull = mask[reach : reach + there.shape[0], reach : reach + there.shape[1]] > 0
    return np.asarray(hull) if hull.any() else there


def _contrast(mask: Mask, part: Image) -> float:
    """Grey levels between a region and its rim; 0 for a reflection."""
    rim = cv2.dilate(mask, np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)) > mask
    inside = float(np.median(part[mask > 0]))
    if inside >= _GLARING or not rim.any():
        return 0.0
    return abs(inside - float(np.median(part[rim])))


def _shrunk(image: Image, by: int) -> Image:
    if by == 1:
        return image
    size = (image.shape[1] // by, image.shape[0] // by)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _inside(one: Detection, window: SearchWindow) -> bool:
    u, v = one.centre_px
    return window.left <= u < window.right and window.top <= v < window.bottom
