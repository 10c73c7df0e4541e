"""A film or a camera, by what somebody typed."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tailbeat.camera.pictures.picture import Picture, PictureSource

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
        from tailbeat.camera.pictures.device import Device

        return Beginning(Device(what, size_px, latency_s=latency_s), seconds or DEVICE_S)
    from tailbeat.camera.pictures.film import Film

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

    def read(self) -> Picture | None:
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
