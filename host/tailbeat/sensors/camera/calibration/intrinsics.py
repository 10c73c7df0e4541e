"""The camera itself: focal length and distortion, from pictures of the ChArUco board."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.marker.tags import BOARD_SQUARES, board
from tailbeat.sensors.camera.source.picture import Image, size_of

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
    board_points: F32
    corners_px: F32
    blur_px: float


class Viewer:
    """Finds the board of ``tailbeat camera print board``."""

    def __init__(self) -> None:
        self._board = board()
        self._detector = cv2.aruco.CharucoDetector(self._board)

    def view(self, name: str, grey: Image) -> View | str:
        """What is seen of the board in a picture, or why that is of no use."""
        corners, ids, _, _ = self._detector.detectBoard(grey)
        count = 0 if ids is None else len(ids)
        if count < CORNERS_MIN:
            few = f"{count} corners of the board, at least {CORNERS_MIN} are needed"
            return few if count else "the board was not found"
        if self._board.checkCharucoCornersCollinear(ids):
            return "the corners found lie on one line"
        points, pixels = self._board.matchImagePoints(corners, ids)
        blur = _blur_px(grey, np.ravel(ids), corners.reshape(-1, 2).astype(float))
        return View(name, points, pixels, blur)


def _blur_px(grey: Image, ids: NDArray[Any], corners: F64) -> float:
    """An edge blurred with standard deviation s rises by its contrast / (s sqrt(2 pi)) per pixel.
    Measured across both edges that cross in a corner; the median over corners of the worse one."""
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


def _steepest(slopes: tuple[F64, ...], edge: F64) -> float:
    """Across an edge that runs along ``edge``."""
    across = np.array([-edge[1], edge[0]]) / np.linalg.norm(edge)
    return float(np.abs(across[0] * slopes[0] + across[1] * slopes[1]).max())


def _edges(number: int, where: dict[int, F64]) -> tuple[F64, F64] | None:
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


VIEWS_MIN = 8
RMS_MAX_PX = 1.0
FOCAL_SIGMA_MAX = 0.02
TILT_MIN_RAD, TILTED_MIN = 0.15, 3
_K3_GAIN = 0.9  # the third radial coefficient must make the rms this much smaller to be believed
_BLUR_MAX_PX, _BLUR_OVER_MEDIAN, _BLUR_FINE_PX = 4.0, 2.0, 1.5
_ERROR_OVER_MEDIAN, _ERROR_FINE_PX = 3.0, 0.3
_MORE = "Take 15 pictures: the board in every part of the picture, tilted this way and that."


@dataclass(frozen=True)
class Intrinsics:
    """A camera. ``dropped``: name of a picture -> why it was not used. ``unseen``: parts of the
    picture (of three by three) in which no corner of the board ever lay; ``covered``: share of
    8 x 6 parts in which some did. ``focal_sigma``: relative standard deviation of the focal
    length."""

    size_px: tuple[int, int]
    camera_matrix: F64
    distortion: F64
    rms_px: float
    used: tuple[str, ...]
    dropped: dict[str, str]
    unseen: tuple[str, ...]
    covered: float
    focal_sigma: float


def find_intrinsics(
    pictures: Iterable[tuple[str, Image]], look: Callable[[str], None] = lambda name: None
) -> Intrinsics:
    """From grey pictures with their names; ``look`` is told each name before it is looked at.
    Raises InputError: pictures of different sizes, fewer than eight of use, all held the same way,
    more than 1 px left over."""
    viewer = Viewer()
    sizes: dict[str, tuple[int, int]] = {}
    views: list[View] = []
    dropped: dict[str, str] = {}
    for name, image in pictures:
        look(name)
        sizes[name] = size_of(image)
        seen = viewer.view(name, image)
        if isinstance(seen, str):
            dropped[name] = seen
        else:
            views.append(seen)
    size_px = _one_size(sizes)
    sharp = _without_blurred(views, dropped)
    _check_enough(sharp, dropped)
    found, kept = _fit_without_outliers(sharp, size_px, dropped)
    return _judged(found, kept, size_px, dropped)


@dataclass(frozen=True)
class _LensFit:
    rms_px: float
    matrix: F64
    distortion: F64
    focal_sigma: float
    errors_px: F64
    tilts_rad: F64


def _one_size(sizes: dict[str, tuple[int, int]]) -> tuple[int, int]:
    if not sizes:
        raise InputError("there are no pictures of the board", _MORE)
    common, _ = Counter(sizes.values()).most_common(1)[0]
    odd = [f"{name} has {w}x{h}" for name, (w, h) in sizes.items() if (w, h) != common]
    if odd:
        raise InputError(
            f"the pictures of the board differ in size: {_listed(odd)}, others "
            f"{common[0]}x{common[1]}",
            "Use pictures of one camera in one setting: the one that films the fish.",
        )
    return common


def _without_blurred(views: list[View], dropped: dict[str, str]) -> list[View]:
    if not views:
        return []
    usual = float(np.median([view.blur_px for view in views]))
    limit = min(max(usual * _BLUR_OVER_MEDIAN, _BLUR_FINE_PX), _BLUR_MAX_PX)
    blurred = [view for view in views if view.blur_px > limit]
    dropped.update({view.name: f"blurred ({view.blur_px:.1f} px)" for view in blurred})
    return [view for view in views if view.blur_px <= limit]


def _check_enough(views: list[View], dropped: dict[str, str]) -> None:
    if len(views) < VIEWS_MIN:
        why = _listed([f"{name}: {text}" for name, text in dropped.items()])
        raise InputError(
            f"{len(views)} pictures of the board are of use, {VIEWS_MIN} are needed"
            + (f" ({why})" if why else ""),
            _MORE,
        )


def _fit_without_outliers(
    views: list[View], size_px: tuple[int, int], dropped: dict[str, str]
) -> tuple[_LensFit, list[View]]:
    """A picture that fits far worse than the others was taken while something moved."""
    found = _fit(views, size_px)
    limit = max(_ERROR_FINE_PX, _ERROR_OVER_MEDIAN * float(np.median(found.errors_px)))
    kept = [view for view, off in zip(views, found.errors_px, strict=True) if off <= limit]
    if len(kept) == len(views):
        return found, views
    worse = [(v.name, off) for v, off in zip(views, found.errors_px, strict=True) if off > limit]
    dropped.update({name: f"does not fit the others ({off:.1f} px)" for name, off in worse})
    _check_enough(kept, dropped)
    return _fit(kept, size_px), kept


def _fit(views: list[View], size_px: tuple[int, int]) -> _LensFit:
    """With the third radial coefficient only where it is needed: it is ill determined, and wild
    outside the corners seen."""
    plain = _calibrated(views, size_px, cv2.CALIB_FIX_K3)
    free = _calibrated(views, size_px, 0)
    return free if free.rms_px < _K3_GAIN * plain.rms_px else plain


def _calibrated(views: list[View], size_px: tuple[int, int], flags: int) -> _LensFit:
    try:
        rms, matrix, distortion, turns, _, sigma, _, errors = cv2.calibrateCameraExtended(
            [view.board_points for view in views],
            [view.corners_px for view in views],
            size_px,
            None,
            None,
            flags=flags,
        )
    except cv2.error as error:
        raise InputError("no camera fits these pictures of the board", _MORE) from error
    focal_sigma = float(np.max(np.ravel(sigma)[:2] / matrix[[0, 1], [0, 1]]))
    tilts = np.array([np.arccos(abs(cv2.Rodrigues(turn)[0][2, 2])) for turn in turns])
    return _LensFit(
        float(rms), matrix, np.ravel(distortion)[:5], focal_sigma, np.ravel(errors), tilts
    )


def _judged(
    found: _LensFit, views: list[View], size_px: tuple[int, int], dropped: dict[str, str]
) -> Intrinsics:
    if not found.rms_px <= RMS_MAX_PX:
        raise InputError(
            f"the pictures of the board fit a camera only to {found.rms_px:.2f} px "
            f"(at most {RMS_MAX_PX:g})",
            "Is the board flat? Is it the printed one? Were zoom and focus fixed? Take new ones.",
        )
    # without any tilt OpenCV's sigma is tiny while the focal length is anything
    tilted = int((found.tilts_rad > TILT_MIN_RAD).sum())
    if tilted < TILTED_MIN or not found.focal_sigma <= FOCAL_SIGMA_MAX:
        raise InputError(
            "the focal length cannot be determined from these pictures. The board was held the same"
            f" way in nearly all of them ({tilted} are tilted)",
            "Tilt the board by about 30 degrees, each time to another side.",
        )
    unseen, covered = _coverage(views, size_px)
    used = tuple(view.name for view in views)
    return Intrinsics(
        size_px, found.matrix, found.distortion, found.rms_px, used, dropped, unseen, covered,
        found.focal_sigma,
    )  # fmt: skip


_PARTS = (
    ("upper left", "upper middle", "upper right"),
    ("middle left", "middle", "middle right"),
    ("lower left", "lower middle", "lower right"),
)


def _coverage(views: list[View], size_px: tuple[int, int]) -> tuple[tuple[str, ...], float]:
    corners = np.concatenate([view.corners_px.reshape(-1, 2) for view in views]) + 0.5
    counts = [
        np.histogram2d(corners[:, 1], corners[:, 0], parts, ((0, size_px[1]), (0, size_px[0])))[0]
        for parts in ((3, 3), (6, 8))
    ]
    unseen = [_PARTS[row][column] for row, column in np.argwhere(counts[0] == 0)]
    return tuple(unseen), float((counts[1] > 0).mean())


def _listed(items: list[str], most: int = 4) -> str:
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(items[:most]) + more
