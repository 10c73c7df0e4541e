"""The fish in its tank, the camera, the IMU and the battery (sim/world.h), and every verb by
which tests, scripts and people handle them.

A verb is a method of ``World`` and a row of ``VERBS``: the words of the fault-injection port and
its help come from there. Nothing else knows verbs.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.lazy_arrays import F64, np
from tailbeat.core.native import ffi, lib
from tailbeat.sim.config import config_values, make_config, senseless

FRAME_US = 20_000  # of the servo

_PICTURES_AT_ONCE = 256
_IMU_MESSAGE_MAX = 640
_NEVER = (1 << 64) - 1
_SPEED_MAX_M_S = 10.0
_FAR_M = 100.0
_HOLD_MAX_S = 1e5
_TURN_MAX_RAD, _TURN_MIN_S = 100.0, 0.02
_VOLTS_MAX = 60.0
_GAIN_MAX = 10.0
_CENTRE_MAX_RAD = 0.5
_LINE_MAX_BYTES = 1000
_OK = "ok"


@dataclass(frozen=True)
class CameraFrame:
    """One processed picture: where the fish was at simulated time ``time_s``, ``x_m`` along the
    tank, ``y_m`` to the right, its heading clockwise from above. ``tail_rad``: angle of the tail
    against the body; ``led``: part of the exposure in which the board's LED was on."""

    time_s: float
    x_m: float
    y_m: float
    heading_rad: float
    tail_rad: float = 0.0
    led: float = 0.0


@dataclass(frozen=True)
class FishState:
    """The simulator's own state. Position and heading are those of the fish's path, about which the
    body sways and swings; ``v_m_s``: over ground, along the heading."""

    time_s: float
    x_m: float
    y_m: float
    heading_rad: float
    v_m_s: float
    tail_rad: float
    amplitude_rad: float
    swims: int
    swimming: bool
    pulse_ticks: int


@dataclass(frozen=True)
class BoardControls:
    """What verbs need of the board in the world. ``now_us``: simulated time; ``imu_changed``: the
    IMU's next message may be another."""

    now_us: Callable[[], int]
    power_cycle: Callable[[], None]
    set_radio: Callable[[bool], None]
    imu_changed: Callable[[], None] = lambda: None


