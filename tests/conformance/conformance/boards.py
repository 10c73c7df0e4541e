"""The boards that the suite runs on, as the runner reaches them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

TICKS_PER_US = 3  # HAL_SERVO_TICKS_PER_US


@dataclass(frozen=True)
class Pulse:
    """A servo pulse that began at ``time_s`` by the board's ``now_s()``."""

    time_s: float
    ticks: float


@dataclass(frozen=True)
class Battery:
    """What the battery should have, and the voltage of the largest reading."""

    volts: float
    full_scale_v: float


class Board(Protocol):
    """A board with the suite in it. Time is the host's on a real board, simulated otherwise."""

    @property
    def name(self) -> str:
        """For the report."""

    @property
    def absent(self) -> Mapping[str, str]:
        """Groups of checks that this board cannot fulfil, with the reason."""

    @property
    def battery(self) -> Battery | None:
        """None: no voltage is known."""

    def now_s(self) -> float:
        """A clock that the board has no part in."""

    def write(self, data: bytes) -> None:
        """Bytes for the console."""

    def read(self, most_s: float) -> bytes:
        """Bytes of the console; returns when some have come or ``most_s`` have passed."""

    def pulses(self, servo: int) -> list[Pulse] | None:
        """All since the last call; None when nothing measures them."""

    def light_changes(self) -> int | None:
        """How often the LED has changed so far; None when nothing sees it."""

    def power_cycle(self) -> bool:
        """Cuts the power for a moment; False when nothing can."""

    def close(self) -> None:
        """Ends the use of it."""


@dataclass
class Unmeasured:
    """What most real boards have no means for; base of the others."""

    absent: Mapping[str, str] = field(default_factory=dict)
    battery: Battery | None = None

    def pulses(self, servo: int) -> list[Pulse] | None:
        """No instrument."""
        del servo
        return None

    def light_changes(self) -> int | None:
        """No instrument."""
        return None

    def power_cycle(self) -> bool:
        """No switch."""
        return False
