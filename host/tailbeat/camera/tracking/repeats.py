"""A picture that a driver repeats with fresh stamps, told apart from a fish that rests."""

from __future__ import annotations

from tailbeat.camera.base import Camera, Frame

FROZEN_S = 1.0


class Repeats:
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
