"""Positions that another program has tracked in a film: tables of DeepLabCut, SLEAP, TRex,
idtracker.ai and Tracker.

``FORMATS`` is the table of all layouts; a new one is a function and an entry.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, reason
from tailbeat.core.speed_source import Frame
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.tags import Detection
from tailbeat.sensors.camera.source.picture import TimedImage, size_of
from tailbeat.sensors.camera.tracking.tracker import Anchors, TrackedImage, patch_around

LIKELIHOOD_MIN = 0.6  # DeepLabCut's own usual limit
_DRAWN_PX = 12.0  # width of the box that an overlay shows
_LATE = 0.6  # of the usual distance of times: more, and it is another picture's
_Rows = list[list[str]]
Unit = Literal["px", "cm", "m"]


@dataclass(frozen=True)
class PointTrack:
    """A point through a film, n rows. ``at``: number of the picture from 0, or with ``by_time`` its
    time in s from the first one. ``places`` (n, 2): x to the right and y down, NaN = not seen; px
    of the film, cm by TRex's scale, or m in the tank."""

    name: str
    at: F64
    places: F64
    unit: Unit = "px"
    by_time: bool = False


@dataclass(frozen=True)
class PositionFormat:
    """A program's table. ``matches``: by its rows of cells; ``read``: all its points."""

    program: str
    matches: Callable[[_Rows], bool]
    read: Callable[[_Rows], list[PointTrack]]


def _number(cell: str) -> float:
    """NaN for an empty cell, for text, and for TRex's inf."""
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _column(rows: _Rows, at: int) -> F64:
    return np.array([_number(row[at]) if at < len(row) else math.nan for row in rows])


def _pair(rows: _Rows, x: int, y: int) -> F64:
    return np.column_stack([_column(rows, x), _column(rows, y)])


def _deeplabcut(rows: _Rows) -> list[PointTrack]:
    """Header rows scorer, individuals (of several animals), bodyparts, coords."""
    top = [row[0] for row in rows[:5]].index("coords")
    header, coords, body = rows[1:top], rows[top], rows[top + 1 :]
    at, found = _column(body, 0), []
    for x, cell in enumerate(coords):
        if cell != "x":
            continue
        places = _pair(body, x, x + 1)
        places[~(_column(body, x + 2) >= LIKELIHOOD_MIN)] = np.nan
        found.append(PointTrack("/".join(row[x] for row in header), at, places))
    return found


def _sleap(rows: _Rows) -> list[PointTrack]:
    """Columns track, frame_idx, instance.score, and NODE.x, NODE.y, NODE.score of each node; a row
    per animal and picture."""
    header, body = rows[0], rows[1:]
    track, frame = header.index("track"), header.index("frame_idx")
    tracks = sorted({row[track] for row in body})
    nodes = [cell[:-2] for cell in header if cell.endswith(".x")]
    found = []
    for animal in tracks:
        own = [row for row in body if row[track] == animal]
        at = _column(own, frame)
        for node in nodes:
            places = _pair(own, header.index(f"{node}.x"), header.index(f"{node}.y"))
            name = f"{animal}/{node}" if len(tracks) > 1 else node
            found.append(PointTrack(name, at, places))
    return found


_TREX_X = re.compile(r"X(#[\w#]+)?(?: \((cm|px)\))?")


def _trex(rows: _Rows) -> list[PointTrack]:
    """Columns frame and X, Y with or without #wcentroid or the like, in cm unless it says px."""
    header, body = rows[0], rows[1:]
    at, found = _column(body, header.index("frame")), []
    for x, cell in enumerate(header):
        match = _TREX_X.fullmatch(cell)
        y = f"Y{cell[1:]}"
        if match and y in header:
            unit: Unit = "px" if match[2] == "px" else "cm"
            name = (match[1] or "X").lstrip("#")
            found.append(PointTrack(name, at, _pair(body, x, header.index(y)), unit))
    return found


def _idtracker(rows: _Rows) -> list[PointTrack]:
    """Columns time (or seconds) and x1, y1, x2, y2 ...: a row per picture."""
    header, body = rows[0], rows[1:]
    at = np.arange(len(body), dtype=float)
    return [
        PointTrack(cell[1:], at, _pair(body, x, header.index(f"y{cell[1:]}")))
        for x, cell in enumerate(header)
        if re.fullmatch(r"x\d+", cell) and f"y{cell[1:]}" in header
    ]


