"""Boards that live in this process: what they have in common, and the transport to them. Their time
passes only while somebody waits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tailbeat.core.arrays import F64
from tailbeat.link.impaired import BadLine
from tailbeat.link.transport import Transport

RADIO, CONSOLE = 0, 1
FLASH_BYTES = 256 * 1024


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
class Truth:
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


class SimulatedBoard(Protocol):
    """The firmware with a simulated fish around it.

    ``config``: the fields of sim_config_t. ``watched``: somebody uses the camera, pictures end a
    wait. Same seed and same calls, same run, bit for bit.
    """

    name: str
    plant: str
    seed: int
    config: dict[str, float]
    watched: bool

    @property
    def time_s(self) -> float:
        """Simulated time."""

    @property
    def board_time_s(self) -> float:
        """The board's clock: time since it booted; 0 before that."""

    def run(self, duration_s: float, port: int = -1, camera: bool = False) -> float:
        """Lets time pass, 1 ms at least; the time left (s) when bytes on ``port`` or, with
        ``camera``, a picture ended it early."""

    def write(self, data: bytes, port: int = RADIO) -> int:
        """Bytes towards the board; how many were taken."""

    def read(self, port: int = RADIO) -> bytes:
        """Bytes from the board."""

    def camera_frames(self) -> list[CameraFrame]:
        """Pictures that came in since the last call."""

    def truth(self) -> Truth:
        """State of the fish."""

    def true_beats(self) -> F64:
        """True mean speed of each beat of the present or last swim, m/s."""

    def true_speeds_25hz(self) -> F64:
        """True speed every 40 ms of the present or last swim, m/s."""

    def set_swim(self, next_swim: int) -> None:
        """The number the next swim's noise is keyed by (1 = first)."""

    def power_cycle(self) -> None:
        """Power off and on again; flash stays."""

    def set_battery_v(self, volts: float) -> None:
        """Battery voltage from now on."""

    def set_imu(self, plugged: bool) -> None:
        """Plugs the IMU in or out."""

    def reboot_imu(self) -> None:
        """The IMU restarts with its saved settings, as by its own watchdog."""

    def wedge_imu(self) -> None:
        """The IMU is silent and deaf until the next power cycle."""

    def set_camera(self, on: bool) -> None:
        """Switches the camera."""

    def set_radio(self, connected: bool) -> None:
        """Cuts or mends the radio link."""

    def set_tilt_rad(self, roll_rad: float) -> None:
        """Rolls the fish."""

    def set_start(self, start_m_s: float) -> None:
        """Speed over water at which the next swim starts."""

    def push(self, by_m_s: float) -> None:
        """A hand changes the fish's speed, within 0.3 s."""

    def hold(self, hold_s: float) -> None:
        """Something stops the fish dead and lets it go after ``hold_s``."""

    def stir(self, by_m_s: float) -> None:
        """The water gets faster by that along the tank, within 0.3 s; it comes to rest again with
        a time constant of 8 s, and carries a fish that nobody holds."""

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Somebody puts the fish there, at rest; the next swim begins from there."""

    def swap_battery(self, volts: float, gain: float = 1.0, centre_rad: float = 0.0) -> None:
        """Power off, another pack, power on. The hull was open: from the next swim on thrust speed
        is ``gain`` times what it was, and the tail's centre is off by ``centre_rad`` more."""

    @property
    def flash(self) -> bytes:
        """The storage flash as it is now."""

    @flash.setter
    def flash(self, image: bytes) -> None: ...


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
    while isinstance(transport, BadLine):
        transport = transport.inner
    return transport if isinstance(transport, SimTransport) else None
