"""Follows one fish from picture to picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.base import Frame
from tailbeat.camera.calibration import Calibration
from tailbeat.camera.markers import Marker
from tailbeat.camera.pictures import Picture
from tailbeat.camera.sighting import Sighting

# A patch of the water around the fish, fixed to its marker: in it the LED stands still.
GLOW_LEFT_M, GLOW_RIGHT_M = -0.25, 0.15  # along the fish, from the marker's centre; head = +
GLOW_HALF_WIDTH_M = 0.06
GLOW_CELL_M = 0.01
GLOW_SHAPE = (
    round(2 * GLOW_HALF_WIDTH_M / GLOW_CELL_M),
    round((GLOW_RIGHT_M - GLOW_LEFT_M) / GLOW_CELL_M),
)

Glow = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Place:
    """What one picture said. ``frame`` None = the fish was not seen. ``glow``: brightest pixel of
    each cell of the patch around the fish, GLOW_SHAPE; None when not seen or not asked for."""

    index: int
    t_s: float
    frame: Frame | None
    sighting: Sighting | None
    glow: Glow | None


class Tracker:
    """Looks first where the fish should be, then everywhere; everywhere also once a second, so that
    a second fish does not go unnoticed."""

    def __init__(
        self, marker: Marker, calibration: Calibration, name: str, glow: bool = False
    ) -> None:
        """``name``: of the film or device, for messages."""
        raise NotImplementedError

    def look(self, picture: Picture) -> Place:
        """The fish in the next picture. Raises InputError for two fish, a picture of another size,
        anchors that are elsewhere (first pictures), a marker whose size contradicts the
        calibration by more than 5 % (median of the first second of sightings)."""
        raise NotImplementedError
