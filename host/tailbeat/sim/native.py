"""The simulator's board: the firmware compiled for this computer, hal/sim/sim.h."""

from __future__ import annotations

from typing import Any

from tailbeat.core.native import ffi, lib
from tailbeat.sim.board import CONSOLE, FLASH_BYTES, RADIO, SimTransport, SimulatedBoard
from tailbeat.sim.config import (
    DEFAULT_SEED,
    PLANTS,
    board_number,
    config_field,
    config_values,
    make_config,
    senseless,
)
from tailbeat.sim.world import BoardControls, World, read_pictures

__all__ = ["CONSOLE", "PLANTS", "RADIO", "SimBoard", "SimTransport", "config_field"]

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
        self._frames = ffi.new("sim_camera_frame_t[]", _FRAMES_MAX)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(lib.sim_time_us(self._sim)) * 1e-6

    @property
    def board_time_s(self) -> float:
        """The board's clock: time since it booted."""
        return float(lib.sim_board_time_us(self._sim)) * 1e-6

    def run(self, duration_s: float, port: int = -1, camera: bool = False) -> float:
        """Lets time pass; the time left (s) when bytes on ``port`` or a picture ended it early."""
        duration_us = max(_MIN_STEP_US, round(duration_s * 1e6))
        left_us = lib.sim_run(self._sim, duration_us, port, camera)
        if camera:
            self._take_pictures()  # one left where it is would end the next wait at once
        return float(left_us) * 1e-6

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
        taken = read_pictures(
            lambda out, most: lib.sim_camera_read(self._sim, out, most), self._frames
        )
        self._pictures += taken
        return bool(taken)

    def _storage(self) -> bytes:
        return bytes(ffi.buffer(lib.sim_flash(self._sim), FLASH_BYTES))

    def _set_storage(self, image: bytes) -> None:
        ffi.memmove(lib.sim_flash(self._sim), image, FLASH_BYTES)
