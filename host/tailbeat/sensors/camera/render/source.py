"""The simulated camera as pictures: a fake device, in simulated time."""

from __future__ import annotations

from collections import deque
from typing import Literal

from tailbeat.sensors.camera.render.painter import Painter, Truth
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.simulated import Moments
from tailbeat.sensors.camera.source.picture import Picture
from tailbeat.sim.world import CameraFrame

_SPEED_MAX_M_S = 1.0  # faster than that somebody has carried the fish
_KEPT = 4


class RenderedDevice:
    """Pictures of a simulated fish (pictures.PictureSource), as they come due.

    The simulator's own camera noise is how far the drawn fish is off the truth in each picture;
    its lost frames are pictures that never come. read() never blocks; None = none due yet. Of a
    simulator that runs by itself, over the network, it draws what there is time for: the newest few
    are waiting, and after each picture it says None once, so that whoever reads gets on.
    """

    name: str
    clock: Literal["video", "host", "board"]
    fps: float
    size_px: tuple[int, int]

    def __init__(self, camera: Moments, scene: Scene | None = None) -> None:
        """Takes ``camera`` over. ``scene`` None = the default one with that camera's exposure."""
        scene = scene or scene_of(camera)
        self._camera = camera
        self._painter = Painter(scene)
        kept = _KEPT if camera.clock == "board" else None
        self._waiting: deque[CameraFrame] = deque(maxlen=kept)
        self._gave = False  # a picture since the last None
        self._before: CameraFrame | None = None
        self.name = f"{camera.name} seen from above"
        self.clock = camera.clock
        self.fps = camera.fps
        self.size_px = scene.size_px

    def read(self) -> Picture | None:
        """The next picture that is due."""
        self._waiting += self._camera.moments()
        if not self._waiting or self._gave:
            self._gave = False
            return None
        self._gave = self.clock == "board"
        frame = self._waiting.popleft()
        truth = truth_of(frame, self._before)
        self._before = frame
        index = picture_index(frame, self.fps)
        return Picture(index, frame.time_s, self._painter.paint(truth, index))

    @property
    def ended(self) -> bool:
        """Never."""
        return False

    def close(self) -> None:
        """Gives the simulated camera up."""
        self._camera.close()


def scene_of(camera: Moments) -> Scene:
    """The default one, exposed as long as by ``camera``."""
    return Scene(exposure_s=camera.exposure_s)


def picture_index(frame: CameraFrame, fps: float) -> int:
    """Counts exposures since the simulator's time 0, lost ones included."""
    return int(frame.time_s * fps)


def truth_of(frame: CameraFrame, before: CameraFrame | None) -> Truth:
    """What to draw for ``frame``; it moves as since ``before``, the frame before it."""
    speed_m_s = turn_rad_s = 0.0
    if before is not None and frame.time_s > before.time_s:
        passed_s = frame.time_s - before.time_s
        speed_m_s = (frame.x_m - before.x_m) / passed_s
        turn_rad_s = (frame.heading_rad - before.heading_rad) / passed_s
    carried = abs(speed_m_s) > _SPEED_MAX_M_S
    return Truth(
        frame.time_s,
        frame.x_m,
        frame.y_m,
        frame.heading_rad,
        frame.tail_rad,
        frame.led,
        0.0 if carried else speed_m_s,
        0.0 if carried else turn_rad_s,
    )
