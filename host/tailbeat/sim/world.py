"""The simulated world by itself, for a board that is not the simulator's own: hal/sim/world.h."""

from __future__ import annotations

import math
import secrets
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.sim.board import CameraFrame, Truth

PLANTS = {"thesis": 0, "tank": 1}
DEFAULT_SEED = 1
SPEED_MAX_M_S = 10.0
TILT_MAX_RAD = math.pi
FRAME_US = 20_000  # of the servo

_PICTURES_AT_ONCE = 256
_IMU_MESSAGE_MAX = 640
_NEVER = (1 << 64) - 1
_FAR_M = 100.0
_HOLD_MAX_S = 1e5
_VOLTS_MAX = 60.0
_GAIN_MAX = 10.0
_CENTRE_MAX_RAD = 0.5


class World:
    """The fish in its tank, the camera, the IMU and the battery. Times are simulated microseconds.

    Keyword overrides are the fields of sim_config_t. Raises InputError when they make no sense.
    """

    def __init__(self, plant: str, seed: float, /, **overrides: float) -> None:
        config = make_config(plant, seed, overrides)
        world = lib.world_new(config)
        if world == ffi.NULL:
            raise senseless()
        self.config = config_values(config)
        self._world: Any = ffi.gc(world, lib.world_free)
        self._pictures = ffi.new("sim_camera_frame_t[]", _PICTURES_AT_ONCE)
        self._imu_message = ffi.new("uint8_t[]", _IMU_MESSAGE_MAX)

    @property
    def time_us(self) -> int:
        """End of the last servo frame."""
        return int(lib.world_time_us(self._world))

    def frame(self, now_us: int, next_pulse_ticks: int) -> None:
        """The servo frame that ends now, where the next pulse (0 = none) begins."""
        lib.world_frame(self._world, now_us, next_pulse_ticks)

    def rest(self, until_us: int) -> None:
        """Frames without pulses, as many as end by ``until_us``."""
        while self.time_us + FRAME_US <= until_us:
            self.frame(self.time_us + FRAME_US, 0)

    def imu_power(self, on: bool, now_us: int) -> None:
        """The board's supply, which feeds the IMU, goes on or off."""
        if on:
            lib.world_imu_power_on(self._world, now_us)
        else:
            lib.world_imu_power_off(self._world)

    def imu_due_us(self) -> int | None:
        """When the IMU begins to send its next message."""
        return _time(lib.world_imu_due_us(self._world))

    def imu_baud(self) -> int:
        """The rate it sends that message at."""
        return int(lib.world_imu_baud(self._world))

    def imu_read(self) -> bytes:
        """Takes that message; empty when the wire lost all of it."""
        length = lib.world_imu_read(self._world, self._imu_message)
        return bytes(ffi.buffer(self._imu_message, length))

    def imu_write(self, now_us: int, data: bytes, baud: int) -> None:
        """Bytes to the IMU, sent at ``baud``, whose last bit arrives now."""
        lib.world_imu_write(self._world, now_us, ffi.from_buffer(data), len(data), baud)

    def imu_reboot(self, now_us: int) -> None:
        """The IMU restarts with its saved settings."""
        lib.world_imu_reboot(self._world, now_us)

    def imu_wedge(self) -> None:
        """The IMU is silent and deaf until its supply has been off."""
        lib.world_imu_wedge(self._world)

    def battery_v(self) -> float:
        """Voltage of the pack now."""
        return float(lib.world_battery_v(self._world))

    def led(self, now_us: int, on: bool) -> None:
        """The board's LED is on or off from now on."""
        lib.world_led(self._world, now_us, on)

    def camera_due_us(self) -> int | None:
        """When the next picture comes in."""
        return _time(lib.world_camera_due_us(self._world))

    def camera_read(self, now_us: int) -> list[CameraFrame]:
        """Pictures that have come in by now."""
        return read_pictures(
            lambda out, most: lib.world_camera_read(self._world, now_us, out, most), self._pictures
        )

    def truth(self) -> Truth:
        """State of the fish at the end of the last frame."""
        return truth_of(lib.world_truth(self._world))

    def true_beats(self) -> F64:
        """True mean speed of each beat of the present or last swim, m/s."""
        return read_values(lib.world_true_beats, self._world)

    def true_speeds_25hz(self) -> F64:
        """True speed every 40 ms of the present or last swim, m/s."""
        return read_values(lib.world_true_speeds_25hz, self._world)

    def set_swim(self, next_swim: int) -> None:
        """The number the next swim's noise is keyed by (1 = first)."""
        lib.world_set_swim(self._world, next_swim)

    def set_battery_v(self, volts: float) -> None:
        """Battery voltage from now on."""
        lib.world_set_battery_v(self._world, sensible_volts(volts))

    def set_imu(self, now_us: int, plugged: bool) -> None:
        """Plugs the IMU in or out."""
        lib.world_set_imu(self._world, now_us, plugged)

    def set_camera(self, on: bool) -> None:
        """Switches the camera."""
        lib.world_set_camera(self._world, on)

    def set_tilt_rad(self, roll_rad: float) -> None:
        """Rolls the fish."""
        lib.world_set_tilt_rad(self._world, sensible("a tilt", roll_rad, TILT_MAX_RAD))

    def set_start(self, start_m_s: float) -> None:
        """Speed over water at which the next swim starts."""
        lib.world_set_start(self._world, sensible("a start", start_m_s, SPEED_MAX_M_S))

    def push(self, by_m_s: float) -> None:
        """A hand changes the fish's speed, within 0.3 s."""
        lib.world_push(self._world, sensible("a push", by_m_s, SPEED_MAX_M_S))

    def hold(self, hold_s: float) -> None:
        """Something stops the fish dead and lets it go after ``hold_s``."""
        lib.world_hold(self._world, sensible_hold(hold_s))

    def stir(self, by_m_s: float) -> None:
        """Moves the water along the tank; it comes to rest with a time constant of 8 s."""
        lib.world_stir(self._world, sensible("a current", by_m_s, SPEED_MAX_M_S))

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Somebody puts the fish there, at rest; the next swim begins from there."""
        lib.world_place(self._world, *sensible_pose(x_m, y_m, heading_rad))

    def swap_battery(self, volts: float, gain: float, centre_rad: float) -> None:
        """Another pack; the ballast may have shifted. The board's power is the caller's."""
        lib.world_swap_battery(self._world, *sensible_swap(volts, gain, centre_rad))


def board_number(seed: float | None) -> int:
    """What tells a simulated board from others, the last 8 bytes of its unique id: the seed if one
    is given, so that it is the same board each time; otherwise random."""
    return secrets.randbits(64) if seed is None else int(seed)


def make_config(plant: str, seed: float, overrides: dict[str, float]) -> Any:
    """A sim_config_t. Raises InputError for names there are none of."""
    if plant not in PLANTS:
        raise InputError(f"there is no plant {plant}", f"Use one of: {', '.join(PLANTS)}.")
    if not 0 <= seed < 1 << 64 or seed != int(seed):
        raise InputError(f"{seed} is no seed", "Give a whole number from 0 to 2^64 - 1.")
    config = ffi.new("sim_config_t *")
    lib.sim_config_default(config, PLANTS[plant])
    config.seed = int(seed)
    for name, value in overrides.items():
        setattr(config, config_field(name), value)
    return config


def senseless() -> InputError:
    """The error for values that fit no world."""
    return InputError("the simulator cannot run with these values", "Check them: SI units.")


def sensible(what: str, value: float, most: float, least: float | None = None) -> float:
    """``value`` from ``least`` (default: ``-most``) to ``most``. Raises InputError otherwise."""
    low = -most if least is None else least
    if not low <= value <= most:
        raise InputError(f"{what} of {value:g} makes no sense", f"From {low:g} to {most:g}, SI.")
    return value


def sensible_hold(hold_s: float) -> float:
    """How long something holds the fish. Raises InputError."""
    return sensible("a hold", hold_s, _HOLD_MAX_S, 0.0)


def sensible_volts(volts: float) -> float:
    """Of a pack. Raises InputError."""
    return sensible("a voltage", volts, _VOLTS_MAX, 0.0)


def sensible_pose(x_m: float, y_m: float, heading_rad: float) -> tuple[float, float, float]:
    """Where somebody may put the fish. Raises InputError."""
    return (
        sensible("a place", x_m, _FAR_M),
        sensible("a place", y_m, _FAR_M),
        sensible("a heading", heading_rad, math.pi),
    )


def sensible_swap(volts: float, gain: float, centre_rad: float) -> tuple[float, float, float]:
    """What a swap of the battery may bring. Raises InputError."""
    return (
        sensible_volts(volts),
        sensible("a gain", gain, _GAIN_MAX, 0.0),
        sensible("a shift of the tail's centre", centre_rad, _CENTRE_MAX_RAD),
    )


def config_values(config: Any) -> dict[str, float]:
    """All values of a sim_config_t by name."""
    return {name: getattr(config, name) for name in config_fields()}


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


def truth_of(t: Any) -> Truth:
    """From a sim_truth_t."""
    return Truth(
        time_s=t.time_s,
        x_m=t.x_m,
        y_m=t.y_m,
        heading_rad=t.heading_rad,
        v_m_s=t.v_m_s,
        tail_rad=t.tail_rad,
        amplitude_rad=t.amplitude_rad,
        swims=t.swims,
        swimming=t.swimming,
        pulse_ticks=t.pulse_ticks,
    )


def read_values(getter: Any, handle: Any) -> F64:
    """All that ``getter(handle, out, max)`` has."""
    count = getter(handle, ffi.NULL, 0)
    out = np.zeros(count, dtype=np.float64)
    getter(handle, ffi.cast("double *", out.ctypes.data), count)
    return out


def read_pictures(getter: Any, buffer: Any) -> list[CameraFrame]:
    """All that ``getter(out, max)`` has, by way of ``buffer``."""
    found = []
    while count := getter(buffer, len(buffer)):
        found += [_picture(f) for f in buffer[0:count]]
    return found


def _picture(f: Any) -> CameraFrame:
    return CameraFrame(f.time_s, f.x_m, f.y_m, f.heading_rad, f.tail_rad, f.led)


def _time(time_us: int) -> int | None:
    return None if time_us == _NEVER else int(time_us)
