"""Sheets to print, exact to the millimetre: the board, the fish's marker, the tank's and the
ruler's markers."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import ANCHOR_ID_MIN, corners_of
from tailbeat.sensors.camera.marker.tags import (
    ANCHOR_IDS,
    BOARD_MARKER,
    BOARD_SQUARES,
    RULER_IDS,
    TAGS,
    TagKind,
    board,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Paper = Literal["a4", "a3", "letter"]
PAPERS_MM: dict[Paper, tuple[float, float]] = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "letter": (215.9, 279.4),
}
SIDE_MM_MIN = 10.0
ANCHOR_ID_MAX = 49  # the last of DICT_4X4_50
TANK_SIDE_MM, FISH_SIDE_MM = 70.0, 60.0

_MM_PER_INCH = 25.4
_EDGE_MM = 12.0  # what printers leave white
_FOOT_MM = 30.0  # for the line of 100 mm and the text
_CUT = 1.4  # side of the paper cut out over the marker's: a cell of white all round, at least

Cells = NDArray[np.bool_]  # True = black; the first row is the top


@dataclass(frozen=True)
class Sheet:
    """A page and what is drawn on it. ``draw`` gets axes in mm, (0, 0) at the lower left."""

    name: str
    text: str
    paper: Paper
    draw: Callable[[Axes], None]


def board_sheet(paper: Paper = "a4") -> Sheet:
    """The ChArUco board, as large as fits."""
    columns, rows = BOARD_SQUARES
    width, height = PAPERS_MM[paper]
    fits = min((width - 2 * _EDGE_MM) / columns, (height - _EDGE_MM - _FOOT_MM) / rows)
    square = float(np.floor(fits))
    left = (width - columns * square) / 2
    text = (
        f"ChArUco board, {columns} x {rows} squares of {square:g} mm. Stick it on something flat "
        "and stiff; do not let it shine."
    )

    def draw(axes: Axes) -> None:
        plan = board(square)
        top = height - _EDGE_MM
        taken = set()
        for number, corners in zip(plan.getIds().ravel(), plan.getObjPoints(), strict=True):
            middle = corners.mean(axis=0) / square
            taken.add((int(middle[0]), int(middle[1])))
            where = (left + float(corners[:, 0].min()), top - float(corners[:, 1].max()))
            cells = _cells(plan.getDictionary(), int(number))
            _draw_cells(axes, cells, where, square * BOARD_MARKER)
        bare = [
            (left + column * square, top - (row + 1) * square, square, square)
            for column in range(columns)
            for row in range(rows)
            if (column, row) not in taken
        ]
        _boxes(axes, bare)

    return Sheet("board", text, paper, draw)


def fish_sheet(
    kind: TagKind = "aruco",
    number: int = 7,
    side_mm: float = FISH_SIDE_MM,
    paper: Paper = "a4",
) -> Sheet:
    """The fish's marker with an arrow to its head. Raises InputError for an id that is the tank's
    or does not exist, and a side that does not fit."""
    _check_fish_id(kind, number)
    _check_side(side_mm, paper, 1, 1)
    text = (
        f"Marker of the fish: {TAGS[kind].name}, id {number}, black square {side_mm:g} mm. "
        "Cut along the dashes: the white around it is part of it. The arrow points to the fish's "
        "head."
    )

    def draw(axes: Axes) -> None:
        width, height = PAPERS_MM[paper]
        cut = side_mm * _CUT
        _draw_marker(axes, kind, number, side_mm, (width / 2, height - _EDGE_MM - cut / 2))
        _draw_head(axes, width / 2, height - _EDGE_MM, side_mm)

    return Sheet("marker", text, paper, draw)


def anchors_sheet(
    side_mm: float = TANK_SIDE_MM, paper: Paper = "a4", number: int | None = None
) -> Sheet:
    """The four markers of the tank, or the one with the id ``number``. Raises InputError for a side
    that does not fit and an id that is not the tank's."""
    if number is not None and not ANCHOR_ID_MIN <= number <= ANCHOR_ID_MAX:
        raise InputError(
            f"a marker of the tank cannot have id {number}",
            f"Take one of {ANCHOR_ID_MIN} to {ANCHOR_ID_MAX}.",
        )
    text = (
        "Markers of the tank. Fix them where the camera sees them and the fish never comes. "
        "Measure x and y of their middles (the ticks point to it)."
    )
    ids = ANCHOR_IDS if number is None else (number,)
    return _several("anchors", text, ids, side_mm, paper)


def ruler_sheet(side_mm: float = TANK_SIDE_MM, paper: Paper = "a4") -> Sheet:
    """The two ends of the ruler. Raises InputError for a side that does not fit."""
    text = (
        "Ends of the ruler. Stick them on a straight stick, as far apart as fits into the tank. "
        "Measure from middle to middle (the ticks point to it)."
    )
    return _several("ruler", text, RULER_IDS, side_mm, paper)


