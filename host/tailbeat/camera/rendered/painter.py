"""Draws one picture."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.camera.pictures import Image
from tailbeat.camera.rendered.scene import Scene


@dataclass(frozen=True, slots=True)
class Truth:
    """The fish in the middle of an exposure: marker's centre and heading in the tank's frame, tail
    angle against the body (positive to the right), part of the exposure the LED was on."""

    t_s: float
    x_m: float
    y_m: float
    heading_rad: float
    tail_rad: float
    led: float


class Painter:
    """Pictures of ``scene``. Deterministic: the same truth and index give the same bytes, whatever
    was drawn before. About 5 ms for 1280x720 on one core: what stands still is drawn once."""

    def __init__(self, scene: Scene) -> None:
        raise NotImplementedError

    def paint(self, truth: Truth, index: int) -> Image:
        """Grey, shape (height, width), a fresh array."""
        raise NotImplementedError
