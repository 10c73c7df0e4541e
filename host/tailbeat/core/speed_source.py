"""What every camera gives, once its pictures are understood.

The sources of speed that SPD_SOURCE chooses from, by the firmware's own table.

firmware/speed/sources.def; a row is added there and needs nothing here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from tailbeat.core.errors import TailbeatError
from tailbeat.core.native import ffi, lib


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


PARAMETER = "SPD_SOURCE"


@dataclass(frozen=True)
class SpeedSource:
    """One row of the table; the traits are those of firmware/speed/source.h."""

    number: int
    name: str
    estimated: bool
    sampled: bool
    modelled: bool
    needs_imu: bool
    needs_rests: bool
    live: bool

    @property
    def uploaded(self) -> bool:
        """Whether the speeds come from a host after the trial, computed elsewhere."""
        return not self.estimated


def speed_source(params: Mapping[str, float]) -> SpeedSource:
    """The source that ``params`` choose; the first one when they do not say."""
    return source_info(round(params.get(PARAMETER, 0.0)))


def source_info(number: int) -> SpeedSource:
    """The row of ``number``; one that needs nothing when the table has none (newer firmware)."""
    known = number in range(lib.SPEED_SOURCE_COUNT)
    name = ffi.string(lib.speed_source_name(number)).decode() if known else f"source {number}"
    traits = (
        lib.SPEED_ESTIMATED,
        lib.SPEED_SAMPLED,
        lib.SPEED_MODELLED,
        lib.SPEED_NEEDS_IMU,
        lib.SPEED_NEEDS_RESTS,
        lib.SPEED_LIVE,
    )
    return SpeedSource(number, name, *(known and lib.speed_source_is(number, t) for t in traits))


def source_number(name: str) -> int:
    """The value of SPD_SOURCE for the source called ``name``."""
    numbers = range(lib.SPEED_SOURCE_COUNT)
    return next(number for number in numbers if source_info(number).name == name)
