"""What the tank looks like without the fish, learned while the fish swims."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.pictures.picture import Image

_LEARNED_PER_PICTURE = 0.01  # of what the picture shows there: the sun moves, the fish is faster
_THRESHOLD_MIN = 10.0  # grey levels
_THRESHOLD_SIGMAS = 5.0
_SPECK_PX, _CRACK_PX = 3, 5

Mask = NDArray[np.uint8]  # 0 or 255
Floats = NDArray[np.float32]
Choose = Callable[[Mask, Floats], Mask | None]


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

    def changed(self, grey: Image) -> tuple[Mask, Floats]:
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


def _clean(difference: Floats) -> Mask:
    sigma = 1.48 * float(np.median(difference[::4, ::4]))
    there = difference > max(_THRESHOLD_MIN, _THRESHOLD_SIGMAS * sigma)
    mask = there.astype(np.uint8) * np.uint8(255)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))  # type: ignore[assignment]
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((_CRACK_PX, _CRACK_PX), np.uint8))
    return np.asarray(closed, np.uint8)
