"""Guards of a swim that are not walls: the tank's length, a key, and all of several."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.camera.base import Afresh, Frame
from tailbeat.camera.tank.wall import glide_m
from tailbeat.results import BeatEvent

if TYPE_CHECKING:
    from tailbeat.fish import Guard

Array = NDArray[np.float64]

TOO_FAR = "room:"  # how its reasons begin
BY_HAND = "stopped by hand"  # the reason of a person who wants it to end

_LATE_S = 2.0  # SPD_LATE_S + SPD_GAP_S as they are by default
_STOP_S = 0.5  # radio, the glide to the centre, thrust that is under way
_LOOK_BACK = 4  # beats
_PLANNED_M = 0.1  # less is too little to tell by how much a fish differs from what was planned
_RATIO = (0.25, 4.0)


def together(*guards: Guard | None) -> Guard:
    """Asks every guard (all see everything); the first reason counts."""
    there = [guard for guard in guards if guard is not None]

    def ask(seen: object) -> str | None:
        reasons = [guard(seen) for guard in there]
        return next((reason for reason in reasons if reason), None)

    return ask


@dataclass
class RoomGuard:
    """Stops a fish that has swum as far as the tank allows, less the way it glides on: by the sums
    of its beats' speeds, which come ``late_s`` after their ends. ``room_m`` 0 or infinite: never.

    ``planned_m_s``: the speeds that are expected, per beat and for the glide after the last one.
    A fish that will come to rest in time if it goes on differing from them as it did is let swim;
    without them it is stopped where it could just still be. A beat without a speed counts as fast
    as the last one, or as planned. ``way_m``: so far, up to the end of the last beat heard of.
    """

    room_m: float
    beat_s: float = 1.0
    kappa_per_m: float = 10.0
    planned_m_s: ArrayLike | None = None
    late_s: float = _LATE_S
    way_m: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        planned = () if self.planned_m_s is None else self.planned_m_s
        self._planned = np.asarray(planned, dtype=np.float64)
        self._begin()

    @classmethod
    def of_params(
        cls,
        params: Mapping[str, float],
        beat_s: float = 1.0,
        kappa_per_m: float | None = None,
        planned_m_s: ArrayLike | None = None,
    ) -> RoomGuard:
        """For a board with these parameters. ``kappa_per_m`` None: MDL_KAPPA."""
        tank_m = params["TANK_LEN_M"]
        room_m = max(tank_m - params["FISH_LEN_M"], 0.01) if tank_m > 0 else math.inf
        kappa = params["MDL_KAPPA"] if kappa_per_m is None else kappa_per_m
        late_s = params["SPD_LATE_S"] + params["SPD_GAP_S"]
        return cls(room_m, beat_s, kappa, planned_m_s, late_s)

    def _begin(self) -> None:
        self.way_m = 0.0
        self._speeds: list[float] = []
        self._measured: list[bool] = []

    def __call__(self, seen: object) -> str | None:
        """Looks at results.BeatEvent, and at Afresh, which begins anew."""
        if isinstance(seen, Afresh):
            self._begin()
        if not isinstance(seen, BeatEvent) or self.room_m <= 0 or math.isinf(self.room_m):
            return None
        if seen.beat < len(self._speeds):
            return None
        while len(self._speeds) < seen.beat:
            self._take(None)
        self._take(seen.speed_m_s)
        return self._judge()

    def _take(self, speed_m_s: float | None) -> None:
        known = speed_m_s is not None and math.isfinite(speed_m_s)
        speed = float(speed_m_s) if known and speed_m_s is not None else self._supposed()
        self._speeds.append(speed)
        self._measured.append(known)
        self.way_m += speed * self.beat_s

    def _supposed(self) -> float:
        """Speed of the next beat, which nobody measured."""
        last = self._speeds[-1] if self._speeds else 0.0
        beat = len(self._speeds)
        return self._ratio() * float(self._planned[beat]) if beat < len(self._planned) else last

    def _judge(self) -> str | None:
        """Whether now is the last moment: a beat later, with what is under way, would be too late
        to stop."""
        at_m_s = max(self._ahead_m_s(), 0.0)
        under_way_m = at_m_s * (self.late_s + self.beat_s + _STOP_S)
        reach_m = self.way_m + under_way_m + glide_m(at_m_s, self.kappa_per_m)
        if reach_m < self.room_m or self._will_rest_in_time():
            return None
        return (
            f"{TOO_FAR} it has swum {self.way_m:.2f} m and needs to "
            f"{min(reach_m, 9.99):.2f} m to stop; there are {self.room_m:.2f} m"
        )

    def _ahead_m_s(self) -> float:
        """The fastest it may be until a stop takes hold: as fast as it was, and faster by as much
        as is planned."""
        last = self._speeds[-1]
        beat = len(self._speeds)
        soon = self._planned[beat : beat + math.ceil(self.late_s / self.beat_s) + 2]
        return max(last, self._ratio() * float(soon.max())) if soon.size else last

    def _ratio(self) -> float:
        """How much faster than planned it swims: of all its beats or the last few, which is more;
        1 while too little is known."""
        count = min(len(self._speeds), len(self._planned))
        known = np.array(self._measured[:count], dtype=bool)
        speed, planned = np.array(self._speeds[:count]), self._planned[:count]
        ratios = []
        for part in (slice(0, count), slice(max(count - _LOOK_BACK, 0), count)):
            seen = known[part]
            expected = float(planned[part][seen].sum())
            if expected * self.beat_s >= _PLANNED_M:
                ratios.append(float(speed[part][seen].sum()) / expected)
        return min(max(max(ratios, default=1.0), _RATIO[0]), _RATIO[1])

    def _will_rest_in_time(self) -> bool:
        """By what is planned, if the rest of it differs as what is known did."""
        beat = len(self._speeds)
        if not len(self._planned) or beat > len(self._planned):
            return False
        left_m = float(self._planned[beat:].sum()) * self.beat_s
        return self.way_m + self._ratio() * left_m < self.room_m


def when(wanted: Callable[[], bool], reason: str) -> Guard:
    """Aborts with ``reason`` as soon as ``wanted()``."""
    return lambda _: reason if wanted() else None


@dataclass
class Seen:
    """Keeps every frame of the swim; stops nothing."""

    frames: list[Frame] = field(default_factory=list)

    def __call__(self, seen: object) -> str | None:
        """Takes frames, and forgets them on Afresh."""
        if isinstance(seen, Afresh):
            self.frames.clear()
        elif isinstance(seen, Frame):
            self.frames.append(seen)
        return None
