"""What speaks against a film: a second fish, a marker of the wrong size, anchors elsewhere."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.marker.tags import Sighting
from tailbeat.sensors.camera.source.picture import Image

PERSISTS = 3  # pictures in a row: nothing is believed on the word of one
SIZE_ERROR_MAX = 0.05
_SIZE_AFTER_S = 1.0
_SIZE_SIGHTINGS_MIN = 5
_SAME_SIZE = (0.7, 1.4)  # the second fish's marker against the first's
_ANCHOR_LOOKS = 3
_ANCHOR_LOOK_EVERY_S = 0.2


class SecondFish:
    """Raises InputError when another fish is seen in three whole pictures in a row."""

    def __init__(self, calibration: Calibration, name: str) -> None:
        self._calibration = calibration
        self._name = name
        self._pictures = 0

    @property
    def suspected(self) -> bool:
        """Whether the next picture has to be searched as a whole to know."""
        return self._pictures > 0

    def look(self, fish: Sighting, sightings: list[Sighting]) -> None:
        """``sightings``: all in this picture, the ``fish`` among them."""
        others = [one for one in sightings if one is not fish and _same_size(one, fish)]
        self._pictures = self._pictures + 1 if others else 0
        if self._pictures < PERSISTS:
            return
        where = self._calibration.to_tank(np.array([fish.centre_px, others[0].centre_px]))
        places = " and ".join(f"({x:.2f}, {y:.2f}) m" for x, y in where)
        raise InputError(
            f"two fish in {self._name}: at {places} in the tank",
            "Take one out, or say which marker to follow: --marker-id N",
        )


class MarkerSize:
    """Raises InputError when the markers of the first second have, in the tank, another size than
    the marker is said to have, by more than 5 %: speeds would be wrong by as much. ``measured_m``:
    their median side; None = not known yet."""

    def __init__(self, marker: Marker, calibration: Calibration, name: str) -> None:
        self.measured_m: float | None = None
        self._said_m = marker.side_m
        self._calibration = calibration
        self._name = name
        self._sides_m: list[float] = []
        self._first_s: float | None = None

    def look(self, t_s: float, corners_px: F64 | None) -> None:
        """``corners_px`` of the fish's marker (4, 2); None for a blob."""
        if self.measured_m is not None or corners_px is None:
            return
        if self._first_s is None:
            self._first_s = t_s
        corners = self._calibration.to_tank(corners_px)
        along = np.roll(corners, -1, axis=0) - corners
        self._sides_m.append(float(np.linalg.norm(along, axis=1).mean()))
        if t_s - self._first_s >= _SIZE_AFTER_S and len(self._sides_m) >= _SIZE_SIGHTINGS_MIN:
            self.measured_m = float(np.median(self._sides_m))
            if self._said_m is not None:
                self._judge(self._said_m, self.measured_m)

    def _judge(self, said_m: float, seen_m: float) -> None:
        if abs(seen_m / said_m - 1) <= SIZE_ERROR_MAX:
            return
        raise InputError(
            f"in {self._name} the marker is {seen_m * 1000:.1f} mm wide, it should be "
            f"{said_m * 1000:.1f} mm: the calibration, --marker-side or the marker's height over "
            "the calibrated plane is wrong",
            "Measure the printed black square; calibrate at the height at which the marker swims.",
        )


class Anchors:
    """Compares the tank's markers with where they were when the camera was calibrated: in three
    pictures of the first half second, by their medians, so that one misread marker does no harm."""

    def __init__(self, calibration: Calibration, name: str) -> None:
        self._calibration = calibration
        self._name = name
        self._looks = 0
        self._next_s = -np.inf
        self._seen: dict[int, list[tuple[float, float]]] = defaultdict(list)

    def look(self, t_s: float, grey: Image) -> None:
        """Raises what Calibration.check_anchors raises."""
        known = self._calibration.anchors
        if not known or self._looks == _ANCHOR_LOOKS or t_s < self._next_s:
            return
        from tailbeat.sensors.camera.marker.tags import TagReader, centre_of

        for tag in TagReader("aruco").read(grey, wanted=lambda tag: tag.id in known):
            self._seen[tag.id].append(centre_of(tag.square))
        self._looks += 1
        self._next_s = t_s + _ANCHOR_LOOK_EVERY_S
        if self._looks == _ANCHOR_LOOKS:
            self._judge()

    def _judge(self) -> None:
        often = {i: seen for i, seen in self._seen.items() if len(seen) > _ANCHOR_LOOKS // 2}
        middles = {i: np.median(seen, axis=0) for i, seen in often.items()}
        seen = {i: (float(u), float(v)) for i, (u, v) in middles.items()}
        self._calibration.check_anchors(seen, self._name)


def _same_size(one: Sighting, other: Sighting) -> bool:
    return _SAME_SIZE[0] <= one.side_px / other.side_px <= _SAME_SIZE[1]
