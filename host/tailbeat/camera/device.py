"""Cameras on this computer, by OpenCV."""

from __future__ import annotations

from typing import Literal

from tailbeat.camera.pictures import Picture


class Device:
    """A camera (pictures.PictureSource), ``address`` = its number or path (0, /dev/video0).

    Time stamps: the driver's where it gives any in the clock of time.monotonic() (V4L2 does),
    otherwise the moment of arrival; ``stamps`` says which. ``latency_s`` is taken off arrivals.
    Raises InputError when it cannot be opened or is unplugged (read).
    """

    name: str
    clock: Literal["video", "host", "board"]
    fps: float
    size_px: tuple[int, int]
    stamps: Literal["driver", "arrival"]

    def __init__(
        self,
        address: str,
        size_px: tuple[int, int] | None = None,
        fps: float | None = None,
        latency_s: float = 0.0,
    ) -> None:
        raise NotImplementedError

    def read(self) -> Picture | None:
        """Waits for the next picture, 2 s at most."""
        raise NotImplementedError

    @property
    def ended(self) -> bool:
        """Whether it is gone."""
        raise NotImplementedError

    def close(self) -> None:
        """Gives it up; may be called twice."""
        raise NotImplementedError
