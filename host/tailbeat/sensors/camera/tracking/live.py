"""A real camera as a stream of positions, and the speed over the last beat, during a trial."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.native import ffi, lib
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.sensors.camera.source.picture import PictureSource, TimedImage
from tailbeat.sensors.camera.speed import COVERAGE_MIN, SIGMA_MIN_M_S
from tailbeat.sensors.camera.tracking.track import BRIDGED_IN_A_ROW_MAX, Track, track_of
from tailbeat.sensors.camera.tracking.tracker import TrackedImage, Tracker

OnPicture = Callable[[TimedImage], None]

_QUEUE_S = 0.5
_KEPT_S = 600.0
_IDLE_S = 0.01  # before a device that had nothing, and did not wait for it, is asked again
_END_S = 3.0  # a device waits for a picture for 2 s at most


class VideoCamera:
    """Pictures in, frames out (camera.base.Camera). A source that blocks is read in a thread of its
    own, its pictures are looked at in another; when that cannot keep up the oldest pictures are
    dropped and counted, never queued beyond half a second. One in virtual time (``threaded`` False)
    is read in frames().

    What goes wrong in the threads is raised by the next frames() that has no frames to give, once:
    CameraGone when the source fails or ends, otherwise what the tracker (two fish) or
    ``on_picture`` raised. After that there are no more frames; ``on_picture`` goes on as long as
    there are pictures.
    """

    clock: Literal["host", "board"]
    fps: float
    dropped: int  # pictures nobody had time for
    blind_words = "the camera does not see the fish"

    def __init__(
        self,
        source: PictureSource,
        tracker: Tracker,
        threaded: bool = True,
        on_picture: OnPicture | None = None,
    ) -> None:
        """Takes ``source`` over and closes it. ``on_picture`` sees every picture, dropped ones too
        (a recorder), in the thread that reads. Raises InputError for a film."""
        if source.clock == "video":
            raise InputError(
                f"{source.name} is a film, not a camera", "Track it with: tailbeat camera track"
            )
        self.clock, self.fps, self.dropped = source.clock, source.fps, 0
        self._source, self._tracker, self._on_picture = source, tracker, on_picture
        kept = max(1, round(_KEPT_S * source.fps))
        self._places: deque[TrackedImage] = deque(maxlen=kept)
        self._frames: deque[Frame] = deque(maxlen=kept)
        self._waiting: deque[TimedImage] = deque(maxlen=max(1, round(_QUEUE_S * source.fps)))
        self._error: Exception | None = None
        self._failed = False
        self._reads = True
        self._change = threading.Condition()
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []
        if threaded:
            for name, work in (("look", self._look_all), ("read", self._read_all)):
                thread = threading.Thread(target=work, name=f"camera-{name}", daemon=True)
                thread.start()
                self._threads.append(thread)

    def frames(self) -> list[Frame]:
        """Frames since the last call; pictures without a fish give none."""
        if not self._threads:
            self._look_now()
        with self._change:
            frames = list(self._frames)
            self._frames.clear()
            if frames or self._error is None:
                return frames
            error, self._error = self._error, None
        raise error

    def track(self) -> Track:
        """All that was seen since the camera was opened, at most the last ten minutes."""
        with self._change:
            places = list(self._places)
        return track_of(places, self._source.name)

    def close(self) -> None:
        """Ends the threads and closes the source; may be called twice."""
        self._ending.set()
        with self._change:
            self._change.notify_all()
        for thread in self._threads:
            thread.join(_END_S)
        if not self._threads:
            self._source.close()

    def _look_now(self) -> None:
        """All pictures that are due."""
        try:
            while not (self._ending.is_set() or self._failed) and (picture := self._read()):
                self._look(picture)
        except Exception as error:
            self._fail(error)

    def _read_all(self) -> None:
        """The thread that reads. It closes the source, which nobody else may do under its hands."""
        try:
            while not self._ending.is_set():
                picture = self._read()
                if picture is None:
                    self._ending.wait(_IDLE_S)
                else:
                    self._hand_over(picture)
        except Exception as error:
            self._fail(error)
        finally:
            self._source.close()
            with self._change:
                self._reads = False
                self._change.notify_all()

    def _look_all(self) -> None:
        """The thread that tracks; it ends with the last picture of the one that reads."""
        try:
            while (picture := self._next()) is not None:
                self._look(picture)
        except Exception as error:
            self._fail(error)

    def _read(self) -> TimedImage | None:
        try:
            picture = self._source.read()
        except TailbeatError as error:
            raise CameraGone(error.message, error.remedy) from error
        if picture is None and self._source.ended:
            raise CameraGone(
                f"{self._source.name} gives no pictures any more", "Look at its plug and its cable."
            )
        if picture is not None and self._on_picture is not None:
            self._on_picture(picture)
        return picture

    def _hand_over(self, picture: TimedImage) -> None:
        with self._change:
            if self._failed:
                return
            self.dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(picture)  # a full deque drops its oldest
            self._change.notify_all()

    def _next(self) -> TimedImage | None:
        with self._change:
            while not self._waiting and self._reads and not self._ending.is_set():
                self._change.wait()
            if not self._waiting or self._ending.is_set():
                return None
            return self._waiting.popleft()

    def _look(self, picture: TimedImage) -> None:
        place = self._tracker.look(picture)
        with self._change:
            self._places.append(place)
            if place.frame is not None:
                self._frames.append(place.frame)

    def _fail(self, error: Exception) -> None:
        """The first error counts; those of a camera that is being closed do not."""
        with self._change:
            if not (self._failed or self._ending.is_set()):
                self._error, self._failed = error, True


_SPAN_SLACK_FRAMES = 0.6


_PLAUSIBLE_M_S = 1.0


_JUMP_M = 0.01  # ten times the noise of a good camera


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """Mean speed over a window of one beat whose middle is ``t_s``; ``sigma_m_s`` > 0."""

    t_s: float
    speed_m_s: float
    sigma_m_s: float


class BeatFit:
    """Feed it positions; it gives a speed for every frame that closes a whole beat.

    The window is one beat long by the frames' time stamps, both ends included (26 frames at
    25 frames/s), within 0.6 of a frame. Nothing comes out of a window with more than 5 frames
    missing in a row or with fewer than 60 % of its frames; a jump no fish can swim (somebody
    carried it back) begins a new window. The standard deviation
    follows from the scatter about the line. Raises InputError for more frames per beat than the
    window holds. Computed by host/native/line_fit.c.
    """

    def __init__(self, beat_s: float = 1.0, fps: float = 25.0) -> None:
        frames = round(beat_s * fps) + 1
        if frames > lib.NATIVE_LINE_FIT_POSITIONS_MAX:
            raise InputError(
                f"{frames} pictures per beat are too many.", "Film with fewer pictures per second."
            )
        self.native = ffi.new("line_fit_t *")
        self.native.beat_s = beat_s
        self.native.slack_s = _SPAN_SLACK_FRAMES * (1.0 / fps)
        self.native.gap_max_s = (BRIDGED_IN_A_ROW_MAX + 1.5) * (1.0 / fps)
        self.native.speed_max_m_s, self.native.jump_m = _PLAUSIBLE_M_S, _JUMP_M
        self.native.sigma_min_m_s = SIGMA_MIN_M_S
        self.native.positions_min = max(3, math.ceil(COVERAGE_MIN * frames))
        self._speed = ffi.new("line_fit_speed_t *")

    def reset(self) -> None:
        """Forgets all positions."""
        self.native.count = 0

    def add(self, t_s: float, x_m: float) -> SpeedSample | None:
        """Takes one position; frames that are not newer than the last are dropped."""
        speed = self._speed
        if not lib.line_fit_add(self.native, t_s, x_m, speed):
            return None
        return SpeedSample(speed.t_s, speed.speed_m_s, speed.sigma_m_s)
