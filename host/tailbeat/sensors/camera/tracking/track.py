"""A film's worth of positions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.csv import table_text
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.detector import KINDS, MARKERS, Marker
from tailbeat.sensors.camera.source.ahead import read_ahead
from tailbeat.sensors.camera.source.picture import PictureSource
from tailbeat.sensors.camera.tracking.positions import Positions, PositionTracker
from tailbeat.sensors.camera.tracking.tracker import PATCH_SHAPE, LedPatch, TrackedImage, Tracker

SEEN, BRIDGED, LOST = 0, 1, 2
STATES = ("seen", "bridged", "lost")
BRIDGED_IN_A_ROW_MAX = 5
COLUMNS = ("picture", "t_s", "x_m", "y_m", "heading_rad", "quality", "state")
_LACK_PERIODS = 1.5
_PERIOD_OF = 25  # distances between pictures
_PAUSE_MAX_S = 600.0


@dataclass(frozen=True)
class Track:
    """One row per picture that should have been taken, arrays of shape (rows,).

    SEEN: measured. BRIDGED: not seen, at most five in a row, taken from its neighbours by a
    straight line; for eyes only, no estimate uses it. LOST: longer holes, and those at either end;
    NaN. ``heading_rad`` is unwrapped.

    Pictures that the film lacks are rows as well: where two time stamps lie further apart than 1.5
    periods, evenly spread between them. The period is the median of the 25 distances before (of
    the first 25 at the begin), so that it follows a film whose rate changes; where it suddenly
    halves, the next twelve distances hold one row too many each, bridged and of no consequence.
    ``patch`` (rows, *PATCH_SHAPE), 0 where not seen; None = not asked for. ``marker_side_m``: as
    Tracker.measured_side_m.
    """

    t_s: F64
    x_m: F64
    y_m: F64
    heading_rad: F64
    quality: F64
    state: NDArray[np.uint8]
    fps: float  # by the time stamps: one over their median distance; 0 = fewer than two
    name: str = ""
    patch: LedPatch | None = None
    marker_side_m: float | None = None

    def seen(self) -> NDArray[np.bool_]:
        """Rows that were measured."""
        return np.asarray(self.state == SEEN)


Progress = Callable[[int, float], None]
"""Called with the pictures done and the part done (0..1; NaN = a source without a known end)."""


def track(
    source: PictureSource,
    marker: Marker,
    calibration: Calibration,
    patch: bool = False,
    progress: Progress | None = None,
    on_place: Callable[..., None] | None = None,
    positions: Positions | None = None,
) -> Track:
    """All of ``source``, to its end, or to where it has nothing for now (virtual time).
    ``on_place(picture, place)`` sees each (an overlay). ``positions``: what another program has
    tracked in this film; then no marker is looked for.

    Raises InputError: no picture, never a fish, what Tracker.look raises, and what the source
    raises: there is no track of a film that is damaged further on.
    """
    expected = source.pictures
    tracker: Tracker | PositionTracker = (
        Tracker(marker, calibration, source.name, patch)
        if positions is None
        else PositionTracker(positions, calibration, source.name, expected, patch)
    )
    places: list[TrackedImage] = []
    with read_ahead(source) as read:
        while (picture := read()) is not None:
            place = tracker.look(picture)
            places.append(place)
            if on_place is not None:
                on_place(picture, place)
            if progress is not None:
                done = len(places)
                progress(done, min(1.0, done / expected) if expected else math.nan)
    if not places:
        raise InputError(f"{source.name} holds no picture.", "Give a film of a trial.")
    if all(place.frame is None for place in places):
        if positions is not None:
            raise InputError(
                f"{positions.name} has no position for any picture of {source.name}",
                "Give the film in which they were tracked; its pictures count from 0.",
            )
        raise _no_marker(source.name, marker, len(places), list(tracker.other_ids))
    return replace(track_of(places, source.name), marker_side_m=tracker.measured_side_m)


def _no_marker(name: str, marker: Marker, pictures: int, other_ids: list[int]) -> InputError:
    family = MARKERS[marker.kind].family
    if family is None:
        return InputError(
            f"{name}: nothing moves in any of {pictures} pictures.",
            "A blob needs a background that stands still. With a tag on the fish try "
            "--marker aruco or --marker apriltag.",
        )
    which = "" if marker.id is None else f" with id {marker.id}"
    message = f"{name}: no {marker.kind} marker{which} in any of {pictures} pictures."
    fishs = [number for number in other_ids if not (family.shared and number >= family.printed_ids)]
    if fishs:
        found = ", ".join(map(str, fishs))
        return InputError(message, f"What is there has the id {found}: give that, or none.")
    others = " or ".join(f"--marker {kind}" for kind in KINDS if kind != marker.kind)
    return InputError(
        message, f"It must lie flat and sharp in view, 20 pixels wide or more; or try {others}."
    )


def track_of(places: Sequence[TrackedImage], name: str = "") -> Track:
    """Rows from what was seen picture by picture; none from none. Time stamps rise. A blob's head
    is where it was taken to be last. Raises InputError for a pause of more than ten minutes."""
    places = _one_head(places)
    taken_s = np.array([place.t_s for place in places], np.float64)
    t_s, at = _rows(taken_s, name)
    seen = np.array([place.frame is not None for place in places], bool)
    state = np.full(len(t_s), LOST, np.uint8)
    state[at[seen]] = SEEN
    values = np.full((3, len(t_s)), np.nan)
    quality = np.zeros(len(t_s))
    patch = None
    if any(place.patch is not None for place in places):
        patch = np.zeros((len(t_s), *PATCH_SHAPE), np.uint8)
    for row, place in zip(at, places, strict=True):
        if place.frame is not None:
            frame = place.frame
            values[:, row] = frame.x_m, frame.y_m, frame.heading_rad
            quality[row] = place.detection.quality if place.detection is not None else 1.0
        if patch is not None and place.patch is not None:
            patch[row] = place.patch
    x_m, y_m, heading_rad = values
    heading_rad[at[seen]] = np.unwrap(heading_rad[at[seen]])
    _bridge(state, t_s, [x_m, y_m, heading_rad])
    return Track(t_s, x_m, y_m, heading_rad, quality, state, _fps(taken_s), name, patch)


def _one_head(places: Sequence[TrackedImage]) -> list[TrackedImage]:
    """With those turned around that the detector itself turned around later."""
    turns = [0 if place.detection is None else place.detection.turns for place in places]
    last = max(turns, default=0)
    return [
        place.turned() if (last - by_then) % 2 else place
        for place, by_then in zip(places, turns, strict=True)
    ]


def _fps(taken_s: F64) -> float:
    return float(1 / np.median(np.diff(taken_s))) if len(taken_s) > 1 else 0.0


def _rows(taken_s: F64, name: str) -> tuple[F64, NDArray[np.intp]]:
    """Times of all rows, and the row of each picture."""
    if len(taken_s) < 2:
        return taken_s, np.arange(len(taken_s))
    gaps = np.diff(taken_s)
    longest = int(np.argmax(gaps))
    if gaps[longest] > _PAUSE_MAX_S:
        raise InputError(
            f"{name} pauses for {gaps[longest]:.0f} s after picture {longest}.",
            "Give a film of one trial, in one piece.",
        )
    periods = gaps / _periods(gaps)
    lacking = np.where(periods > _LACK_PERIODS, np.rint(periods) - 1, 0).astype(np.intp)
    at = np.concatenate([[0], np.cumsum(lacking + 1)])
    return np.interp(np.arange(at[-1] + 1), at, taken_s), at


def _periods(gaps: F64) -> F64:
    """The usual distance of pictures at each of ``gaps``."""
    if len(gaps) <= _PERIOD_OF:
        return np.full(len(gaps), np.median(gaps))
    medians = np.median(np.lib.stride_tricks.sliding_window_view(gaps, _PERIOD_OF), axis=1)
    return np.concatenate([np.full(_PERIOD_OF, medians[0]), medians[:-1]])


def _bridge(state: NDArray[np.uint8], t_s: F64, columns: list[F64]) -> None:
    """Fills short holes between rows that were seen, in place."""
    seen = np.flatnonzero(state == SEEN)
    for before, after in pairwise(seen):
        if 1 < after - before <= BRIDGED_IN_A_ROW_MAX + 1:
            hole = slice(before + 1, after)
            state[hole] = BRIDGED
            for column in columns:
                ends = t_s[[before, after]], column[[before, after]]
                column[hole] = np.interp(t_s[hole], *ends)


def write_track(track: Track, path: Path) -> None:
    """CSV with COLUMNS, whole or not at all; empty cells where LOST. ``picture`` counts rows."""
    columns = (track.t_s, track.x_m, track.y_m, track.heading_rad, track.quality)
    rows = (
        (row, *(f"{v:.6f}" if math.isfinite(v) else None for v in values), STATES[state])
        for row, (state, *values) in enumerate(zip(track.state, *columns, strict=True))
    )
    write_whole(path, table_text(COLUMNS, rows))
