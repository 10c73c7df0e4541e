"""The camera of one trial: its speeds go to the board, its frames to the guard."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from tailbeat import _dialect as mavlink
from tailbeat.camera.base import Camera, CameraGone, Frame
from tailbeat.camera.speed.beatfit import BeatFit, SpeedSample
from tailbeat.link import Message

if TYPE_CHECKING:
    from tailbeat.fish import Fish, OnEvent

_BLIND_S = 1.0  # of board time without a picture, after which somebody should look
_NO_COVARIANCE = (math.nan,) * 8


class TrialCamera:
    """Once the swim has begun nothing of the camera's raises: a tail that beats needs its loop.

    A camera that is gone is told as a warning; the trial goes on without it if ``dispensable``
    (another source gives the speeds) and the guard agrees. Anything else that it raises (two fish,
    a camera that was moved) aborts, and is kept in ``failure`` for when the board has stopped.
    ``consult(what)`` asks the guard, ``abort()`` wants the tail to stop.
    """

    def __init__(
        self,
        fish: Fish,
        camera: Camera,
        window_s: float,
        dispensable: bool,
        emit: OnEvent,
        consult: Callable[[object], None],
        abort: Callable[[], None],
    ) -> None:
        self.fit = BeatFit(window_s, camera.fps)
        self.failure: Exception | None = None
        self._fish, self._camera, self._dispensable = fish, camera, dispensable
        self._emit, self._consult, self._abort = emit, consult, abort
        self._gone = self._blind = False
        self._seen_at_s = 0.0

    def begin(self) -> None:
        """As look_afresh, while nothing swims yet: raises what the camera raises."""
        self._camera.frames()
        self._camera.frames()  # an error comes after the frames before it
        self.look_afresh()

    def look_afresh(self) -> None:
        """Forgets what was: until now the fish may have been carried or adrift."""
        self._frames()
        self.fit.reset()
        self._seen_at_s = self._fish.link.transport.now_s()

    def send_speeds(self, swimming: bool) -> None:
        """What came since the last call. ``swimming``: the tail beats, or is about to."""
        frames = self._frames()
        if not self._gone:
            self._watch(bool(frames), swimming)
        for frame in frames:
            self._consult(frame)
            sample = self.fit.add(frame.t_s, frame.x_m)
            if sample is None:
                continue
            by_board = self._camera.clock == "board"
            board_s = sample.t_s if by_board else self._fish.clock.board_s(sample.t_s)
            if board_s > 0:
                self._fish.link.send(vision_message(board_s, sample))

    def _frames(self) -> list[Frame]:
        if self._gone:
            return []
        try:
            return self._camera.frames()
        except CameraGone as gone:
            self._gone = True
            self._mourn(gone)
        except Exception as error:
            self._gone, self.failure = True, error
            self._emit({"event": "warning", "text": f"{error}"})
            self._abort()
        return []

    def _mourn(self, gone: CameraGone) -> None:
        self._emit({"event": "warning", "text": f"{gone} The swim has no camera any more."})
        self._consult(gone)
        if not self._dispensable:
            self._abort()

    def _watch(self, seen: bool, swimming: bool) -> None:
        """Says once when the fish is out of sight while the tail beats."""
        now_s = self._fish.transport.now_s()
        if seen or not swimming:
            self._seen_at_s = now_s
        blind = (now_s - self._seen_at_s) * self._fish.clock.rate > _BLIND_S
        if blind and not self._blind:
            words = getattr(self._camera, "blind_words", "the camera sends no pictures")
            self._emit({"event": "warning", "text": f"{words}; beats go unmeasured"})
        self._blind = blind


def vision_message(board_s: float, sample: SpeedSample) -> Message:
    """VISION_SPEED_ESTIMATE for a mean speed along x around ``board_s``."""
    covariance = (sample.sigma_m_s**2, *_NO_COVARIANCE)
    return mavlink.MAVLink_vision_speed_estimate_message(
        round(board_s * 1e6), sample.speed_m_s, math.nan, math.nan, covariance, 0
    )
