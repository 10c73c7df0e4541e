"""Follows one fish from picture to picture.

Checks against a second fish, a wrong marker size and moved anchors; brightness around the marker,
where the LED blinks; a filter for pictures that a driver repeats with new time stamps.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import Camera, Frame
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.calibration.file import Calibration, corners_of
from tailbeat.sensors.camera.marker.detector import MARKERS, Marker, detector_for
from tailbeat.sensors.camera.marker.tags import Detection, SearchWindow, TagReader, centre_of
from tailbeat.sensors.camera.source.picture import Image, TimedImage, size_of

PERSISTS = 3  # pictures in a row: nothing is believed on the word of one
SIZE_ERROR_MAX = 0.05
_SIZE_AFTER_S = 1.0
_SIZE_DETECTIONS_MIN = 5
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

    def look(self, fish: Detection, detections: list[Detection]) -> None:
        """``detections``: all in this picture, the ``fish`` among them."""
        low, high = (ratio * fish.side_px for ratio in _SAME_SIZE)
        others = [one for one in detections if one is not fish and low <= one.side_px <= high]
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
        self._expected_m = marker.side_m
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
        if t_s - self._first_s >= _SIZE_AFTER_S and len(self._sides_m) >= _SIZE_DETECTIONS_MIN:
            self.measured_m = float(np.median(self._sides_m))
            self._judge(self.measured_m)

    def _judge(self, seen_m: float) -> None:
        expected_m = self._expected_m
        if expected_m is None or abs(seen_m / expected_m - 1) <= SIZE_ERROR_MAX:
            return
        raise InputError(
            f"in {self._name} the marker is {seen_m * 1000:.1f} mm wide, expected: "
            f"{expected_m * 1000:.1f} mm. The calibration, --marker-side or the marker's height "
            "over the calibrated plane is wrong",
            "Measure the printed black square; calibrate at the height of the marker.",
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


# A patch of the water around the fish, fixed to its marker: in it the LED stands still.
PATCH_LEFT_M, PATCH_RIGHT_M = -0.25, 0.15  # along the fish, from the marker's centre; head = +
PATCH_HALF_WIDTH_M = 0.06
PATCH_CELL_M = 0.01
PATCH_SHAPE = (
    round(2 * PATCH_HALF_WIDTH_M / PATCH_CELL_M),
    round((PATCH_RIGHT_M - PATCH_LEFT_M) / PATCH_CELL_M),
)

LedPatch = NDArray[np.uint8]

_SAMPLES_MAX = 12  # per cell and direction

_PATCH_M = corners_of(PATCH_LEFT_M, -PATCH_HALF_WIDTH_M, PATCH_RIGHT_M, PATCH_HALF_WIDTH_M)


def patch_around(grey: Image, frame: Frame, calibration: Calibration) -> LedPatch:
    """The brightest pixel of each cell, PATCH_SHAPE; 0 outside the picture. Row 0 is the fish's
    left, column 0 its tail's end; cell (r, c) reaches from PATCH_LEFT_M + c PATCH_CELL_M along the
    fish and from r PATCH_CELL_M - PATCH_HALF_WIDTH_M to its right."""
    cos, sin = np.cos(frame.heading_rad), np.sin(frame.heading_rad)
    places = _PATCH_M @ np.array([[cos, sin], [-sin, cos]]) + [frame.x_m, frame.y_m]
    corners = calibration.to_pixels(places)
    per_cell = _samples(corners)
    rows, columns = PATCH_SHAPE[0] * per_cell, PATCH_SHAPE[1] * per_cell
    # Over 0.4 m even a wide lens bends by less than a cell: four corners are enough.
    flat = corners_of(0, 0, columns, rows) - 0.5
    to_patch = cv2.getPerspectiveTransform(corners.astype(np.float32), flat.astype(np.float32))
    patch = cv2.warpPerspective(grey, to_patch, (columns, rows), flags=cv2.INTER_LINEAR)
    cells = patch.reshape(PATCH_SHAPE[0], per_cell, PATCH_SHAPE[1], per_cell)
    return np.asarray(cells.max(axis=(1, 3)), np.uint8)


def _samples(corners: F64) -> int:
    """As many as a cell has pixels, so that no bright pixel falls between them."""
    length_px = float(np.linalg.norm(corners[1] - corners[0]))
    return int(np.clip(np.ceil(length_px / PATCH_SHAPE[1]), 1, _SAMPLES_MAX))


FROZEN_S = 1.0


class RepeatFilter:
    """Positions in, those that say something new out.

    No two positions of a noisy camera are the same in every bit, nor two of a fish that moves (the
    board's own rule, firmware/speed/doubt.h). So a run of equal ones is held back, until another
    shows that the camera was only coarse, or until it has lasted for a second: then it is dropped
    as ``frozen``. Not so before a change was seen: a fish that rests looks the same to a camera
    without noise; unless must_move() was said. Never of a ``camera`` that is ``computed``.
    """

    frozen: bool  # the last position is one of a picture that stands still

    def __init__(self, camera: Camera | None = None) -> None:
        self._camera = camera
        self.forget()

    def forget(self) -> None:
        """What came before does not count."""
        self.frozen = self._changed = False
        self._first: Frame | None = None
        self._held: list[Frame] = []

    def must_move(self) -> None:
        """The tail beats so that no fish would rest."""
        self._changed = True

    def new(self, frames: list[Frame]) -> list[Frame]:
        """Of ``frames`` and those held back what may be believed now, in order."""
        if is_computed(self._camera):
            return frames
        believed: list[Frame] = []
        for frame in frames:
            believed += self._take(frame)
        return believed

    def _take(self, frame: Frame) -> list[Frame]:
        first, held = self._first, self._held
        if first is None or _position(first) != _position(frame):
            self._changed |= first is not None
            self._first, self._held, self.frozen = frame, [], False
            return [*held, frame]
        if not self._changed:
            return [frame]
        self.frozen = frame.t_s - first.t_s > FROZEN_S
        self._held = [] if self.frozen else [*held, frame]
        return []


def is_computed(camera: Camera | None) -> bool:
    """Whether its positions come from a plant: with fresh stamps they are fresh, however equal."""
    return bool(getattr(camera, "computed", False))


def _position(frame: Frame) -> tuple[float, float, float]:
    return frame.x_m, frame.y_m, frame.heading_rad


EVERYWHERE_EVERY_S = 1.0
STAYS_NEAR_S = 0.2  # a marker that is covered for a moment is not looked for elsewhere
FORGOTTEN_AFTER_S = 0.5  # then the fish can be anywhere
SPEED_MAX_M_S, JUMP_MAX_M = 1.0, 0.05  # what a fish can do, and what a detection can be off
_WINDOW_SIDES = 1.2  # half a window, in markers
_WINDOW_M, _WINDOW_M_S = 0.02, 0.5  # and what the prediction can be off


@dataclass(frozen=True, slots=True)
class TrackedImage:
    """What one picture said. ``frame`` None = the fish was not seen. ``patch``: brightest pixel of
    each cell of the patch around the fish, PATCH_SHAPE; None when not seen or not asked for.
    ``patch_turned``: the same if its head is the other end, of a blob."""

    index: int
    t_s: float
    frame: Frame | None
    detection: Detection | None
    patch: LedPatch | None
    patch_turned: LedPatch | None = None

    def turned(self) -> TrackedImage:
        """The same with the head at the other end (not so in the ``detection``)."""
        if self.frame is None:
            return self
        frame = replace(self.frame, heading_rad=self.frame.heading_rad + np.pi)
        return replace(self, frame=frame, patch=self.patch_turned, patch_turned=self.patch)


@dataclass(frozen=True, slots=True)
class _Seen:
    detection: Detection
    frame: Frame


class Tracker:
    """Looks first where the fish should be, then everywhere; everywhere also once a second, so that
    a second fish does not go unnoticed.

    A fish that is suddenly where it cannot have got to is not believed before it has been there for
    three pictures.
    """

    def __init__(
        self, marker: Marker, calibration: Calibration, name: str, patch: bool = False
    ) -> None:
        """``name``: of the film or device, for messages. Raises what detector_for raises."""
        self._detector = detector_for(marker, calibration)
        # It has to see every picture as a whole, and may take the tail for the head.
        self._whole_image = MARKERS[marker.kind].whole_image
        self._calibration = calibration
        self._name = name
        self._patch = patch
        self._anchors = Anchors(calibration, name)
        self._size = MarkerSize(marker, calibration, name)
        self._second = SecondFish(calibration, name)
        self._everywhere_s = -np.inf  # when it is due
        self._before: _Seen | None = None
        self._last: _Seen | None = None
        self._doubted: list[_Seen] = []

    @property
    def other_ids(self) -> list[int]:
        """Markers of the right kind that were seen but are not the fish's; for messages."""
        return sorted(getattr(self._detector, "other_ids", ()))

    @property
    def measured_side_m(self) -> float | None:
        """Of the marker, in the calibrated plane: the median of the first second of detections.
        None = not known yet, or a blob."""
        return self._size.measured_m

    def look(self, picture: TimedImage) -> TrackedImage:
        """The fish in the next picture. Raises InputError for two fish, a picture of another size,
        anchors that are elsewhere (first pictures), a marker whose size contradicts the
        calibration by more than 5 % (median of the first second of detections)."""
        grey = picture.image
        self._calibration.check_size(size_of(grey), self._name)
        self._anchors.look(picture.t_s, grey)
        found = self._find(grey, picture.t_s)
        seen = _Seen(found, self._frame(picture.t_s, found)) if found is not None else None
        if seen is None or not self._believed(seen):
            return TrackedImage(picture.index, picture.t_s, None, None, None)
        self._size.look(picture.t_s, seen.detection.corners_px)
        self._before, self._last = self._last, seen
        place = TrackedImage(picture.index, picture.t_s, seen.frame, seen.detection, None)
        return self._with_patch(place, grey) if self._patch else place

    def _with_patch(self, place: TrackedImage, grey: Image) -> TrackedImage:
        ends = [place, place.turned()] if self._whole_image else [place]
        patches = [patch_around(grey, end.frame, self._calibration) for end in ends if end.frame]
        return replace(place, patch=patches[0], patch_turned=patches[1] if patches[1:] else None)

    def _find(self, grey: Image, t_s: float) -> Detection | None:
        guess = self._prediction(t_s)
        due = t_s >= self._everywhere_s or self._second.suspected or self._whole_image
        if guess is not None and not due:
            window = self._window(guess, t_s, grey)
            detections = self._detector.find(grey, window)
            assert self._last is not None
            if detections or t_s - self._last.frame.t_s <= STAYS_NEAR_S:
                return _nearest(detections, guess) if detections else None
        detections = self._detector.find(grey)
        self._everywhere_s = t_s + EVERYWHERE_EVERY_S
        if not detections:
            return None
        fish = detections[0] if guess is None else _nearest(detections, guess)
        self._second.look(fish, detections)
        return fish

    def _prediction(self, t_s: float) -> F64 | None:
        """Where the fish should be, in pixels; None = lost."""
        last, before = self._last, self._before
        if last is None or not 0 <= t_s - last.frame.t_s <= FORGOTTEN_AFTER_S:
            return None
        centre = np.array(last.detection.centre_px)
        if before is None or last.frame.t_s - before.frame.t_s > FORGOTTEN_AFTER_S:
            return centre
        step = centre - before.detection.centre_px
        now_s, then_s = last.frame.t_s, before.frame.t_s
        return np.asarray(centre + step * (t_s - now_s) / (now_s - then_s))

    def _window(self, guess: F64, t_s: float, grey: Image) -> SearchWindow:
        assert self._last is not None
        detection, frame = self._last.detection, self._last.frame
        front = self._calibration.to_tank(np.array([detection.front_px]))[0]
        px_per_m = np.hypot(*np.subtract(detection.front_px, detection.centre_px)) / max(
            float(np.hypot(*(front - (frame.x_m, frame.y_m)))), 1e-9
        )
        off_m = _WINDOW_M + _WINDOW_M_S * (t_s - frame.t_s)
        half = _WINDOW_SIDES * detection.side_px + px_per_m * off_m
        low = np.floor(guess - half).astype(int)
        high = np.ceil(guess + half).astype(int) + 1
        height, width = grey.shape
        left, right = np.clip((low[0], high[0]), 0, width)
        top, bottom = np.clip((low[1], high[1]), 0, height)
        return SearchWindow(int(left), int(top), int(right), int(bottom))

    def _frame(self, t_s: float, detection: Detection) -> Frame:
        pixels = np.array([detection.centre_px, detection.front_px])
        (x, y), (front_x, front_y) = self._calibration.to_tank(pixels)
        heading = float(np.arctan2(front_y - y, front_x - x))
        return Frame(t_s, float(x), float(y), heading)

    def _believed(self, seen: _Seen) -> bool:
        if self._last is None or _can_swim(self._last, seen):
            self._doubted = []
            return True
        if self._doubted and not _can_swim(self._doubted[-1], seen):
            self._doubted = []
        self._doubted.append(seen)
        if len(self._doubted) < PERSISTS:
            return False
        # Its velocity is that of the place it jumped to.
        self._last = self._doubted[-2]
        self._doubted = []
        return True


def _can_swim(start: _Seen, end: _Seen) -> bool:
    apart_s = end.frame.t_s - start.frame.t_s
    if apart_s > FORGOTTEN_AFTER_S:
        return True
    apart_m = np.hypot(end.frame.x_m - start.frame.x_m, end.frame.y_m - start.frame.y_m)
    return bool(apart_m <= SPEED_MAX_M_S * apart_s + JUMP_MAX_M)


def _nearest(detections: list[Detection], guess: F64) -> Detection:
    return min(detections, key=lambda one: float(np.hypot(*(guess - one.centre_px))))
