"""The simulated board's camera as pictures: a fake device, in simulated time."""

from __future__ import annotations

from typing import Literal

from tailbeat.camera.pictures import Picture
from tailbeat.camera.rendered.scene import Scene
from tailbeat.transport.simulated import SimulatedBoard


class RenderedDevice:
    """Pictures of a simulated board in this process (pictures.PictureSource), as they come due.

    The simulator's own camera noise is how far the drawn fish is off the truth in each picture;
    its lost frames are pictures that never come. read() never blocks; None = none due yet.
    """

    name: str
    clock: Literal["video", "host", "board"]
    fps: float
    size_px: tuple[int, int]

    def __init__(self, board: SimulatedBoard, scene: Scene | None = None) -> None:
        raise NotImplementedError

    def read(self) -> Picture | None:
        """The next picture that is due."""
        raise NotImplementedError

    @property
    def ended(self) -> bool:
        """Never."""
        raise NotImplementedError

    def close(self) -> None:
        """The simulator need not stop for pictures any more."""
        raise NotImplementedError