def _tracker_header(rows: _Rows) -> int | None:
    """The row with the names of the columns, below one with the names of the masses."""
    for number, row in enumerate(rows[1:4], start=1):
        if {"t", "frame"} & set(row) and ({"x", "y"} <= set(row) or "pixelx" in row):
            return number
    return None


def _tracker(rows: _Rows) -> list[PointTrack]:
    """Of each mass x and y in m (its y goes up), or pixelx and pixely if they were exported."""
    top = _tracker_header(rows)
    assert top is not None
    header, names, body = rows[top], rows[top - 1], rows[top + 1 :]
    by_time = "frame" not in header
    at = _column(body, header.index("t" if by_time else "frame"))
    in_px = "pixelx" in header
    x_name, y_name, found = ("pixelx" if in_px else "x"), ("pixely" if in_px else "y"), []
    for x, cell in enumerate(header):
        if cell == x_name and y_name in header[x:]:
            mass = next((name for name in reversed(names[: x + 1]) if name), "mass")
            places = _pair(body, x, header.index(y_name, x)) * (1.0, 1.0 if in_px else -1.0)
            found.append(PointTrack(mass, at, places, "px" if in_px else "m", by_time))
    return found


# Every layout; the first that matches counts.
FORMATS = (
    PositionFormat("DeepLabCut", lambda rows: "coords" in [r[0] for r in rows[:5]], _deeplabcut),
    PositionFormat("SLEAP", lambda rows: {"track", "frame_idx"} <= set(rows[0]), _sleap),
    PositionFormat(
        "TRex", lambda rows: "frame" in rows[0] and any(map(_TREX_X.fullmatch, rows[0])), _trex
    ),
    PositionFormat("idtracker.ai", lambda rows: {"x1", "y1"} <= set(rows[0]), _idtracker),
    PositionFormat("Tracker", lambda rows: _tracker_header(rows) is not None, _tracker),
)
PROGRAMS = ", ".join(one.program for one in FORMATS)


def _read_rows(path: Path) -> _Rows:
    """Cells between commas, tabs or semicolons; with the latter two also decimal commas."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path} ({reason(error)})", "Give a CSV file.") from error
    top = "\n".join(text.splitlines()[:4])
    sign = next((sign for sign in "\t;" if sign in top), ",")
    if sign != ",":
        text = re.sub(r"(?<=\d),(?=\d)", ".", text)
    try:
        rows = list(csv.reader(text.splitlines(), delimiter=sign))
    except csv.Error as error:
        raise InputError(f"{path} is no table ({error})", _EXPORT) from error
    rows = [[cell.strip() for cell in row] for row in rows]
    return [row for row in rows if any(row)]


def read_points(path: Path) -> list[PointTrack]:
    """All points of a table. Raises InputError when no program's layout is recognised."""
    rows = _read_rows(path)
    for layout in FORMATS:
        if rows and layout.matches(rows):
            what = f"{path} is a table of {layout.program}"
            try:
                found = layout.read(rows)
            except (IndexError, ValueError) as error:  # rows or columns are missing
                raise InputError(f"{what} that is cut off or damaged", _EXPORT) from error
            if found and all(np.isfinite(point.at).any() for point in found):
                return found
            raise InputError(f"{what} without positions", _EXPORT)
    raise InputError(f"{path} is no table of positions of {PROGRAMS}", _EXPORT)


_EXPORT = "Export positions as CSV, in a layout that 'Measure speed with an overhead camera' lists."


@dataclass(frozen=True)
class Positions:
    """``centre``: the point that is followed; ``head``: one ahead of it, for the heading. ``name``:
    of the table. ``cm_per_px``: of TRex."""

    name: str
    centre: PointTrack
    head: PointTrack | None = None
    cm_per_px: float | None = None

    def pixels(self, point: PointTrack) -> F64:
        """The point's places in the film, (n, 2)."""
        return point.places / self.cm_per_px if self.cm_per_px else point.places


