"""The simulated overhead camera: positions, in this process or over TCP, and rendered pictures."""

from __future__ import annotations

import contextlib
import socket
from collections import deque
from typing import Literal, Protocol

import msgspec

from tailbeat.core.errors import ConnectError, reason
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.picture import PictureSource, TimedImage
from tailbeat.sim.board import SimulatedBoard
from tailbeat.sim.world import CameraFrame

_CHUNK_BYTES = 65536


class Moments(Protocol):
    """A simulated camera: what there was to be seen, and by how long an exposure."""

    name: str
    clock: Literal["host", "board"]
    fps: float
    exposure_s: float

    def moments(self) -> list[CameraFrame]:
        """Those since the last call, in order of time; never blocks. May raise CameraGone."""

    def close(self) -> None:
        """Gives the camera up."""


class SimulatedCamera:
    """Frames of a board in this process, in simulated time (the clock of its transport)."""

    clock: Literal["host", "board"] = "host"
    computed = True  # RepeatFilter lets all its positions pass

    def __init__(self, board: SimulatedBoard) -> None:
        self.board = board
        board.watched = True
        board.camera_frames()
        self.name = board.name
        self.fps = float(board.config["camera_fps"])
        self.exposure_s = min(float(board.config["camera_exposure_s"]), 1 / max(self.fps, 1.0))

    def frames(self) -> list[Frame]:
        """Frames since the last call."""
        return [frame_of(moment) for moment in self.moments()]

    def moments(self) -> list[CameraFrame]:
        """The same with the tail and the LED."""
        return self.board.camera_frames()

    def close(self) -> None:
        """Pictures end no wait any more."""
        self.board.watched = False


class RemoteCamera:
    """Frames as JSON lines over TCP: {"t_board_s", "x_m", "y_m", "heading_rad"}, in board time; a
    simulator adds "tail_rad" and "led"."""

    clock: Literal["host", "board"] = "board"

    def __init__(self, host: str, port: int, fps: float = 25.0) -> None:
        self.name = f"tcp:{host}:{port}"
        self.fps = fps
        self.exposure_s = 0.01
        self.computed = False  # until a simulator's line has come; a program may track pictures
        self._rest = b""
        self._open = True
        self._reported = False
        try:
            self._socket = socket.create_connection((host, port), 2.0)
        except (OSError, UnicodeError, OverflowError) as error:
            raise ConnectError(
                f"no camera answers at tcp:{host}:{port} ({reason(error)})",
                "A simulated one comes with: tailbeat sim",
            ) from error
        self._socket.setblocking(False)

    def frames(self) -> list[Frame]:
        """Frames since the last call; raises CameraGone once when there will be no more."""
        return [frame_of(moment) for moment in self.moments()]

    def moments(self) -> list[CameraFrame]:
        """The same with the tail and the LED, as far as they are sent."""
        while self._open and (piece := self._receive()):
            self._rest += piece
        *lines, self._rest = self._rest.split(b"\n")
        known = [(line, moment) for line in lines if (moment := _moment(line)) is not None]
        self.computed |= any(b'"tail_rad"' in line for line, _ in known)
        moments = [moment for _, moment in known]
        if moments or self._open or self._reported:
            return moments
        self._reported = True
        raise CameraGone(
            "the camera behind the network has hung up", "Look at the program that sends positions."
        )

    def _receive(self) -> bytes:
        """What has arrived; nothing also when the peer has gone."""
        try:
            piece = self._socket.recv(_CHUNK_BYTES)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            piece = b""
        self._open = bool(piece)
        return piece

    def close(self) -> None:
        """Closes the connection; nothing is raised of what that breaks."""
        self._reported = True
        with contextlib.suppress(OSError):
            self._socket.close()


def frame_of(moment: CameraFrame) -> Frame:
    """What a tracker would tell of it."""
    return Frame(moment.time_s, moment.x_m, moment.y_m, moment.heading_rad)


class _PositionLine(msgspec.Struct):
    """A line of a stream of positions."""

    t_board_s: float
    x_m: float
    y_m: float | None = 0.0
    heading_rad: float | None = 0.0
    tail_rad: float | None = 0.0
    led: float | None = 0.0


def _moment(line: bytes) -> CameraFrame | None:
    try:
        row = msgspec.json.decode(line, type=_PositionLine)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None
    rest = (row.y_m, row.heading_rad, row.tail_rad, row.led)
    return CameraFrame(row.t_board_s, row.x_m, *(value or 0.0 for value in rest))


_SPEED_MAX_M_S = 1.0  # faster than that somebody has carried the fish
_KEPT = 4


class RenderedDevice(PictureSource):
    """Pictures of a simulated fish, as they come due; ``calibration`` is the true one.

    The simulator's own camera noise is how far the drawn fish is off the truth in each picture;
    its lost frames are pictures that never come. read() never blocks; None = none due yet. Of a
    simulator that runs by itself, over the network, it draws what there is time for: the newest few
    are waiting, and after each picture it says None once, so that whoever reads gets on.
    """

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
        self.calibration = scene.calibration()

    def read(self) -> TimedImage | None:
        """The next picture that is due."""
        self._waiting += self._camera.moments()
        if not self._waiting or self._gave:
            self._gave = False
            return None
        self._gave = self.clock == "board"
        frame = self._waiting.popleft()
        truth = drawn_pose_of(frame, self._before)
        self._before = frame
        index = picture_index(frame, self.fps)
        return TimedImage(index, frame.time_s, self._painter.paint(truth, index))

    def close(self) -> None:
        """Gives the simulated camera up."""
        self._camera.close()


def scene_of(camera: Moments) -> Scene:
    """The default one, exposed as long as by ``camera``."""
    return Scene(exposure_s=camera.exposure_s)


def picture_index(frame: CameraFrame, fps: float) -> int:
    """Counts exposures since the simulator's time 0, lost ones included."""
    return int(frame.time_s * fps)


def drawn_pose_of(frame: CameraFrame, before: CameraFrame | None) -> DrawnPose:
    """What to draw for ``frame``; it moves as since ``before``, the frame before it."""
    speed_m_s = turn_rad_s = 0.0
    if before is not None and frame.time_s > before.time_s:
        passed_s = frame.time_s - before.time_s
        speed_m_s = (frame.x_m - before.x_m) / passed_s
        turn_rad_s = (frame.heading_rad - before.heading_rad) / passed_s
    if abs(speed_m_s) > _SPEED_MAX_M_S:
        return DrawnPose(**vars(frame))
    return DrawnPose(**vars(frame), speed_m_s=speed_m_s, turn_rad_s=turn_rad_s)
