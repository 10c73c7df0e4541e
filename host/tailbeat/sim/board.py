"""Boards that live in this process, whose time passes only while somebody waits: what they have in
common, the transport to them, and the simulated board, which is the firmware compiled for this
computer (sim/sim.h).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from typing import Any

from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.link.transport import InFront, Transport
from tailbeat.sim.config import (
    DEFAULT_SEED,
    PLANTS,
    board_number,
    config_field,
    config_values,
    make_config,
    senseless,
)
from tailbeat.sim.world import BoardControls, CameraFrame, World, picture_of, read_pictures

__all__ = ["CONSOLE", "PLANTS", "RADIO", "SimBoard", "SimTransport", "config_field"]

RADIO, CONSOLE = 0, 1
FLASH_BYTES = 256 * 1024
_PICTURES_MAX = 4096


class SimulatedBoard(ABC):
    """The firmware with a simulated fish around it.

    ``config``: the fields of sim_config_t. ``world``: the fish and all around it, and every verb
    that handles them. ``watched``: somebody uses the camera, pictures end a
    wait. Same seed and same calls, same run, bit for bit.
    """

    world: World

    def __init__(self, name: str, plant: str, seed: float | None, config: dict[str, float]) -> None:
        self.name = name
        self.plant = plant
        self.seed = int(DEFAULT_SEED if seed is None else seed)
        self.config = config
        self.watched = False
        self._pictures: deque[CameraFrame] = deque(maxlen=_PICTURES_MAX)

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Simulated time."""

    @property
    @abstractmethod
    def board_time_s(self) -> float:
        """The board's clock: time since it booted; 0 before that."""

    @abstractmethod
    def run(self, duration_s: float, port: int = -1, camera: bool = False) -> float:
        """Lets time pass, 1 ms at least; the time left (s) when bytes on ``port`` or, with
        ``camera``, a picture ended it early."""

    @abstractmethod
    def write(self, data: bytes, port: int = RADIO) -> int:
        """Bytes towards the board; how many were taken."""

    @abstractmethod
    def read(self, port: int = RADIO) -> bytes:
        """Bytes from the board."""

    def camera_frames(self) -> list[CameraFrame]:
        """Pictures that came in since the last call."""
        self._take_pictures()
        taken = list(self._pictures)
        self._pictures.clear()
        return taken

    @abstractmethod
    def _take_pictures(self) -> bool:
        """Collects the pictures that have come in; whether there was one."""

    @property
    def flash(self) -> bytes:
        """The storage flash as it is now."""
        return self._storage()

    @flash.setter
    def flash(self, image: bytes) -> None:
        if len(image) != FLASH_BYTES:
            raise InputError("the flash image has the wrong size", f"It has {FLASH_BYTES} bytes.")
        self._set_storage(image)

    @abstractmethod
    def _storage(self) -> bytes: ...

    @abstractmethod
    def _set_storage(self, image: bytes) -> None: ...


class SimTransport:
    """The radio (or console) of a board in this process. Its clock is the simulated time."""

    def __init__(self, board: SimulatedBoard, port: int = RADIO) -> None:
        self.name = board.name
        self.board = board
        self.port = port

    def read(self) -> bytes:
        """What the board has sent."""
        return self.board.read(self.port)

    def write(self, data: bytes) -> None:
        """Bytes towards the board."""
        self.board.write(data, self.port)

    def wait(self, timeout_s: float) -> None:
        """Lets simulated time pass, until bytes or a picture arrive or it is over."""
        self.board.run(timeout_s, self.port, self.board.watched)

    def now_s(self) -> float:
        """Simulated time."""
        return self.board.time_s

    def reopen(self) -> None:
        """There is nothing to open."""

    def close(self) -> None:
        """The board lives on with its owner."""


def in_process(transport: Transport) -> SimTransport | None:
    """The transport to a board in this process, behind whatever bad line; None for any other."""
    while isinstance(transport, InFront):
        transport = transport.inner
    return transport if isinstance(transport, SimTransport) else None


