"""The simulated overhead camera: in this process, or behind the simulator's second TCP port."""

from __future__ import annotations

import contextlib
import json
import socket
from typing import Literal

from tailbeat.camera.base import Frame
from tailbeat.errors import ConnectError, reason
from tailbeat.transport.inprocess import SimulatedBoard

_CHUNK_BYTES = 65536


class SimulatedCamera:
    """Frames of a board in this process, in simulated time (the clock of its transport)."""

    clock: Literal["host", "board"] = "host"

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board
        board.watched = True
        board.camera_frames()
        self.fps = float(board.config["camera_fps"])

    def frames(self) -> list[Frame]:
        """Frames since the last call."""
        return [Frame(f.time_s, f.x_m, f.y_m, f.heading_rad) for f in self._board.camera_frames()]

    def close(self) -> None:
        """Pictures end no wait any more."""
        self._board.watched = False


class RemoteCamera:
    """Frames as JSON lines over TCP: {"t_board_s", "x_m", "y_m", "heading_rad"}, in board time."""

    clock: Literal["host", "board"] = "board"

    def __init__(self, host: str, port: int, fps: float = 25.0) -> None:
        self.fps = fps
        self._rest = b""
        try:
            self._socket = socket.create_connection((host, port), 2.0)
        except (OSError, UnicodeError, OverflowError) as error:
            raise ConnectError(
                f"no camera answers at tcp:{host}:{port} ({reason(error)})",
                "A simulated one comes with: tailbeat sim",
            ) from error
        self._socket.setblocking(False)

    def frames(self) -> list[Frame]:
        """Frames since the last call; a camera that has gone gives none."""
        while True:
            try:
                piece = self._socket.recv(_CHUNK_BYTES)
            except OSError:
                break
            if not piece:
                break
            self._rest += piece
        *lines, self._rest = self._rest.split(b"\n")
        return [frame for line in lines if (frame := _frame(line)) is not None]

    def close(self) -> None:
        """Closes the connection."""
        with contextlib.suppress(OSError):
            self._socket.close()


def _frame(line: bytes) -> Frame | None:
    try:
        row = json.loads(line)
        return Frame(
            float(row["t_board_s"]),
            float(row["x_m"]),
            float(row.get("y_m", 0.0)),
            float(row.get("heading_rad", 0.0)),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
