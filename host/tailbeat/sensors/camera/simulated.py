"""The simulated overhead camera: in this process, or behind the simulator's second TCP port."""

from __future__ import annotations

import contextlib
import json
import socket
from typing import Literal, Protocol

from tailbeat.core.errors import ConnectError, reason
from tailbeat.core.frames import CameraGone, Frame
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
    computed = True  # camera.tracking.repeats

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board
        board.watched = True
        board.camera_frames()
        self.name = board.name
        self.fps = float(board.config["camera_fps"])
        self.exposure_s = min(float(board.config["camera_exposure_s"]), 1 / max(self.fps, 1.0))

    def frames(self) -> list[Frame]:
        """Frames since the last call."""
        return [_frame_of(moment) for moment in self.moments()]

    def moments(self) -> list[CameraFrame]:
        """The same with the tail and the LED."""
        return self._board.camera_frames()

    def close(self) -> None:
        """Pictures end no wait any more."""
        self._board.watched = False


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
        self._told = False
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
        return [_frame_of(moment) for moment in self.moments()]

    def moments(self) -> list[CameraFrame]:
        """The same with the tail and the LED, as far as they are told."""
        while self._open and (piece := self._receive()):
            self._rest += piece
        *lines, self._rest = self._rest.split(b"\n")
        told = [(line, moment) for line in lines if (moment := _moment(line)) is not None]
        self.computed |= any(b'"tail_rad"' in line for line, _ in told)
        moments = [moment for _, moment in told]
        if moments or self._open or self._told:
            return moments
        self._told = True
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
        self._told = True
        with contextlib.suppress(OSError):
            self._socket.close()


def _frame_of(moment: CameraFrame) -> Frame:
    return Frame(moment.time_s, moment.x_m, moment.y_m, moment.heading_rad)


def _moment(line: bytes) -> CameraFrame | None:
    try:
        row = json.loads(line)
        return CameraFrame(
            float(row["t_board_s"]),
            float(row["x_m"]),
            *(float(row.get(name) or 0.0) for name in ("y_m", "heading_rad", "tail_rad", "led")),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
