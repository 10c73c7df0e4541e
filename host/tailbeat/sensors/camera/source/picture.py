"""Pictures with the time they were taken at: from video files, devices and simulated tanks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tailbeat.sensors.camera.calibration.file import Calibration

Image = NDArray[np.uint8]
Clock = Literal["video", "host", "board"]
"""What time stamps count: "video" = seconds since the file's first picture, "host" = the clock of
the transport to the board (time.monotonic() for a real device), "board" = the board's."""


@dataclass(frozen=True, slots=True)
class TimedImage:
    """One picture. ``image`` is grey, shape (height, width); it belongs to whoever holds the
    picture. ``index`` counts pictures taken, lost ones included where that is known. ``t_s`` is the
    time stamp of this very picture, never index/fps."""

    index: int
    t_s: float
    image: Image


class PictureSource(Protocol):
    """Pictures in order of time. ``pictures``: about how many there will be, None = not known.
    ``calibration``: its own, None = it has none. ``ended``: no picture will ever come again (end of
    the file, device gone)."""

    name: str
    clock: Clock
    fps: float
    size_px: tuple[int, int]  # width, height
    pictures: int | None = None
    calibration: Calibration | None = None
    ended: bool = False

    def read(self) -> TimedImage | None:
        """The next picture; None = none now (a device in virtual time) or none ever (``ended``).
        A real device blocks until its next picture, 2 s at most."""

    def close(self) -> None:
        """Gives the file or device up; may be called twice."""


def size_of(image: Image) -> tuple[int, int]:
    """Width and height, pixels."""
    return image.shape[1], image.shape[0]
