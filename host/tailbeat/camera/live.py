"""A real camera as a stream of positions, while the fish swims."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from tailbeat.camera.base import Frame
from tailbeat.camera.pictures import Picture, PictureSource
from tailbeat.camera.track import Track
from tailbeat.camera.tracker import Place, Tracker

OnPicture = Callable[[Picture, Place], None]


class VideoCamera:
    """Pictures in, frames out (camera.base.Camera). A source that blocks is read in a thread of its
    own; when the tracker cannot keep up the oldest pictures are dropped and counted, never queued
    beyond half a second. One in virtual time (``threaded`` False) is read in frames().

    What goes wrong in the thread (two fish, device gone) is raised by the next frames(), once.
    """

    clock: Literal["host", "board"]
    fps: float
    dropped: int  # pictures nobody had time for

    def __init__(
        self,
        source: PictureSource,
        tracker: Tracker,
        threaded: bool = True,
        on_picture: OnPicture | None = None,
    ) -> None:
        """Takes ``source`` over and closes it. ``on_picture`` sees every picture (a recorder), in
        the thread that reads."""
        raise NotImplementedError

    def frames(self) -> list[Frame]:
        """Frames since the last call; pictures without a fish give none."""
        raise NotImplementedError

    def track(self) -> Track:
        """All that was seen since the camera was opened, at most the last ten minutes."""
        raise NotImplementedError

    def close(self) -> None:
        """Ends the thread and closes the source; may be called twice."""
        raise NotImplementedError
