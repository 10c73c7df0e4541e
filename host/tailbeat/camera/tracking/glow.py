"""How bright the water and the body around the marker are, cell by cell: there the LED blinks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.base import Frame
from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image
from tailbeat.camera.tank.calibration import Calibration

# A patch of the water around the fish, fixed to its marker: in it the LED stands still.
GLOW_LEFT_M, GLOW_RIGHT_M = -0.25, 0.15  # along the fish, from the marker's centre; head = +
GLOW_HALF_WIDTH_M = 0.06
GLOW_CELL_M = 0.01
GLOW_SHAPE = (
    round(2 * GLOW_HALF_WIDTH_M / GLOW_CELL_M),
    round((GLOW_RIGHT_M - GLOW_LEFT_M) / GLOW_CELL_M),
)

Glow = NDArray[np.uint8]

_SAMPLES_MAX = 12  # per cell and direction

_PATCH_M = np.array(
    [
        [GLOW_LEFT_M, -GLOW_HALF_WIDTH_M],
        [GLOW_RIGHT_M, -GLOW_HALF_WIDTH_M],
        [GLOW_RIGHT_M, GLOW_HALF_WIDTH_M],
        [GLOW_LEFT_M, GLOW_HALF_WIDTH_M],
    ]
)


def glow_around(grey: Image, frame: Frame, calibration: Calibration) -> Glow:
    """The brightest pixel of each cell, GLOW_SHAPE; 0 outside the picture. Row 0 is the fish's left
    side, column 0 its tail's end; cell (r, c) reaches from GLOW_LEFT_M + c GLOW_CELL_M along the
    fish and from r GLOW_CELL_M - GLOW_HALF_WIDTH_M to its right."""
    cv2 = need_cv2()
    cos, sin = np.cos(frame.heading_rad), np.sin(frame.heading_rad)
    places = _PATCH_M @ np.array([[cos, sin], [-sin, cos]]) + [frame.x_m, frame.y_m]
    corners = calibration.to_pixels(places)
    per_cell = _samples(corners)
    rows, columns = GLOW_SHAPE[0] * per_cell, GLOW_SHAPE[1] * per_cell
    # Over 0.4 m even a wide lens bends by less than a cell: four corners are enough.
    flat = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32) - 0.5
    to_patch = cv2.getPerspectiveTransform(corners.astype(np.float32), flat.astype(np.float32))
    patch = cv2.warpPerspective(grey, to_patch, (columns, rows), flags=cv2.INTER_LINEAR)
    cells = patch.reshape(GLOW_SHAPE[0], per_cell, GLOW_SHAPE[1], per_cell)
    return np.asarray(cells.max(axis=(1, 3)), np.uint8)


def _samples(corners: NDArray[np.float64]) -> int:
    """As many as a cell has pixels, so that no bright pixel falls between them."""
    length_px = float(np.linalg.norm(corners[1] - corners[0]))
    return int(np.clip(np.ceil(length_px / GLOW_SHAPE[1]), 1, _SAMPLES_MAX))
