"""How far the fish will come with the amplitudes it is about to swim, and whether there is room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tailbeat.fish import Fish
    from tailbeat.logbook import Logbook
    from tailbeat.model.identified import Identified
    from tailbeat.trial_log import Trial


@dataclass(frozen=True)
class Travel:
    """Way over ground until the glide after the last beat is over. ``worst_m``: by a fish and a day
    that are as far off as may be believed (2 sigmas). ``room_m``: the tank's length less the
    fish's, infinite when TANK_LEN_M is 0. ``by``: what it was reckoned with, in words."""

    expected_m: float
    worst_m: float
    room_m: float
    by: str

    @property
    def fits(self) -> bool:
        """Whether what is expected has room."""
        return self.expected_m <= self.room_m

    def text(self) -> str:
        """One line: ``about 2.21 m, at worst 2.40, of 2.64 m (by the identified fish)``."""
        raise NotImplementedError

    def require_room(self) -> None:
        """Raises InputError, with the figures and what to do, when it does not fit."""
        raise NotImplementedError


def travel_of(
    amplitude_rad: ArrayLike,
    params: Mapping[str, float],
    beat_s: float,
    identified: Identified | None = None,
    last: Trial | None = None,
) -> Travel:
    """Of amplitudes as swum (cut at AMP_MAX_RAD here). With ``identified`` by that model; without by
    the thrust model of MDL_*. ``last``: a measured trial of the same fish; what it came farther, or
    less far, than the model says of its own amplitudes is expected again."""
    raise NotImplementedError


def travel_next(fish: Fish, book: Logbook | None) -> Travel:
    """Of what the board will swim next, by the best that is known of it. Raises Refused without a
    reference. Nothing on the board changes: before the first arming the amplitudes are those that
    arming will compute."""
    raise NotImplementedError
