"""One picture of the ChArUco board: its corners, and how sharp they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.marker.printed import BOARD_SQUARES, board
from tailbeat.camera.pictures.picture import Image

Floats = NDArray[np.float64]

CORNERS_MIN = 8
_PATCH = 0.3  # of a square: what is looked at around a corner
_PATCH_PX = (3, 20)
_SCHARR = 32.0  # the filter's answer to a slope of one grey level per pixel
_CONTRAST_MIN = 20.0


@dataclass(frozen=True)
class View:
    """``board_points`` (n, 1, 3) float32 in squares and ``corners_px`` (n, 1, 2) float32, as
    cv2.calibrateCamera takes them. ``blur_px``: standard deviation of the blur, in the direction
    where it is worst."""

    name: str
    board_points: NDArray[np.float32]
    corners_px: NDArray[np.float32]
    blur_px: float


class Viewer:
    """Finds the board of ``tailbeat camera print board``."""

    def __init__(self) -> None:
        self._board = board()
        self._detector = need_cv2().aruco.CharucoDetector(self._board)

    def view(self, name: str, grey: Image) -> View | str:
        """What is seen of the board in a picture, or why that is of no use."""
        corners, ids, _, _ = self._detector.detectBoard(grey)
        count = 0 if ids is None else len(ids)
        if count == 0:
            return "the board was not found"
        if count < CORNERS_MIN:
            return f"{count} corners of the board, at least {CORNERS_MIN} are needed"
        if self._board.checkCharucoCornersCollinear(ids):
            return "the corners found lie on one line"
        points, pixels = self._board.matchImagePoints(corners, ids)
        blur = _blur_px(grey, np.ravel(ids), corners.reshape(-1, 2).astype(float))
        return View(name, points, pixels, blur)


def _blur_px(grey: Image, ids: NDArray[Any], corners: Floats) -> float:
    """An edge blurred with standard deviation s rises by its contrast / (s sqrt(2 pi)) per pixel.
    Measured across both edges that cross in a corner; the median over corners of the worse one."""
    cv2: Any = need_cv2()
    where = dict(zip(map(int, ids), corners, strict=True))
    found = []
    for number, corner in where.items():
        edges = _edges(number, where)
        if edges is None:
            continue
        shortest = min(float(np.linalg.norm(edge)) for edge in edges)
        half = int(np.clip(_PATCH * shortest, *_PATCH_PX))
        u, v = np.round(corner).astype(int)
        patch = grey[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
        contrast = float(patch.max()) - float(patch.min())
        if min(patch.shape) < 2 * half or contrast < _CONTRAST_MIN:
            continue
        slopes = (cv2.Scharr(patch, cv2.CV_64F, 1, 0), cv2.Scharr(patch, cv2.CV_64F, 0, 1))
        inner = tuple(slope[1:-1, 1:-1] / _SCHARR for slope in slopes)
        steepest = min(_steepest(inner, edge) for edge in edges)
        found.append(contrast / max(steepest, 1e-6) / np.sqrt(2 * np.pi))
    return float(np.median(found)) if found else np.inf


def _steepest(slopes: tuple[Floats, ...], edge: Floats) -> float:
    """Across an edge that runs along ``edge``."""
    across = np.array([-edge[1], edge[0]]) / np.linalg.norm(edge)
    return float(np.abs(across[0] * slopes[0] + across[1] * slopes[1]).max())


def _edges(number: int, where: dict[int, Floats]) -> tuple[Floats, Floats] | None:
    """The two directions in which the board's lines run through a corner, a square long."""
    columns = BOARD_SQUARES[0] - 1
    column = number % columns
    along = [n for n in (number - 1, number + 1) if 0 <= column + n - number < columns]
    beside = [
        next((where[n] for n in some if n in where), None)
        for some in (along, [number - columns, number + columns])
    ]
    if beside[0] is None or beside[1] is None:
        return None
    return beside[0] - where[number], beside[1] - where[number]
