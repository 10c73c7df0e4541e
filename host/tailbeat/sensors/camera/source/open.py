"""A film or a camera, by what somebody typed.

Single pictures, for calibrating: from picture files, folders of them, and films.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from tailbeat.core.errors import InputError, reason
from tailbeat.sensors.camera.opencv import cv2
from tailbeat.sensors.camera.source.device import Device
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.source.picture import Image, PictureSource, TimedImage

DEVICE_S = 60.0


def open_source(
    what: str,
    seconds: float | None = None,
    latency_s: float = 0.0,
    size_px: tuple[int, int] | None = None,
) -> PictureSource:
    """A film for the name of a file, else a device (a number, /dev/...), asked for pictures of
    ``size_px``. ``seconds``: so much of it from its first picture on; None = all of a film,
    DEVICE_S of a device. Raises InputError."""
    if _is_device(what):
        return Beginning(Device(what, size_px, latency_s=latency_s), seconds or DEVICE_S)

    film = Film(Path(what))
    return film if seconds is None else Beginning(film, seconds)


def _is_device(what: str) -> bool:
    return not Path(what).is_file() and (what.isdecimal() or what.startswith("/dev/"))


class Beginning:
    """The first ``seconds`` of another source (pictures.PictureSource), which it takes over."""

    clock: Literal["video", "host", "board"]

    def __init__(self, source: PictureSource, seconds: float) -> None:
        self._source = source
        self._seconds = seconds
        self._first_s: float | None = None
        self._over = False
        self.name, self.clock = source.name, source.clock
        self.fps, self.size_px = source.fps, source.size_px

    def read(self) -> TimedImage | None:
        """The next picture."""
        picture = None if self._over else self._source.read()
        if picture is None:
            return None
        if self._first_s is None:
            self._first_s = picture.t_s
        self._over = picture.t_s - self._first_s >= self._seconds
        return None if self._over else picture

    @property
    def ended(self) -> bool:
        """Whether the time is over, or the source has ended."""
        return self._over or self._source.ended

    def close(self) -> None:
        """Closes the source."""
        self._source.close()


_FILMS = (".mp4", ".mkv", ".mov", ".avi", ".m4v", ".mts")
_STILLS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_BYTES_MAX = 200_000_000
_FROM_FILM = 30
_USUAL_PICTURES = 750  # of a film that does not tell: half a minute


def read_all(paths: list[Path]) -> Iterator[tuple[str, Image]]:
    """Names and grey pictures of files, of all in folders, and the sharpest of each part of films.
    Raises InputError for what cannot be read, and a folder without pictures."""
    for path in paths:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in _STILLS + _FILMS)
            if not inside:
                raise InputError(f"{path} holds no pictures", "Give a folder of PNG or JPEG files.")
            yield from read_all(inside)
        elif path.suffix.lower() in _FILMS:
            yield from _sharpest_of_film(path)
        else:
            yield str(path), read_grey(path)


def read_grey(path: Path) -> Image:
    """A picture's file, or the first picture of a film. Raises InputError.

    As the sensor saw it: a film's pictures are not turned by a note in the file, so neither are
    these."""
    if path.suffix.lower() in _FILMS:
        return _first_of_film(path)
    try:
        if path.stat().st_size > _BYTES_MAX:
            raise InputError(f"{path} is too large for a picture", "Give a PNG or JPEG file.")
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {reason(error)}", "Check the name.") from error
    try:
        found = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        found = None
    if found is None:
        raise InputError(f"{path} is no picture", "Give a PNG or JPEG file, or a film.")
    picture: Image = found
    return picture


def _first_of_film(path: Path) -> Image:

    film = Film(path)
    try:
        picture = film.read()
    finally:
        film.close()
    if picture is None:
        raise InputError(f"{path} has no pictures", "Give another film, or a PNG or JPEG file.")
    return picture.image


def _sharpest_of_film(path: Path) -> Iterator[tuple[str, Image]]:
    """A film is cut into parts of the same length; the sharpest picture of each."""

    film = Film(path)
    part = max(1, -(-(film.pictures or _USUAL_PICTURES) // _FROM_FILM))
    try:
        best: tuple[float, str, Image] | None = None
        count = 0
        while (picture := film.read()) is not None:
            sharp = _sharpness(picture.image)
            if best is None or sharp > best[0]:
                best = (sharp, f"{path} at {picture.t_s:.1f} s", picture.image)
            count += 1
            if count % part == 0:
                yield best[1:]
                best = None
        if best is not None:
            yield best[1:]
    finally:
        film.close()


def _sharpness(grey: Image) -> float:
    return float(cv2.Laplacian(grey[::2, ::2], cv2.CV_16S).std())
