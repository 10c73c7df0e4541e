"""Video files: reading with the time stamp of every picture, and writing with them."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Literal

from tailbeat.camera.pictures import Image, Picture


class Film:
    """A video file (pictures.PictureSource), read with PyAV; grey pictures unless ``colour``.

    Time stamps are the file's own, from its first picture; a file with a variable frame rate is as
    good as any. Raises InputError: not there, no video in it, unreadable from here on (what came
    before is good), time stamps that do not rise or are missing.
    """

    name: str
    clock: Literal["video", "host", "board"]
    fps: float
    size_px: tuple[int, int]

    def __init__(self, path: Path, colour: bool = False) -> None:
        raise NotImplementedError

    @property
    def pictures(self) -> int | None:
        """How many it should have, by its header; None = not told."""
        raise NotImplementedError

    def read(self) -> Picture | None:
        """The next picture; None at the end."""
        raise NotImplementedError

    @property
    def ended(self) -> bool:
        """Whether all were read."""
        raise NotImplementedError

    def close(self) -> None:
        """Closes the file; may be called twice."""
        raise NotImplementedError


class FilmWriter:
    """Writes pictures with their time stamps, to the millisecond or better, into ``path`` (.mp4 or
    .mkv, H.264). The file has another name until close(); an error leaves nothing half-written:
    use it as a context manager."""

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        raise NotImplementedError

    def add(self, image: Image, t_s: float) -> None:
        """The next picture, grey or BGR; times rise."""
        raise NotImplementedError

    def close(self) -> None:
        """Finishes the file and gives it its name."""
        raise NotImplementedError

    def discard(self) -> None:
        """Drops what was written."""
        raise NotImplementedError

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()
