"""A hand that turns a simulated fish round as the IMU's calibration asks for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from tailbeat.sim.world import World

TURN_S, REST_S = 4.0, 3.5
_Q = 0.5 * math.pi


def rounds() -> Iterator[tuple[float, float, float]]:
    """(roll, pitch, yaw), rad: in quarter turns all round, and back in a whole one; about the long
    axis, nose over tail, and nose over tail lying on its side."""
    yield from ((quarter * _Q, 0.0, 0.0) for quarter in (1, 2, 3, 4, 0))
    yield from ((0.0, quarter * _Q, 0.0) for quarter in (1, 2, 3, 4, 0))
    yield from ((_Q, quarter * _Q, 0.0) for quarter in (0, 1, 2, 3, 4, 0))
    yield 0.0, 0.0, 0.0


@dataclass
class Hand:
    """Turns, then holds still, again and again, for as long as it is told the time."""

    world: World
    _next_s: float | None = None
    _left: Iterator[tuple[float, float, float]] = field(default_factory=rounds)

    def follow(self, time_s: float) -> None:
        """Once it is time for the next turn, begins it."""
        if self._next_s is None:
            self._next_s = time_s + REST_S
        if time_s < self._next_s:
            return
        self._next_s = time_s + TURN_S + REST_S
        if (turn := next(self._left, None)) is None:
            self._left = rounds()
            turn = next(self._left)
        self.world.turn(*turn, TURN_S)

    def put_back(self) -> None:
        """As it was."""
        self.world.turn(0.0, 0.0, 0.0, TURN_S)