_READ_BYTES = 16384
_FRAMES_MAX = 256
_MIN_STEP_US = 1000


class SimBoard(SimulatedBoard):
    """The firmware with a fish around it. Keyword overrides are the fields of sim_config_t.
    ``seed``: None = disturbances as with 1, but a unique id of its own."""

    def __init__(
        self, plant: str = "tank", /, seed: float | None = None, **overrides: float
    ) -> None:
        config = make_config(plant, DEFAULT_SEED if seed is None else seed, overrides)
        made = lib.sim_new(config)
        if made == ffi.NULL:
            raise senseless()
        sim = ffi.gc(made, lib.sim_free)
        super().__init__(f"sim:{plant}", plant, seed, config_values(config))
        self._sim: Any = sim
        lib.sim_set_id(sim, board_number(seed))
        controls = BoardControls(
            now_us=lambda: int(lib.sim_time_us(sim)),
            power_cycle=lambda: lib.sim_power_cycle(sim),
            set_radio=lambda connected: lib.sim_set_radio(sim, connected),
        )
        self.world = World(lib.sim_world(sim), controls)
        self._bytes = ffi.new("uint8_t[]", _READ_BYTES)
        self._time_s = float(lib.sim_time_us(sim)) * 1e-6  # passes in run() alone
        self._taken_s = -1.0  # time at which no picture was left
        self._frames = ffi.new("sim_camera_frame_t[]", _FRAMES_MAX)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self._time_s

    @property
    def board_time_s(self) -> float:
        """The board's clock: time since it booted."""
        return float(lib.sim_board_time_us(self._sim)) * 1e-6

    def run(self, duration_s: float, port: int = -1, camera: bool = False) -> float:
        """Lets time pass; the time left (s) when bytes on ``port`` or a picture ended it early."""
        duration_us = max(_MIN_STEP_US, round(duration_s * 1e6))
        left_us = lib.sim_run(self._sim, duration_us, port, camera)
        self._time_s = float(lib.sim_time_us(self._sim)) * 1e-6
        if camera:
            self._take_pictures()  # one left where it is would end the next wait at once
        return float(left_us) * 1e-6

    def converse(self, wire: Any) -> CameraFrame | None:
        """Lets time pass as trial_wire_run (host/native/trial_wire.h) does; the picture that it
        shows, or None for an event."""
        shown = lib.trial_wire_run(wire, self._sim) == lib.TRIAL_WIRE_PICTURE
        self._time_s = self._taken_s = float(lib.sim_time_us(self._sim)) * 1e-6
        return picture_of(wire.pictures[0]) if shown else None

    def take_pictures_of(self, wire: Any) -> None:
        """Keeps the pictures that ``converse`` has left, as if they came now."""
        self._pictures += [picture_of(wire.pictures[at]) for at in range(wire.picture_count)]
        wire.picture_count = 0

    def write(self, data: bytes, port: int = RADIO) -> int:
        """Bytes towards the board."""
        return int(lib.sim_link_write(self._sim, port, ffi.from_buffer(data), len(data)))

    def read(self, port: int = RADIO) -> bytes:
        """Bytes from the board."""
        pieces = []
        while count := lib.sim_link_read(self._sim, port, self._bytes, _READ_BYTES):
            pieces.append(bytes(ffi.buffer(self._bytes, count)))
        return b"".join(pieces)

    def _take_pictures(self) -> bool:
        if self._time_s == self._taken_s:
            return False
        self._taken_s = self._time_s
        taken = read_pictures(self._read_pictures, self._frames)
        self._pictures += taken
        return bool(taken)

    def _read_pictures(self, out: Any, most: int) -> int:
        return int(lib.sim_camera_read(self._sim, out, most))

    def _storage(self) -> bytes:
        return bytes(ffi.buffer(lib.sim_flash(self._sim), FLASH_BYTES))

    def _set_storage(self, image: bytes) -> None:
        ffi.memmove(lib.sim_flash(self._sim), image, FLASH_BYTES)
