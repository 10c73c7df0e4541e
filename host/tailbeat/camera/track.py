"""A film's worth of positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.calibration import Calibration
from tailbeat.camera.markers import Marker
from tailbeat.camera.pictures import PictureSource
from tailbeat.camera.tracker import Glow

Floats = NDArray[np.float64]

SEEN, BRIDGED, LOST = 0, 1, 2
STATES = ("seen", "bridged", "lost")
BRIDGED_IN_A_ROW_MAX = 5
COLUMNS = ("picture", "t_s", "x_m", "y_m", "heading_rad", "quality", "state")


@dataclass(frozen=True)
class Track:
    """One row per picture that should have been taken, arrays of shape (rows,).

    SEEN: measured. BRIDGED: not seen, at most five in a row, taken from its neighbours by a straight
    line; for eyes only, no estimate uses it. LOST: longer holes, NaN. ``heading_rad`` is unwrapped.
    Pictures that the film lacks (time stamps further apart than 1.5 periods) are rows as well.
    ``glow`` (rows, *GLOW_SHAPE), 0 where not seen; None = not asked for.
    """

    t_s: Floats
    x_m: Floats
    y_m: Floats
    heading_rad: Floats
    quality: Floats
    state: NDArray[np.uint8]
    fps: float  # by the time stamps: one over their median distance
    name: str = ""
    glow: Glow | None = None

    def seen(self) -> NDArray[np.bool_]:
        """Rows that were measured."""
        return np.asarray(self.state == SEEN)


Progress = Callable[[int, float], None]
"""Called with the pictures done and the part done (0..1; NaN = a source without a known end)."""


def track(
    source: PictureSource,
    marker: Marker,
    calibration: Calibration,
    glow: bool = False,
    progress: Progress | None = None,
    on_place: Callable[..., None] | None = None,
) -> Track:
    """All of ``source``, to its end. ``on_place(picture, place)`` sees each (an overlay).

    Raises InputError: no picture, never a marker, and what Tracker.look raises.
    """
    raise NotImplementedError


def write_track(track: Track, path: Path) -> None:
    """CSV with COLUMNS, whole or not at all; empty cells where LOST."""
    raise NotImplementedError


def read_track(path: Path) -> Track:
    """Reads it back (no glow). Raises InputError with row and column."""
    raise NotImplementedError
