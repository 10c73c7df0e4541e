"""What a detector finds in one picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.pictures.picture import Image

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sighting:
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
    corners_px: Points | None = None
    turns: int = 0


@dataclass(frozen=True, slots=True)
class Window:
    """Part of a picture: pixels left <= u < right, top <= v < bottom, inside the picture."""

    left: int
    top: int
    right: int
    bottom: int


class Detector(Protocol):
    """Finds the fish's marker. May keep state between pictures (a background)."""

    def find(self, grey: Image, window: Window | None = None) -> list[Sighting]:
        """All markers of the wanted kind in ``grey``, shape (height, width), or in its ``window``;
        positions count in the whole picture. Best first; [] = none."""
