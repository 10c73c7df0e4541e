"""The fish as the camera sees it before a swim: frames of the last seconds that may be believed."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

from tailbeat.camera.base import CameraGone, Frame
from tailbeat.camera.tracking.repeats import Repeats
from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.step import Step
    from tailbeat.fish import Fish

BLIND_S = 1.0  # without a frame that shows the fish, after which it counts as not seen
_JUMP_M = 0.05  # from one frame to the next; no water carries a fish so fast
_AGREEING = 3  # frames in a row make a jump true: the fish was carried
_KEPT_MORE_S = 2.0
_LOOK = "Look at the camera, the light and the marker on the fish, then begin again."
_MOVE = (
    "Look at the camera: it sends the same picture again and again. Restart it, plug it in anew;"
    " then begin again."
)


class Sight:
    """``frames``: believed, oldest first, ``keep_s`` of them and a little more; their time in s of
    board time from some moment on. None is older than the last time the fish was carried (it
    jumped) or out of sight for longer than BLIND_S. A picture that stands still to the last bit
    shows no fish: every camera has noise, but one that is simulated.
    """

    def __init__(self, fish: Fish, camera: Camera, keep_s: float) -> None:
        self.frames: deque[Frame] = deque()
        self._fish, self._camera = fish, camera
        self._keep_s = keep_s + _KEPT_MORE_S
        self._repeats = Repeats(camera)
        self._doubted: list[Frame] = []
        self._seen_at_s = fish.transport.now_s()
        camera.frames()  # what it saw before does not count

    def look(self, step: Step) -> None:
        """Takes in what has come. Raises CameraGone, or what else the camera raises, told."""
        self._repeats.must_move()
        try:
            came = self._camera.frames()
        except TailbeatError as error:
            gone = isinstance(error, CameraGone)
            step.tell(f"the camera is gone: {error}" if gone else f"{error}", ok=False)
            raise
        for frame in self._repeats.new([self._scaled(frame) for frame in came]):
            if all(map(math.isfinite, (frame.t_s, frame.x_m, frame.y_m, frame.heading_rad))):
                self._take(frame)
        if self.blind_s > BLIND_S:
            self.frames.clear()

    @property
    def blind_s(self) -> float:
        """How long ago the newest frame came that shows the fish, in s of board time."""
        return (self._fish.transport.now_s() - self._seen_at_s) * self._fish.clock.rate

    def blind_words(self) -> str:
        """Why there is nothing to be seen."""
        if self._repeats.frozen:
            return "the camera's picture stands still"
        words = getattr(self._camera, "blind_words", "the camera does not see the fish")
        return str(words)

    def blind_remedy(self) -> str:
        """What to do about that."""
        return _MOVE if self._repeats.frozen else _LOOK

    def last(self, duration_s: float) -> list[Frame]:
        """The frames of that time before the newest one."""
        if not self.frames:
            return []
        since_s = self.frames[-1].t_s - duration_s - 1e-9
        return [frame for frame in self.frames if frame.t_s >= since_s]

    def _scaled(self, frame: Frame) -> Frame:
        rate = self._fish.clock.rate if self._camera.clock == "host" else 1.0
        return Frame(frame.t_s * rate, frame.x_m, frame.y_m, frame.heading_rad)

    def _take(self, frame: Frame) -> None:
        """A lone frame that shows the fish elsewhere is a wrong detection."""
        before = self.frames[-1] if self.frames else None
        if before is not None and frame.t_s <= before.t_s:
            return
        if before is not None and _apart_m(before, frame) > _JUMP_M:
            if self._doubted and _apart_m(self._doubted[-1], frame) > _JUMP_M:
                self._doubted.clear()
            self._doubted.append(frame)
            if len(self._doubted) < _AGREEING:
                return
            self.frames.clear()
            self.frames.extend(self._doubted)
        else:
            if before is not None and frame.t_s - before.t_s > BLIND_S:
                self.frames.clear()
            self.frames.append(frame)
        self._doubted.clear()
        self._seen_at_s = self._fish.transport.now_s()
        while self.frames[-1].t_s - self.frames[0].t_s > self._keep_s:
            self.frames.popleft()


def _apart_m(one: Frame, other: Frame) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
