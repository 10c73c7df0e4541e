"""The fish as its IMU feels it before a swim: where the nose points, whether it lies level, and
whether something moves it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tailbeat.vn100.problems import STARTING

if TYPE_CHECKING:
    from tailbeat.day.step import Step
    from tailbeat.fish import Fish
    from tailbeat.link import Message

_OVER_S = 1.2  # of board time, so that two lines a second apart are in it
_LEAST_S = 0.8
_SILENT_S = 2.5  # board time without a line of it
_VERDICT_S = 6.0  # of board time, after which the board knows what IMU there is


@dataclass(frozen=True)
class Attitude:
    """Mean over a second, degrees."""

    yaw_deg: float
    pitch_deg: float
    roll_deg: float


class Feel:
    """Listens to TAILBEAT_LIVE and, for a board that sends none, ATTITUDE, until closed."""

    def __init__(self, fish: Fish) -> None:
        self._fish = fish
        self._lines: deque[tuple[float, float, float, float]] = deque(maxlen=256)
        self._heard_at_s = fish.transport.now_s()
        self.close = fish.link.subscribe(self._hear)

    @classmethod
    def of(cls, fish: Fish, step: Step) -> Feel | None:
        """None when the board has no IMU that streams; waits until it knows."""
        while (info := fish.imu_info()).problem.number == STARTING:
            if step.elapsed_s > _VERDICT_S:
                break
            step.tell("waits for the IMU")
            step.wait()
        return cls(fish) if info.state == "streaming" else None

    def attitude(self) -> Attitude | None:
        """None when too little has come lately."""
        silent_s = (self._fish.transport.now_s() - self._heard_at_s) * self._fish.clock.rate
        if not self._lines or silent_s > _SILENT_S:
            return None
        lines = [line for line in self._lines if line[0] >= self._lines[-1][0] - _OVER_S]
        if lines[-1][0] - lines[0][0] < _LEAST_S:
            return None
        yaw, pitch, roll = (mean_angle(line[i] for line in lines)[0] for i in (1, 2, 3))
        return Attitude(math.degrees(yaw), math.degrees(pitch), math.degrees(roll))

    def still_s(self) -> float:
        """How long nothing has moved the fish."""
        return float(self._fish.link.request("TAILBEAT_IMU_INFO").still_s)

    def _hear(self, message: Message) -> None:
        kind = message.get_type()
        if kind == "TAILBEAT_LIVE":
            angles = (message.yaw_rad, message.pitch_rad, message.roll_rad)
        elif kind == "ATTITUDE":
            angles = (message.yaw, message.pitch, message.roll)
        else:
            return
        if not all(map(math.isfinite, angles)):
            return
        time_s = message.time_boot_ms * 1e-3
        if self._lines and time_s < self._lines[-1][0] - _OVER_S:
            self._lines.clear()  # the board has restarted
        self._lines.append((time_s, *angles))
        self._heard_at_s = self._fish.transport.now_s()


def mean_angle(angles_rad: Iterable[float]) -> tuple[float, float]:
    """Circular mean, and how well they agree: 1 = all the same, 0 = none with another."""
    held = list(angles_rad)
    along = math.fsum(map(math.cos, held)) / len(held)
    across = math.fsum(map(math.sin, held)) / len(held)
    return math.atan2(across, along), math.hypot(along, across)


def wrapped_deg(angle_deg: float) -> float:
    """The same direction in -180 to 180."""
    return (angle_deg + 180.0) % 360.0 - 180.0
