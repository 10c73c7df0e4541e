"""What the ritual asks for, what it finds, and how it says no."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.travel import Travel


class NotReady(TailbeatError):
    """A swim may not begin; nothing on the board has changed."""


class BatteryLow(NotReady):
    """Before anything has swum; the board would not arm."""


class GivenUp(NotReady):
    """The person did not want to wait any longer."""


@dataclass(frozen=True)
class Wanted:
    """What is asked for. Times in s of board time. ``rest_s`` since the last swim's end.
    ``drift_max_m_s`` over ``still_s``; 0 s = not looked at. ``countdown_s``: 0 to 60.
    ``patience_s``: how long a step may take after the rest. ``start_yaw_deg``: of the IMU at an
    earlier start of the same series; None = not compared."""

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
    """Where the fish lies: mean over a second. ``source`` ``camera``: position and heading in the
    tank's frame, and ``yaw_deg`` (VN-100, as mounted) if there is an IMU; ``imu``: the yaw only.
    None = not known."""

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
