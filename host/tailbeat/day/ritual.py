"""What must be so before a swim: rest, room, start pose, still water and a still fish; then the
countdown.

Each step is told as it goes (person.Event ``step``); one that cannot be made raises NotReady with
what to do. One that is not there (no camera, no IMU) is told as a notice and left out, never taken
for passed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.fish import Fish
    from tailbeat.travel import Travel


class NotReady(TailbeatError):
    """A swim may not begin; nothing on the board has changed."""


class GivenUp(NotReady):
    """The person did not want to wait any longer."""


@dataclass(frozen=True)
class Wanted:
    """What is asked for. Times in s of board time. ``rest_s`` since the last swim's end.
    ``drift_max_m_s`` over ``still_s``. ``patience_s``: how long a step may take after the rest.
    ``start_yaw_deg``: of the IMU at an earlier start of the same series; None = not compared."""

    rest_s: float = 30.0
    still_s: float = 10.0
    drift_max_m_s: float = 0.002
    heading_max_rad: float = math.radians(10.0)
    aside_max_m: float = 0.10
    countdown_s: float = 5.0
    patience_s: float = 120.0
    start_yaw_deg: float | None = None


@dataclass(frozen=True)
class Pose:
    """Where the fish lies: mean over a second. Camera: position and heading in the tank's frame.
    IMU: only ``yaw_deg`` (VN-100, as mounted); None = not known."""

    source: str
    x_m: float | None = None
    y_m: float | None = None
    heading_rad: float | None = None
    yaw_deg: float | None = None


@dataclass(frozen=True)
class Drift:
    """Speed of a fish that nobody touches: over ground by the camera, so that of the water too; by
    the IMU (``source`` ``imu``) only that nothing moves it, with no speed (NaN)."""

    source: str
    speed_m_s: float
    sigma_m_s: float
    over_s: float


@dataclass(frozen=True)
class Ready:
    """What the ritual found. ``rested_s``: at least; None = has not swum since it was made."""

    travel: Travel
    rested_s: float | None
    pose: Pose | None
    drift: Drift | None
    battery_v: float


def prepare(fish: Fish, wanted: Wanted, camera: Camera | None, person: Person) -> Ready:
    """Goes through all of it up to the countdown, the board IDLE and unarmed all the time. Raises
    NotReady, GivenUp (person.wants_abort), CameraGone, InputError (no room), Refused."""
    raise NotImplementedError


def countdown(fish: Fish, wanted: Wanted, person: Person) -> None:
    """Arms, lets the fish's LED blink and counts down; hands must be out at 0. Disarms and raises
    GivenUp when the person wants it, or whatever else ends it. Returns ARMED."""
    raise NotImplementedError
