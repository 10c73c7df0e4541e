"""Whether the fish swam straight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.camera.base import Frame
    from tailbeat.trial_log import Trial

CROOKED_RAD = math.radians(15.0)


@dataclass(frozen=True)
class Straightness:
    """Headings are means over whole beats, against the direction in which the swim began, positive
    clockwise from above. ``mean_yaw_rad``: over the swim; ``worst_yaw_rad``: the farthest off, with
    its sign; ``curvature_1_m``: turn per metre swum, NaN when it hardly moved. ``source``: ``imu``
    or ``camera``."""

    mean_yaw_rad: float
    worst_yaw_rad: float
    curvature_1_m: float
    source: str

    @property
    def crooked(self) -> bool:
        """Beyond 15 degrees: its speed along the way is no longer the one that was wanted."""
        return abs(self.worst_yaw_rad) > CROOKED_RAD


def straightness(trial: Trial) -> Straightness | None:
    """By the turns its IMU felt; None when they are not in the file."""
    raise NotImplementedError


def straightness_of_frames(
    frames: Sequence[Frame], begin_s: float, beats: int, beat_s: float
) -> Straightness | None:
    """By what a camera saw from ``begin_s`` on (the clock of the frames); None when it saw too
    little (fewer than half of the beats)."""
    raise NotImplementedError