def write_sheet(sheet: Sheet, path: Path) -> None:
    """PDF, or PNG of 300 dpi, by the name; whole or not at all. Raises InputError."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("pdf", "png"):
        raise InputError(f"{path} is neither .pdf nor .png", "Name it like sheet.pdf.")
    undated: dict[str, Any] = {"CreationDate": None} if kind == "pdf" else {}
    page = io.BytesIO()
    figure(sheet).savefig(page, format=kind, dpi=300, metadata=undated)
    write_whole(path, page.getvalue())


def figure(sheet: Sheet) -> Figure:
    """The page in its true size."""
    from matplotlib.figure import Figure

    width, height = PAPERS_MM[sheet.paper]
    page = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH), facecolor="white")
    axes = page.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.axis("off")
    sheet.draw(axes)
    _draw_foot(axes, sheet.text, width)
    return page


def _several(name: str, text: str, ids: tuple[int, ...], side_mm: float, paper: Paper) -> Sheet:
    pitch = side_mm * _CUT
    columns = min(2, len(ids))
    _check_side(side_mm, paper, columns, (len(ids) + 1) // 2)

    def draw(axes: Axes) -> None:
        width, height = PAPERS_MM[paper]
        for i, number in enumerate(ids):
            x = width / 2 + (i % 2 - (columns - 1) / 2) * pitch
            y = height - _EDGE_MM - (i // 2 + 0.5) * pitch
            _draw_marker(axes, "aruco", number, side_mm, (x, y))
            for dx, dy in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                reach = np.array([0.6, _CUT / 2]) * side_mm
                axes.plot(x + dx * reach, y + dy * reach, color="black", linewidth=0.5)

    return Sheet(name, text, paper, draw)


def _check_fish_id(kind: TagKind, number: int) -> None:
    end = TAGS[kind].printed_ids
    if 0 <= number < end:
        return
    why = f" ({end} and up are the ruler's and the tank's)" if TAGS[kind].shared else ""
    raise InputError(f"a fish cannot have {kind} id {number}", f"Take one of 0 to {end - 1}{why}.")


def _check_side(side_mm: float, paper: Paper, columns: int, rows: int) -> None:
    if not side_mm >= SIDE_MM_MIN:
        raise InputError(f"a side of {side_mm:g} mm is too small", f"At least {SIDE_MM_MIN:g} mm.")
    width, height = PAPERS_MM[paper]
    most = min((width - _EDGE_MM) / columns / _CUT, (height - _EDGE_MM - _FOOT_MM) / rows / _CUT)
    if not side_mm <= most:
        raise InputError(
            f"a side of {side_mm:g} mm is too large for {paper} paper",
            f"At most {most:.0f} mm, or larger paper: --paper a3",
        )


def _draw_marker(
    axes: Axes, kind: TagKind, number: int, side_mm: float, middle: tuple[float, float]
) -> None:
    from matplotlib.patches import Rectangle

    corner = (middle[0] - side_mm / 2, middle[1] - side_mm / 2)
    _draw_cells(axes, _cells(TAGS[kind].dictionary(), number), corner, side_mm)
    cut = side_mm * _CUT
    outline = (middle[0] - cut / 2, middle[1] - cut / 2)
    dashes = Rectangle(outline, cut, cut, fill=False, linewidth=0.4, linestyle=(0, (4, 4)))
    axes.add_patch(dashes)
    at = (middle[0] - side_mm / 2, middle[1] - side_mm * 0.685)
    axes.text(*at, f"{kind} {number}", fontsize=max(3.0, side_mm * 0.12), va="bottom", ha="left")


def _draw_head(axes: Axes, x: float, top: float, side_mm: float) -> None:
    """An arrow in the white that stays on the fish."""
    from matplotlib.patches import Polygon

    high, half = side_mm * 0.06, side_mm * 0.05
    base = top - side_mm * 0.08
    corners = np.array([[x - half, base], [x + half, base], [x, base + high]])
    axes.add_patch(Polygon(corners, facecolor="black", linewidth=0))
    axes.text(x + 2 * half, base, "head", fontsize=max(3.0, side_mm * 0.13), va="bottom")


def _draw_foot(axes: Axes, text: str, width_mm: float) -> None:
    import textwrap

    x, y = (width_mm - 100) / 2, 22.0
    axes.plot([x, x + 100], [y, y], color="black", linewidth=0.6)
    for end in (x, x + 100):
        axes.plot([end, end], [y - 2, y + 2], color="black", linewidth=0.6)
    rule = "100 mm: measure it. If it is not, print again at 100 % (actual size)."
    axes.text(width_mm / 2, y - 1.5, rule, fontsize=8, ha="center", va="top")
    words = "\n".join(textwrap.wrap(text, round(width_mm / 1.75)))
    axes.text(width_mm / 2, y - 6.5, words, fontsize=8, ha="center", va="top")


def _cells(words: Any, number: int) -> Cells:
    size = words.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(words, number, size)) < 128


def _draw_cells(axes: Axes, cells: Cells, corner: tuple[float, float], side_mm: float) -> None:
    """Black first, then the white in it: in runs along and across, so that no seam shows."""
    cell = side_mm / len(cells)
    _boxes(axes, [(*corner, side_mm, side_mm)])
    white = []
    for row, first, last in _white_runs(cells):
        y = corner[1] + side_mm - (row + 1) * cell
        white.append((corner[0] + first * cell, y, (last - first) * cell, cell))
    for column, first, last in _white_runs(cells.T):
        y, high = corner[1] + side_mm - last * cell, (last - first) * cell
        white.append((corner[0] + column * cell, y, cell, high))
    _boxes(axes, white, "white")


def _white_runs(cells: Cells) -> Iterator[tuple[int, int, int]]:
    for i, row in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[True], row, [True]]).astype(int)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            yield i, int(first), int(last)


def _boxes(
    axes: Axes, boxes: list[tuple[float, float, float, float]], colour: str = "black"
) -> None:
    """Each x, y, width, height, filled."""
    from matplotlib.collections import PolyCollection

    corners = [corners_of(x, y, x + w, y + h) for x, y, w, h in boxes]
    filled = PolyCollection(corners, facecolors=colour, linewidths=0, edgecolors="none")
    filled.set_snap(False)
    axes.add_collection(filled, autolim=False)