def read_positions(
    path: Path, point: str | None = None, head: str | None = None, cm_per_px: float | None = None
) -> Positions:
    """The table with the point to follow; None = its only one. Raises InputError."""
    points = {one.name: one for one in read_points(path)}
    if point is None and len(points) > 1:
        raise InputError(
            f"{path} holds {len(points)} points: {', '.join(points)}", "Choose one: --point NAME"
        )
    for name in (point, head):
        if name is not None and name not in points:
            raise InputError(f"{path} has no point {name}", f"It has {', '.join(points)}.")
    centre = points[point] if point is not None else next(iter(points.values()))
    if centre.unit == "cm" and not cm_per_px:
        raise InputError(
            f"{path} holds centimetres by TRex's own scale, which knows no lens",
            "Give that scale, to go back to pixels: --cm-per-pixel X (TRex's cm_per_pixel)",
        )
    if centre.unit != "cm" and cm_per_px:
        raise InputError(f"{path} does not hold centimetres", "Leave --cm-per-pixel out.")
    return Positions(path.name, centre, points[head] if head is not None else None, cm_per_px)


class PositionTracker:
    """Gives each picture the place that a table has for it, as Tracker gives what it sees."""

    other_ids: tuple[int, ...] = ()
    measured_side_m = None

    def __init__(
        self, positions: Positions, calibration: Calibration, film: str, pictures: int | None,
        patch: bool = False,
    ) -> None:  # fmt: skip
        """``pictures``: about how many the ``film`` has. Raises InputError when the table goes on
        behind its end."""
        self._name, self._calibration = film, calibration
        self._anchors = Anchors(calibration, film)
        centre, head = positions.centre, positions.head
        self._at, self._by_time = centre.at, centre.by_time
        last = -1.0 if self._by_time else float(np.nanmax(centre.at))
        if pictures is not None and last > pictures + 1:
            raise InputError(
                f"{positions.name} has picture {last:.0f}, {film} only {pictures}: another film's",
                "Give the film in which the positions were tracked, not cut or converted.",
            )
        self._in_metres = centre.unit == "m"
        self._patch = patch and head is not None and not self._in_metres
        self._centre = positions.pixels(centre)
        self._head = positions.pixels(head) if head is not None else np.full((0, 2), np.nan)
        self._head_row = {} if head is None else {at: k for k, at in enumerate(head.at)}
        steps = np.diff(np.unique(self._at))
        self._near = _LATE * float(np.median(steps)) if self._by_time and len(steps) else 0.5

    def look(self, picture: TimedImage) -> TrackedImage:
        """The fish in the next picture. Raises InputError for a picture of another size, and
        anchors that are elsewhere."""
        if not self._in_metres:
            self._calibration.check_size(size_of(picture.image), self._name)
            self._anchors.look(picture.t_s, picture.image)
        away = np.abs(self._at - (picture.t_s if self._by_time else picture.index))
        row = int(np.nanargmin(away))
        if not (away[row] < self._near and np.isfinite(self._centre[row]).all()):
            return TrackedImage(picture.index, picture.t_s, None, None, None)
        centre, head = self._centre[row], self._head_at(self._at[row])
        (x, y), heading = self._in_tank(centre), math.nan
        if np.isfinite(head).all():
            ahead_x, ahead_y = self._in_tank(head)
            heading = math.atan2(ahead_y - y, ahead_x - x)
        frame = Frame(picture.t_s, x, y, heading)
        if self._in_metres:
            return TrackedImage(picture.index, picture.t_s, frame, None, None)
        front = centre if math.isnan(heading) else head
        shown = Detection(
            (float(centre[0]), float(centre[1])), (float(front[0]), float(front[1])), _DRAWN_PX, 1.0
        )
        known = self._patch and not math.isnan(heading)
        patch = patch_around(picture.image, frame, self._calibration) if known else None
        return TrackedImage(picture.index, picture.t_s, frame, shown, patch)

    def _in_tank(self, place: F64) -> tuple[float, float]:
        if not self._in_metres:
            (place,) = self._calibration.to_tank(place[None])
        return float(place[0]), float(place[1])

    def _head_at(self, at: float) -> F64:
        row = self._head_row.get(at)
        return np.full(2, np.nan) if row is None else np.asarray(self._head[row])
