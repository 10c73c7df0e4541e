"""A film with what the tracker saw drawn into it, for eyes to judge."""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.sensors.camera.marker.tags import Detection
from tailbeat.sensors.camera.opencv import cv2, require_cv2
from tailbeat.sensors.camera.source.film import FilmWriter
from tailbeat.sensors.camera.source.picture import Image, TimedImage
from tailbeat.sensors.camera.tracking.tracker import TrackedImage

_TRAIL_S = 2.0
_DARK, _LIGHT = (30, 30, 30), (255, 255, 255)
_OUTLINE, _TRAIL, _ARROW, _UNSEEN = (0, 220, 0), (0, 200, 255), (60, 60, 255), (60, 60, 255)
_AROUND = ((-1, 0), (1, 0), (0, -1), (0, 1))
_SHIFT = 4  # OpenCV draws at sixteenths of a pixel
_LINE_PX = 720  # height of a picture whose lines are two pixels wide


class Overlay:
    """Writes ``path`` (film.FilmWriter): each picture with the marker's outline, an arrow along the
    heading, the way of the last 2 s, time and state. Call it with what track() gives to
    ``on_place``. The film has its name after close(); use it as a context manager, then an error
    leaves nothing behind."""

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        require_cv2()
        self._film = FilmWriter(path, size_px, fps)
        self._trail: deque[tuple[float, tuple[float, float]]] = deque()

    def __call__(
        self, picture: TimedImage, place: TrackedImage, speed_m_s: float | None = None
    ) -> None:
        """The next picture. ``speed_m_s`` is written beside the time if given."""
        grey = picture.image.ndim == 2
        image: Image = cv2.cvtColor(picture.image, cv2.COLOR_GRAY2BGR) if grey else (
            picture.image.copy()
        )  # fmt: skip
        self._draw_trail(image, place)
        if place.sighting is not None:
            self._draw_sighting(image, place.sighting)
        self._draw_text(image, place, speed_m_s)
        self._film.add(image, picture.t_s)

    def close(self) -> None:
        """Finishes the film and gives it its name."""
        self._film.close()

    def discard(self) -> None:
        """Drops what was drawn."""
        self._film.discard()

    def __enter__(self) -> Overlay:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._film.__exit__(kind, error, trace)

    def _draw_trail(self, image: Image, place: TrackedImage) -> None:
        while self._trail and self._trail[0][0] < place.t_s - _TRAIL_S:
            self._trail.popleft()
        if place.sighting is not None:
            self._trail.append((place.t_s, place.sighting.centre_px))
        self._line(image, [point for _, point in self._trail], _TRAIL, closed=False)

    def _draw_sighting(self, image: Image, sighting: Detection) -> None:
        centre, front = np.array(sighting.centre_px), np.array(sighting.front_px)
        if sighting.corners_px is not None:
            self._line(image, sighting.corners_px, _OUTLINE, closed=True)
        else:
            box = _blob_box(centre, front, sighting.side_px)
            self._line(image, box, _OUTLINE, closed=True)
        ahead = front - centre
        length = max(3 * sighting.side_px, 24.0)
        tip = centre + ahead * (length / max(float(np.linalg.norm(ahead)), 1e-6))
        cv2.arrowedLine(
            image, _fixed(centre), _fixed(tip), _ARROW, _width(image),
            cv2.LINE_AA, _SHIFT, 0.2,
        )  # fmt: skip

    def _draw_text(self, image: Image, place: TrackedImage, speed_m_s: float | None) -> None:
        lines = [(f"{place.t_s:.3f} s", _LIGHT)]
        if place.sighting is None:
            lines.append(("not seen", _UNSEEN))
        else:
            lines.append((f"seen, quality {place.sighting.quality:.2f}", _LIGHT))
        if speed_m_s is not None and math.isfinite(speed_m_s):
            lines.append((f"{speed_m_s * 1e3:.1f} mm/s", _LIGHT))
        scale = image.shape[0] / _LINE_PX
        for row, (text, colour) in enumerate(lines):
            left, base = round(16 * scale), round((34 + 32 * row) * scale)
            # Thicker letters are wider in OpenCV 5: a shadow all around is the same text, shifted.
            for dx, dy, ink in (*((*step, _DARK) for step in _AROUND), (0, 0, colour)):
                cv2.putText(
                    image, text, (left + dx, base + dy), cv2.FONT_HERSHEY_SIMPLEX, 0.9 * scale,
                    ink, 1, cv2.LINE_AA,
                )  # fmt: skip

    def _line(self, image: Image, points: Any, colour: tuple[int, int, int], closed: bool) -> None:
        if len(points) < 2:
            return
        fixed = np.rint(np.asarray(points, np.float64) * 2**_SHIFT).astype(np.int32)
        for ink, more in ((_DARK, 2), (colour, 0)):
            cv2.polylines(
                image, [fixed.reshape(-1, 1, 2)], closed, ink, _width(image) + more,
                cv2.LINE_AA, _SHIFT,
            )  # fmt: skip


def _blob_box(centre: F64, front: F64, side_px: float) -> F64:
    """Corners of a blob: as long as twice the way to its front end, as wide as its side."""
    ahead = front - centre
    aside = np.array([-ahead[1], ahead[0]]) / max(float(np.linalg.norm(ahead)), 1e-6) * side_px / 2
    return np.array([front - aside, front + aside, 2 * centre - front + aside,
                     2 * centre - front - aside])  # fmt: skip


def _fixed(point: F64) -> tuple[int, int]:
    return round(float(point[0]) * 2**_SHIFT), round(float(point[1]) * 2**_SHIFT)


def _width(image: Image) -> int:
    return max(1, round(2 * float(image.shape[0]) / _LINE_PX))
