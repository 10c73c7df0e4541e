"""What every camera gives, once its pictures are understood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from tailbeat.core.errors import TailbeatError


class CameraGone(TailbeatError):
    """A camera that was there will give no picture any more: unplugged, ended."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Where the fish was when a picture was taken, in the tank's frame: x along the swim direction,
    y to the right of it, heading clockwise from x as seen from above."""

    t_s: float
    x_m: float
    y_m: float = 0.0
    heading_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Unseen:
    """For a guard: up to ``t_s`` (the clock of the frames) no newer picture showed the fish."""

    t_s: float


@dataclass(frozen=True, slots=True)
class TrackReset:
    """For a guard: what was seen before counts no more, the fish may have been carried."""


class Camera(Protocol):
    """A stream of positions.

    ``clock`` says what ``t_s`` counts: "host" = the clock of the transport to the board (for a real
    link time.monotonic()), "board" = seconds since the board booted.
    """

    clock: Literal["host", "board"]
    fps: float

    def frames(self) -> list[Frame]:
        """Frames since the last call, in order of time; never blocks. Raises, once and after the
        frames before it, CameraGone, or InputError when what is seen makes no sense (two fish)."""

    def close(self) -> None:
        """Gives the camera up."""
