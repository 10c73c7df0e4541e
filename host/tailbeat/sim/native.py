"""The simulator's board: the firmware compiled for this computer, hal/sim/sim.h."""

from __future__ import annotations

from collections import deque
from typing import Any

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.sim.board import CONSOLE, FLASH_BYTES, RADIO, CameraFrame, SimTransport, Truth
from tailbeat.sim.world import (
    DEFAULT_SEED,
    PLANTS,
    SPEED_MAX_M_S,
    TILT_MAX_RAD,
    board_number,
    config_field,
    config_values,
    make_config,
    read_pictures,
    read_values,
    senseless,
    sensible,
    sensible_hold,
    sensible_pose,
    sensible_swap,
    sensible_volts,
    truth_of,
)

__all__ = ["CONSOLE", "PLANTS", "RADIO", "SimBoard", "SimTransport", "config_field"]

_READ_BYTES = 16384
_FRAMES_MAX = 256
_MIN_STEP_US = 1000
_PICTURES_MAX = 4096


class SimBoard:
    """The firmware with a fish around it. Keyword overrides are the fields of sim_config_t.
    ``seed``: None = disturbances as with 1, but a unique id of its own."""

    def __init__(
        self, plant: str = "tank", /, seed: float | None = None, **overrides: float
    ) -> None:
        config = make_config(plant, DEFAULT_SEED if seed is None else seed, overrides)
        sim = lib.sim_new(config)
        if sim == ffi.NULL:
            raise senseless()
        self.name = f"sim:{plant}"
        self.plant = plant
        self.seed = int(config.seed)
        self.config = config_values(config)
        self._sim: Any = ffi.gc(sim, lib.sim_free)
        lib.sim_set_id(sim, board_number(seed))
        self._bytes = ffi.new("uint8_t[]", _READ_BYTES)
        self._frames = ffi.new("sim_camera_frame_t[]", _FRAMES_MAX)
        self._pictures: deque[CameraFrame] = deque(maxlen=_PICTURES_MAX)
        self.watched = False  # somebody uses the camera: pictures end a wait

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

    def camera_frames(self) -> list[CameraFrame]:
        """Pictures that came in since the last call."""
        self._take_pictures()
        taken = list(self._pictures)
        self._pictures.clear()
        return taken

    def _take_pictures(self) -> None:
        self._pictures += read_pictures(
            lambda out, most: lib.sim_camera_read(self._sim, out, most), self._frames
        )

    def truth(self) -> Truth:
        """State of the fish at the last servo frame, at most 20 ms ago."""
        return truth_of(lib.sim_truth(self._sim))

    def true_beats(self) -> F64:
        """True mean speed of each beat of the present or last swim, m/s."""
        return read_values(lib.sim_true_beats, self._sim)

    def true_speeds_25hz(self) -> F64:
        """True speed every 40 ms of the present or last swim, m/s."""
        return read_values(lib.sim_true_speeds_25hz, self._sim)

    def set_swim(self, next_swim: int) -> None:
        """The number the next swim's noise is keyed by (1 = first)."""
        lib.sim_set_swim(self._sim, next_swim)

    def power_cycle(self) -> None:
        """Power off and on again; flash stays."""
        lib.sim_power_cycle(self._sim)

    def set_battery_v(self, volts: float) -> None:
        """Battery voltage from now on."""
        lib.sim_set_battery_v(self._sim, sensible_volts(volts))

    def set_imu(self, plugged: bool) -> None:
        """Plugs the IMU in or out."""
        lib.sim_set_imu(self._sim, plugged)

    def reboot_imu(self) -> None:
        """The IMU restarts with its saved settings."""
        lib.sim_imu_reboot(self._sim)

    def wedge_imu(self) -> None:
        """The IMU is silent until the next power cycle."""
        lib.sim_imu_wedge(self._sim)

    def set_camera(self, on: bool) -> None:
        """Switches the camera."""
        lib.sim_set_camera(self._sim, on)

    def set_radio(self, connected: bool) -> None:
        """Cuts or mends the radio link."""
        lib.sim_set_radio(self._sim, connected)

    def set_tilt_rad(self, roll_rad: float) -> None:
        """Rolls the fish."""
        lib.sim_set_tilt_rad(self._sim, sensible("a tilt", roll_rad, TILT_MAX_RAD))

    def set_start(self, start_m_s: float) -> None:
        """Speed over water at which the next swim starts."""
        lib.sim_set_start(self._sim, sensible("a start", start_m_s, SPEED_MAX_M_S))

    def push(self, by_m_s: float) -> None:
        """A hand changes the fish's speed, within 0.3 s."""
        lib.sim_push(self._sim, sensible("a push", by_m_s, SPEED_MAX_M_S))

    def hold(self, hold_s: float) -> None:
        """Something stops the fish dead and lets it go after ``hold_s``."""
        lib.sim_hold(self._sim, sensible_hold(hold_s))

    def stir(self, by_m_s: float) -> None:
        """Moves the water along the tank; it comes to rest with a time constant of 8 s."""
        lib.sim_stir(self._sim, sensible("a current", by_m_s, SPEED_MAX_M_S))

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Somebody puts the fish there, at rest; the next swim begins from there."""
        lib.sim_place(self._sim, *sensible_pose(x_m, y_m, heading_rad))

    def swap_battery(self, volts: float, gain: float = 1.0, centre_rad: float = 0.0) -> None:
        """Power off, another pack, power on; the ballast may have shifted."""
        lib.sim_swap_battery(self._sim, *sensible_swap(volts, gain, centre_rad))

    @property
    def flash(self) -> bytes:
        """The storage flash as it is now."""
        return bytes(ffi.buffer(lib.sim_flash(self._sim), FLASH_BYTES))

    @flash.setter
    def flash(self, image: bytes) -> None:
        if len(image) != FLASH_BYTES:
            raise InputError("the flash image has the wrong size", f"It has {FLASH_BYTES} bytes.")
        ffi.memmove(lib.sim_flash(self._sim), image, FLASH_BYTES)
