"""Pictures with the time they were taken at: from video files, devices and simulated tanks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class TimedImage:
    """One picture. ``image`` is grey, shape (height, width), or BGR, shape (height, width, 3); it
    belongs to whoever holds the picture. ``index`` counts pictures taken, lost ones included where
    that is known. ``t_s`` is the time stamp of this very picture, never index/fps."""

    index: int
    t_s: float
    image: Image


class PictureSource(Protocol):
    """Pictures in order of time.

    ``clock``: what ``t_s`` counts: "video" = seconds since the file's first picture, "host" = the
    clock of the transport to the board (time.monotonic() for a real device), "board" = the board's.
    """

    name: str
    clock: Literal["video", "host", "board"]
    fps: float
    size_px: tuple[int, int]  # width, height

    def read(self) -> TimedImage | None:
        """The next picture; None = none now (a device in virtual time) or none ever (``ended``).
        A real device blocks until its next picture, 2 s at most."""

    @property
    def ended(self) -> bool:
        """Whether no picture will ever come again: end of the file, device gone."""

    def close(self) -> None:
        """Gives the file or device up; may be called twice."""
