"""Finds the servo pulse with the tail straight, from how the fish turns over two short swims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.fish import Fish, Guard


@dataclass(frozen=True)
class TrimSwim:
    """One of the two: its centre, and how the fish turned per metre, clockwise from above."""

    centre_us: float
    turn_rad_m: float
    sigma_rad_m: float


@dataclass(frozen=True)
class Trim:
    """``centre_us``: where it would swim straight, by the line through the swims; with its standard
    deviation. ``source``: of the turns, ``imu`` or ``camera``. ``was_us``: what was set."""

    was_us: float
    centre_us: float
    sigma_us: float
    swims: tuple[TrimSwim, TrimSwim]
    source: str


def find_centre(
    fish: Fish, person: Person, camera: Camera | None = None, guard: Guard | None = None
) -> Trim:
    """Swims twice, the tail centred a little to either side of what is set, and puts back what the
    board had learned, its reference and its centre. Raises InputError when the turns do not tell a
    centre (none was felt, the two are alike, or the centre would lie beyond the servo's range)."""
    raise NotImplementedError
