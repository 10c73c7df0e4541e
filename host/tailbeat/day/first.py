"""The first session with a fish nobody knows: its limits rise step by step, each with the reason.

From the defaults (0.5 rad at most, 0.15 rad per trial): look at the board, trim, identify with
gentle runs, design gain and lead, then allow as much amplitude as the reference needs and the tank
has room for. A step that fails leaves the limits where they were.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.fish import Fish, Guard
    from tailbeat.model.identified import Identified
    from tailbeat.reference import Reference
    from tailbeat.straight import Straightness

RAISE_MAX_RAD = 0.1


@dataclass(frozen=True)
class Raise:
    """A limit that may be raised. ``reason``: why that far and no farther, with its figures."""

    name: str
    was: float
    to: float
    reason: str


def next_raise(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified | None,
    straight: Straightness | None,
    rolled_back: bool = False,
) -> Raise | str:
    """The next step for AMP_MAX_RAD (at most RAISE_MAX_RAD at once), or why there is none: enough
    for the reference with a margin, not identified, not straight, rolled back, no room in the tank,
    the servo's range. Pure."""
    raise NotImplementedError


@dataclass(frozen=True)
class Step:
    """One step that was taken. ``name``: look, trim, identify, design, limits. ``raises``: what it
    raised."""

    name: str
    done: bool
    words: str
    raises: tuple[Raise, ...] = ()


def first_session(
    fish: Fish,
    reference: Reference,
    person: Person,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> Iterator[Step]:
    """Yields each step when it is done. Asks (person.confirm) before the fish swims and before
    anything is raised; saves the parameters at the end. Uploads the reference."""
    raise NotImplementedError
