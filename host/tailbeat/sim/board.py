"""Boards that live in this process: what they have in common, and the transport to them. Their time
passes only while somebody waits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

from tailbeat.core.errors import InputError
from tailbeat.link.impaired import ImpairedLine
from tailbeat.link.transport import Transport
from tailbeat.sim.config import DEFAULT_SEED
from tailbeat.sim.world import CameraFrame, World

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
        self._port = port

    def read(self) -> bytes:
        """What the board has sent."""
        return self.board.read(self._port)

    def write(self, data: bytes) -> None:
        """Bytes towards the board."""
        self.board.write(data, self._port)

    def wait(self, timeout_s: float) -> None:
        """Lets simulated time pass, until bytes or a picture arrive or it is over."""
        self.board.run(timeout_s, self._port, self.board.watched)

    def now_s(self) -> float:
        """Simulated time."""
        return self.board.time_s

    def reopen(self) -> None:
        """There is nothing to open."""

    def close(self) -> None:
        """The board lives on with its owner."""


def in_process(transport: Transport) -> SimTransport | None:
    """The transport to a board in this process, behind whatever bad line; None for any other."""
    while isinstance(transport, ImpairedLine):
        transport = transport.inner
    return transport if isinstance(transport, SimTransport) else None
