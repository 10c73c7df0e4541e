"""A simulated board in this process: time passes only while somebody waits."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat._native import ffi, lib
from tailbeat.errors import InputError

PLANTS = {"thesis": 0, "tank": 1}
RADIO, CONSOLE = 0, 1
FLASH_BYTES = 256 * 1024
_READ_BYTES = 16384
_FRAMES_MAX = 256
_MIN_STEP_US = 1000
_PICTURES_MAX = 4096


@dataclass(frozen=True)
class CameraFrame:
    """One processed picture: where the fish was at simulated time ``time_s``."""

    time_s: float
    x_m: float
    y_m: float
    heading_rad: float


@dataclass(frozen=True)
class Truth:
    """The simulator's own state."""

    time_s: float
    x_m: float
    v_m_s: float
    tail_rad: float
    amplitude_rad: float
    swims: int
    swimming: bool
    pulse_ticks: int


class SimBoard:
    """The firmware with a fish around it. Keyword overrides are the fields of sim_config_t."""

    def __init__(self, plant: str = "tank", seed: float = 1, **overrides: float) -> None:
        if plant not in PLANTS:
            raise InputError(f"there is no plant {plant}", f"Use one of: {', '.join(PLANTS)}.")
        if not 0 <= seed < 1 << 64 or seed != int(seed):
            raise InputError(f"{seed} is no seed", "Give a whole number from 0 to 2^64 - 1.")
        config = ffi.new("sim_config_t *")
        lib.sim_config_default(config, PLANTS[plant])
        config.seed = int(seed)
        for name, value in overrides.items():
            setattr(config, config_field(name), value)
        sim = lib.sim_new(config)
        if sim == ffi.NULL:
            raise InputError("the simulator cannot run with these values", "Check them: SI units.")
        self.plant = plant
        self.seed = int(seed)
        self.config: dict[str, float] = {name: getattr(config, name) for name in config_fields()}
        self._sim: Any = ffi.gc(sim, lib.sim_free)
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
        while count := lib.sim_camera_read(self._sim, self._frames, _FRAMES_MAX):
            for frame in self._frames[0:count]:
                self._pictures.append(
                    CameraFrame(frame.time_s, frame.x_m, frame.y_m, frame.heading_rad)
                )

    def truth(self) -> Truth:
        """What really happens."""
        t = lib.sim_truth(self._sim)
        return Truth(
            t.time_s, t.x_m, t.v_m_s, t.tail_rad, t.amplitude_rad, t.swims, t.swimming,
            t.pulse_ticks,
        )  # fmt: skip

    def true_beats(self) -> NDArray[np.float64]:
        """True mean speed of each beat of the present or last swim, m/s."""
        return self._values(lib.sim_true_beats)

    def true_speeds_25hz(self) -> NDArray[np.float64]:
        """True speed every 40 ms of the present or last swim, m/s."""
        return self._values(lib.sim_true_speeds_25hz)

    def set_swim(self, next_swim: int) -> None:
        """The number the next swim's noise is keyed by (1 = first)."""
        lib.sim_set_swim(self._sim, next_swim)

    def power_cycle(self) -> None:
        """Power off and on again; flash stays."""
        lib.sim_power_cycle(self._sim)

    def set_battery_v(self, volts: float) -> None:
        """Battery voltage from now on."""
        lib.sim_set_battery_v(self._sim, volts)

    def set_imu(self, plugged: bool) -> None:
        """Plugs the IMU in or out."""
        lib.sim_set_imu(self._sim, plugged)

    def set_camera(self, on: bool) -> None:
        """Switches the camera."""
        lib.sim_set_camera(self._sim, on)

    def set_radio(self, connected: bool) -> None:
        """Cuts or mends the radio link."""
        lib.sim_set_radio(self._sim, connected)

    def set_tilt_rad(self, roll_rad: float) -> None:
        """Rolls the fish."""
        lib.sim_set_tilt_rad(self._sim, roll_rad)

    @property
    def flash(self) -> bytes:
        """The storage flash as it is now."""
        return bytes(ffi.buffer(lib.sim_flash(self._sim), FLASH_BYTES))

    @flash.setter
    def flash(self, image: bytes) -> None:
        if len(image) != FLASH_BYTES:
            raise InputError("the flash image has the wrong size", f"It has {FLASH_BYTES} bytes.")
        ffi.memmove(lib.sim_flash(self._sim), image, FLASH_BYTES)

    def _values(self, getter: Any) -> NDArray[np.float64]:
        count = getter(self._sim, ffi.NULL, 0)
        out = np.zeros(count, dtype=np.float64)
        getter(self._sim, ffi.cast("double *", out.ctypes.data), count)
        return out


class SimTransport:
    """The radio (or console) of a SimBoard. Its clock is the simulated time."""

    def __init__(self, board: SimBoard, port: int = RADIO) -> None:
        self.name = f"sim:{board.plant}"
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


def config_fields() -> list[str]:
    """Names of all values of the simulator's configuration."""
    return [name for name, _ in ffi.typeof("sim_config_t").fields]


def config_field(name: str) -> str:
    """The field meant by ``name``; its unit may be left out (kappa = kappa_per_m)."""
    fields = [f for f in config_fields() if f not in ("seed", "plant")]
    matches = [f for f in fields if f == name] or [f for f in fields if f.startswith(name + "_")]
    if len(matches) != 1:
        raise InputError(f"the simulator has no value {name}", f"It has: {', '.join(fields)}.")
    return matches[0]