class World:
    """Handles a world_t that somebody else keeps alive. Arguments that make no sense raise
    InputError."""

    def __init__(self, handle: Any, board: BoardControls) -> None:
        self._world = handle
        self._board = board

    def truth(self) -> FishState:
        """State of the fish at the last servo frame, at most 20 ms ago."""
        state = lib.world_truth(self._world)
        # The names of its fields, at hand: asked at each turn of a loop.
        return FishState(*[getattr(state, name) for name in FishState.__match_args__])

    def true_beats(self) -> F64:
        """True mean speed of each beat of the present or last trial, m/s."""
        return _values(lib.world_true_beats, self._world)

    def true_speeds_25hz(self) -> F64:
        """True speed every 40 ms of the present or last trial, m/s."""
        return _values(lib.world_true_speeds_25hz, self._world)

    def set_swim(self, number: float) -> None:
        """The number the next trial's noise is keyed by (1 = first)."""
        if not 1 <= number < 1 << 32 or number != int(number):
            raise InputError(f"{number:g} is no number of a trial", "1 is the first.")
        lib.world_set_swim(self._world, int(number))

    def push(self, by_m_s: float) -> None:
        """A hand changes the fish's speed, within 0.3 s."""
        lib.world_push(self._world, _sensible("a push", by_m_s, _SPEED_MAX_M_S))

    def hold(self, hold_s: float) -> None:
        """Something stops the fish dead and lets it go after ``hold_s``."""
        lib.world_hold(self._world, _sensible("a hold", hold_s, _HOLD_MAX_S, 0.0))

    def stir(self, by_m_s: float) -> None:
        """The water gets faster by that along the tank, within 0.3 s; it comes to rest again with
        a time constant of 8 s, and carries a fish that nobody holds."""
        lib.world_stir(self._world, _sensible("a current", by_m_s, _SPEED_MAX_M_S))

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Somebody puts the fish there, at rest; the next trial begins from there."""
        place = [_sensible("a place", value, _FAR_M) for value in (x_m, y_m)]
        lib.world_place(self._world, *place, _sensible("a heading", heading_rad, math.pi))

    def set_start(self, start_m_s: float) -> None:
        """Speed over water at which the next trial starts."""
        lib.world_set_start(self._world, _sensible("a start", start_m_s, _SPEED_MAX_M_S))

    def set_tilt_rad(self, roll_rad: float) -> None:
        """Rolls the fish."""
        lib.world_set_tilt_rad(self._world, _sensible("a tilt", roll_rad, math.pi))

    def turn(self, roll_rad: float, pitch_rad: float, yaw_rad: float, within_s: float) -> None:
        """A hand turns the fish, at rest, to that attitude within ``within_s``; whole turns count.
        It stays there until it is turned back."""
        angles = [
            _sensible("an angle", one, _TURN_MAX_RAD) for one in (roll_rad, pitch_rad, yaw_rad)
        ]
        within_s = _sensible("a time", within_s, _HOLD_MAX_S, _TURN_MIN_S)
        lib.world_turn(self._world, *angles, within_s)

    def set_battery_v(self, volts: float) -> None:
        """Battery voltage from now on."""
        lib.world_set_battery_v(self._world, _sensible("a voltage", volts, _VOLTS_MAX, 0.0))

    def swap_battery(self, volts: float, gain: float = 1.0, centre_rad: float = 0.0) -> None:
        """Power off, another pack, power on. The hull was open: from the next trial on thrust speed
        is ``gain`` times what it was, and the tail's centre is off by ``centre_rad`` more."""
        lib.world_swap_battery(
            self._world,
            _sensible("a voltage", volts, _VOLTS_MAX, 0.0),
            _sensible("a gain", gain, _GAIN_MAX, 0.0),
            _sensible("a shift of the tail's centre", centre_rad, _CENTRE_MAX_RAD),
        )
        self._board.power_cycle()

    def set_camera(self, on: bool) -> None:
        """Switches the camera."""
        lib.world_set_camera(self._world, on)

    def set_imu(self, plugged: bool) -> None:
        """Plugs the IMU in or out."""
        lib.world_set_imu(self._world, self._board.now_us(), plugged)
        self._board.imu_changed()

    def reboot_imu(self) -> None:
        """The IMU restarts with its saved settings, as by its own watchdog."""
        lib.world_imu_reboot(self._world, self._board.now_us())
        self._board.imu_changed()

    def wedge_imu(self) -> None:
        """The IMU is silent and deaf until the next power cycle."""
        lib.world_imu_wedge(self._world)
        self._board.imu_changed()

    def set_radio(self, connected: bool) -> None:
        """Cuts or mends the radio link."""
        self._board.set_radio(connected)

    def power_cycle(self) -> None:
        """Power off and on again; flash stays."""
        self._board.power_cycle()


