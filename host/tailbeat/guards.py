"""Guards of a swim that are not walls: the tank's length, a key, and all of several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tailbeat.camera.base import Afresh, Frame

if TYPE_CHECKING:
    from pathlib import Path

    from tailbeat.fish import Guard


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
    of its beats' speeds, which come a beat or two late. ``room_m`` 0 or infinite: never."""

    room_m: float
    beat_s: float = 1.0
    kappa_per_m: float = 10.0
    way_m: float = field(default=0.0, init=False)

    def __call__(self, seen: object) -> str | None:
        """Looks at results.BeatEvent, and at Afresh, which begins anew."""
        raise NotImplementedError


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

    def write(self, path: Path, start_s: float = 0.0) -> None:
        """As CSV t_s,x_m,y_m,heading_rad; time from ``start_s``."""
        raise NotImplementedError
