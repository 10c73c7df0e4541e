"""Single pictures, for calibrating: from picture files, folders of them, and films."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image
from tailbeat.errors import InputError, reason

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
    cv2 = need_cv2()
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
    from tailbeat.camera.pictures.film import Film

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
    from tailbeat.camera.pictures.film import Film

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
    cv2 = need_cv2()
    return float(cv2.Laplacian(grey[::2, ::2], cv2.CV_16S).std())