@dataclass(frozen=True)
class Verb:
    """A row of the table. ``use``: the name and its arguments, named by their units; what stands in
    brackets may be left out. ``choices``: what stands behind the name instead of numbers."""

    use: str
    does: str
    call: Callable[..., None] | None = None
    choices: Mapping[str, Callable[[World], None]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What the line begins with."""
        return self.use.split()[0]

    def obey(self, world: World, given: Sequence[str]) -> None:
        """Does it with what stood behind the name. Raises InputError."""
        if self.call is None:
            if len(given) != 1 or given[0] not in self.choices:
                raise _bad_use(self.use)
            self.choices[given[0]](world)
            return
        arguments = self.use.split()[1:]
        least = sum(not argument.startswith("[") for argument in arguments)
        try:
            values = [float(text) for text in given]
        except ValueError:
            raise _bad_use(self.use) from None
        if not least <= len(values) <= len(arguments):
            raise _bad_use(self.use)
        self.call(world, *values)


def _on_off(switch: Callable[[World, bool], None]) -> dict[str, Callable[[World], None]]:
    return {"on": lambda world: switch(world, True), "off": lambda world: switch(world, False)}


VERBS = {
    verb.name: verb
    for verb in (
        Verb("push M_S", "a hand changes the fish's speed within 0.3 s", World.push),
        Verb("hold S", "something stops the fish and lets it go after S", World.hold),
        Verb("stir M_S", "the water moves along the tank, dying down", World.stir),
        Verb("place X_M Y_M HEADING_RAD", "somebody puts the fish there", World.place),
        Verb("start M_S", "speed at which the next trial starts", World.set_start),
        Verb("tilt RAD", "rolls the fish", World.set_tilt_rad),
        Verb(
            "turn ROLL_RAD PITCH_RAD YAW_RAD S",
            "a hand turns the fish, at rest, to that attitude within S; whole turns count",
            World.turn,
        ),
        Verb("battery V", "the pack's voltage from now on", World.set_battery_v),
        Verb(
            "swap V [GAIN] [CENTRE_RAD]",
            "another pack; thrust speed times GAIN, the tail's centre off by CENTRE_RAD more",
            World.swap_battery,
        ),
        Verb("camera on|off", "the camera", choices=_on_off(World.set_camera)),
        Verb("radio on|off", "the Bluetooth link", choices=_on_off(World.set_radio)),
        Verb(
            "imu on|off|reboot|wedge",
            "its plug; wedged, it is silent until the next power-on",
            choices=_on_off(World.set_imu) | {"reboot": World.reboot_imu, "wedge": World.wedge_imu},
        ),
        Verb("power cycle", "power off and on again", choices={"cycle": World.power_cycle}),
        Verb("swim NUMBER", "the next trial's noise is that of trial NUMBER", World.set_swim),
    )
}


class CommandLines:
    """Obeys the lines of a client of the fault-injection port, like ``push -0.05``. ``config``:
    plant, seed and values of the simulator, as JSON knows them."""

    def __init__(self, world: World, config: Mapping[str, Any]) -> None:
        self._world = world
        self._asked: dict[str, tuple[str, Callable[[], str]]] = {
            "truth": (
                "the fish's state as JSON",
                lambda: json.dumps(dataclasses.asdict(world.truth())),
            ),
            "config": (
                "plant, seed and all values of the simulator as JSON",
                lambda: json.dumps(config),
            ),
            "help": ("these lines", self._help),
        }
        self._rest = b""

    def hear(self, data: bytes, last: bool = False) -> bytes:
        """The answers to the lines that ``data`` ends; ``last``: nothing will follow."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if last or len(self._rest) > _LINE_MAX_BYTES:
            whole.append(self._rest)
            self._rest = b""
        answers = (self.obey(line.decode("utf-8", "replace")) for line in whole)
        return "".join(f"{answer}\n" for answer in answers if answer).encode()

    def obey(self, line: str) -> str:
        """Does what the line says: ``ok``, what was asked for, or what is wrong. Empty, and nothing
        done, for an empty line and one that begins with #."""
        given = line.split()
        if not given or given[0].startswith("#"):
            return ""
        try:
            if given[0] in self._asked:
                if len(given) > 1 and given[0] != "help":
                    raise _bad_use(given[0])
                return self._asked[given[0]][1]()
            if (verb := VERBS.get(given[0])) is None:
                names = ", ".join([*VERBS, *self._asked])
                raise InputError(f"there is no word '{given[0][:20]}'", f"There are: {names}.")
            verb.obey(self._world, given[1:])
        except TailbeatError as error:
            return " ".join(str(error).split())
        return _OK

    def _help(self) -> str:
        rows = [(verb.use, verb.does) for verb in VERBS.values()]
        rows += [(name, does) for name, (does, _) in self._asked.items()]
        width = max(len(use) for use, _ in rows)
        return "\n".join(f"{use:<{width}}  {does}" for use, does in rows)


class Wires:
    """A world_t of its own, for a board that is not the simulator's. Times are simulated
    microseconds. Keyword overrides are the fields of sim_config_t. Raises InputError when they make
    no sense."""

    def __init__(self, plant: str, seed: float, /, **overrides: float) -> None:
        config = make_config(plant, seed, overrides)
        world = lib.world_new(config)
        if world == ffi.NULL:
            raise senseless()
        self.config = config_values(config)
        self.handle: Any = ffi.gc(world, lib.world_free)
        self._pictures = ffi.new("sim_camera_frame_t[]", _PICTURES_AT_ONCE)
        self._imu_message = ffi.new("uint8_t[]", _IMU_MESSAGE_MAX)

    @property
    def time_us(self) -> int:
        """End of the last servo frame."""
        return int(lib.world_time_us(self.handle))

    def frame(self, now_us: int, next_pulse_ticks: int) -> None:
        """The servo frame that ends now, where the next pulse (0 = none) begins."""
        lib.world_frame(self.handle, now_us, next_pulse_ticks)

    def rest(self, until_us: int) -> None:
        """Frames without pulses, as many as end by ``until_us``."""
        while self.time_us + FRAME_US <= until_us:
            self.frame(self.time_us + FRAME_US, 0)

    def imu_power(self, on: bool, now_us: int) -> None:
        """The board's supply, which feeds the IMU, goes on or off."""
        if on:
            lib.world_imu_power_on(self.handle, now_us)
        else:
            lib.world_imu_power_off(self.handle)

    def imu_due_us(self) -> int | None:
        """When the IMU begins to send its next message."""
        return _time(lib.world_imu_due_us(self.handle))

    def imu_baud(self) -> int:
        """The rate it sends that message at."""
        return int(lib.world_imu_baud(self.handle))

    def imu_read(self) -> bytes:
        """Takes that message; empty when the wire lost all of it."""
        length = lib.world_imu_read(self.handle, self._imu_message)
        return bytes(ffi.buffer(self._imu_message, length))

    def imu_write(self, now_us: int, data: bytes, baud: int) -> None:
        """Bytes to the IMU, sent at ``baud``, whose last bit arrives now."""
        lib.world_imu_write(self.handle, now_us, ffi.from_buffer(data), len(data), baud)

    def battery_v(self) -> float:
        """Voltage of the pack now."""
        return float(lib.world_battery_v(self.handle))

    def led(self, now_us: int, on: bool) -> None:
        """The board's LED is on or off from now on."""
        lib.world_led(self.handle, now_us, on)

    def camera_due_us(self) -> int | None:
        """When the next picture comes in."""
        return _time(lib.world_camera_due_us(self.handle))

    def camera_read(self, now_us: int) -> list[CameraFrame]:
        """Pictures that have come in by now."""
        return read_pictures(
            lambda out, most: lib.world_camera_read(self.handle, now_us, out, most), self._pictures
        )


def picture_of(f: Any) -> CameraFrame:
    """A sim_camera_frame_t."""
    return CameraFrame(f.time_s, f.x_m, f.y_m, f.heading_rad, f.tail_rad, f.led)


def read_pictures(getter: Any, buffer: Any) -> list[CameraFrame]:
    """All that ``getter(out, max)`` has, by way of ``buffer``."""
    found: list[CameraFrame] = []
    count = most = len(buffer)
    while count == most:
        count = getter(buffer, most)
        for at in range(count):
            found.append(picture_of(buffer[at]))
    return found


def _bad_use(use: str) -> InputError:
    return InputError(f"that is not how '{use.split()[0]}' is written", f"Write: {use}")


def _sensible(what: str, value: float, most: float, least: float | None = None) -> float:
    """``value`` from ``least`` (default: ``-most``) to ``most``. Raises InputError otherwise."""
    low = -most if least is None else least
    if not low <= value <= most:
        raise InputError(f"{what} of {value:g} makes no sense", f"From {low:g} to {most:g}, SI.")
    return value


def _values(getter: Any, handle: Any) -> F64:
    """All that ``getter(handle, out, max)`` has."""
    count = getter(handle, ffi.NULL, 0)
    out = np.zeros(count, dtype=np.float64)
    getter(handle, ffi.cast("double *", out.ctypes.data), count)
    return out


def _time(time_us: int) -> int | None:
    return None if time_us == _NEVER else int(time_us)
