"""Opens whatever a user names as a source of pictures, and reads single pictures to calibrate by.

``SOURCES`` is the table of all kinds; a new one is a module with a ``PictureSource`` and an entry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from tailbeat.core.errors import InputError, reason
from tailbeat.core.speed_source import Camera
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.render.source import (
    RemoteCamera,
    RenderedDevice,
    SimulatedCamera,
    scene_of,
)
from tailbeat.sensors.camera.source.device import Device
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.source.picture import Image, PictureSource, TimedImage


@dataclass(frozen=True)
class SourceOptions:
    """What opening a source may need. ``size_px``: to ask a device for. ``latency_s``: of a
    device's pictures without a time stamp. ``simulated``: gives the camera of a simulated board;
    ``marker``: on the fish that is drawn."""

    size_px: tuple[int, int] | None = None
    latency_s: float = 0.0
    simulated: Callable[[], Camera | None] = lambda: None
    marker: Marker = field(default_factory=Marker)


def _rendered(_: str, options: SourceOptions) -> RenderedDevice:
    camera, marker = options.simulated(), options.marker
    if not isinstance(camera, SimulatedCamera | RemoteCamera):
        raise InputError("only a simulated fish can be drawn", "Start one: tailbeat sim")
    usual = scene_of(camera)
    scene = replace(
        usual,
        marker=marker.kind,
        marker_id=usual.marker_id if marker.id is None else marker.id,
        marker_side_m=usual.marker_side_m if marker.side_m is None else marker.side_m,
    )
    return RenderedDevice(camera, scene)


@dataclass(frozen=True)
class SourceType:
    """A kind of source. ``matches``: whether a user's text names one. ``open`` raises InputError.
    ``seconds``: how much of it is tracked unless something else is asked for; None = all.
    ``simulated``: it runs in virtual time, so that reading never waits, and has a calibration."""

    matches: Callable[[str], bool]
    open: Callable[[str, SourceOptions], PictureSource]
    seconds: float | None = None
    simulated: bool = False


# Every kind of source; the first that matches counts.
SOURCES: dict[str, SourceType] = {
    "rendered": SourceType(lambda text: text == "rendered", _rendered, simulated=True),
    "film": SourceType(lambda text: Path(text).is_file(), lambda text, _: Film(Path(text))),
    "device": SourceType(
        lambda text: text.isdecimal() or text.startswith("/dev/"),
        lambda text, options: Device(text, options.size_px, options.latency_s),
        seconds=60.0,
    ),
}


def live_source(text: str) -> SourceType:
    """The kind of source for a trial; a device when it looks like nothing."""
    return _matching(text) or SOURCES["device"]


def _matching(text: str) -> SourceType | None:
    return next((kind for kind in SOURCES.values() if kind.matches(text)), None)


def open_source(
    text: str, options: SourceOptions | None = None, seconds: float | None = None
) -> PictureSource:
    """The source to track, a film when it looks like nothing. ``seconds``: so much of it from its
    first picture on; None = as its kind says. Raises InputError."""
    kind = _matching(text)
    if kind is None or kind.simulated:
        kind = SOURCES["film"]
    source = kind.open(text, options or SourceOptions())
    seconds = seconds or kind.seconds
    return source if seconds is None else Beginning(source, seconds)


class Beginning(PictureSource):
    """The first ``seconds`` of another source, which it takes over."""

    def __init__(self, source: PictureSource, seconds: float) -> None:
        self._source = source
        self._seconds = seconds
        self._first_s: float | None = None
        self.name, self.clock = source.name, source.clock
        self.fps, self.size_px = source.fps, source.size_px

    def read(self) -> TimedImage | None:
        """The next picture."""
        picture = None if self.ended else self._source.read()
        if picture is not None:
            self._first_s = picture.t_s if self._first_s is None else self._first_s
            if picture.t_s - self._first_s >= self._seconds:
                self.ended = True
                return None
        self.ended |= self._source.ended
        return picture

    def close(self) -> None:
        """Closes the source."""
        self._source.close()


_FILMS = (".mp4", ".mkv", ".mov", ".avi", ".m4v", ".mts")
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_BYTES_MAX = 200_000_000
_FROM_FILM = 30
_USUAL_PICTURES = 750  # of a film that does not tell: half a minute


def read_all(paths: list[Path]) -> Iterator[tuple[str, Image]]:
    """Names and grey pictures of files, of all in folders, and the sharpest of each part of films.
    Raises InputError for what cannot be read, and a folder without pictures."""
    for path in paths:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in _IMAGES + _FILMS)
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
    with closing(Film(path)) as film:
        picture = film.read()
    if picture is None:
        raise InputError(f"{path} has no pictures", "Give another film, or a PNG or JPEG file.")
    return picture.image


def _sharpest_of_film(path: Path) -> Iterator[tuple[str, Image]]:
    """A film is cut into parts of the same length; the sharpest picture of each."""
    with closing(Film(path)) as film:
        part = max(1, -(-(film.pictures or _USUAL_PICTURES) // _FROM_FILM))
        while best := max(
            (
                (_sharpness(picture.image), f"{path} at {picture.t_s:.1f} s", picture.image)
                for picture in islice(iter(film.read, None), part)
            ),
            key=itemgetter(0),
            default=None,
        ):
            yield best[1:]


def _sharpness(grey: Image) -> float:
    return float(cv2.Laplacian(grey[::2, ::2], cv2.CV_16S).std())
