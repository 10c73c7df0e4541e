"""Stops the tail before the fish meets a wall."""

from __future__ import annotations

from tailbeat.camera.calibration import Calibration

WALL_ZONE_M = 0.10
NOSE_M = 0.20  # from the marker's centre to the tip of the head of a 36 cm fish
HIT = "wall"


class WallGuard:
    """A guard for run_trial: sees frames, gives a reason to abort.

    The fish's nose and tail must stay ``zone_m`` away from the edges of ``calibration.area_m`` and
    out of nothing else; without an area it never aborts. A jump that no fish can swim (a wrong
    detection) is not believed before the third picture says the same.
    """

    def __init__(
        self, calibration: Calibration, zone_m: float = WALL_ZONE_M, nose_m: float = NOSE_M
    ) -> None:
        raise NotImplementedError

    def __call__(self, what: object) -> str | None:
        """The reason to abort, starting with HIT, or None. ``what``: frames; all else is ignored."""
        raise NotImplementedError
