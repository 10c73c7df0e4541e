"""What the board says, as plain values. Units stand in the names; None = there is none.

The board's raw IMU frames, as they come, while somebody wants them.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from tailbeat.core.errors import TailbeatError
from tailbeat.core.faults import FaultInfo, ImuProblem, fault_info, problem_info
from tailbeat.core.imu_fields import error_words
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Link, Message, text_of
from tailbeat.link.timesync import BoardClock

T = TypeVar("T")

STATES = ("BOOT", "IDLE", "ARMED", "RUNNING", "SETTLING", "LEARNING", "ABORTED", "FAULT")
BOARD_KINDS = {1: "fish", 2: "simulated", 3: "emulated"}
SIMULATED_FISH = ("simulated", "emulated")  # kinds of boards with no real fish around them
IMU_STATES = ("searching", "configuring", "waiting", "streaming")
# Bits of imu_health, with what to do.
IMU_HEALTH = {
    0x001: ("damaged frames or lines", "Shorten or shield the line to the IMU; lower IMU_BAUD."),
    0x002: ("bytes that belong to no message", "Shorten or shield the line to the IMU."),
    0x004: ("missing frames", "Look whether bytes are damaged or lost, too."),
    0x008: ("bytes lost in the board's port", "Lower IMU_RATE_HZ."),
    0x010: ("a restart of the IMU", "Check its supply and plug."),
    0x020: ("frames with impossible values", "Switch it off and on; if it stays, it is broken."),
    0x100: ("no frames", ""),
    0x200: ("not set up", ""),
}
RESET_CAUSES = ("power", "backup", "watchdog", "software", "reset pin")

_BUILD = "tailbeat "
_MEASURED, _SATURATED, _PROVISIONAL = 1, 2, 4
_IMPROVED, _ROLLED_BACK = 1, 2


@dataclass(frozen=True)
class BoardStatus:
    """TAILBEAT_STATUS."""

    time_s: float
    state: str
    fault: FaultInfo
    trial: int | None
    next_trial: int
    pending_trial: int | None
    last_learned_trial: int | None
    reference_crc: int | None
    best_max_abs_error_m_s: float | None
    iteration: int
    best_iteration: int | None
    beats: int
    beat: int
    battery_v: float
    worse_streak: int
    battery_at_limit: bool = False

    @property
    def battery_text(self) -> str:
        """The voltage in words; a reading at the converter's limit is a lower bound only."""
        if self.battery_at_limit:
            return f"{self.battery_v:.2f} V or more (reading at its limit)"
        return f"{self.battery_v:.2f} V"

    @classmethod
    def of(cls, m: Message) -> BoardStatus:
        """From the message."""
        return _of(
            cls,
            m,
            time_s=m.time_boot_ms * 1e-3,
            state=_name(STATES, m.state),
            fault=fault_info(m.fault),
            trial=m.trial or None,
            pending_trial=m.pending_trial or None,
            last_learned_trial=m.last_learned_trial or None,
            reference_crc=m.reference_crc or None,
            best_max_abs_error_m_s=_number(m.best_max_abs_error_m_s),
            best_iteration=m.best_iteration or None,
            battery_v=m.battery_mv * 1e-3,
            battery_at_limit=bool(m.battery_at_limit),
        )


@dataclass(frozen=True)
class BoardInfo:
    """Who the board is. ``simulated``: there is no real fish around it."""

    build_id: str
    version: str
    board: str
    simulated: bool
    unique_id: str
    connection: str
    status: BoardStatus


@dataclass(frozen=True)
class BeatEvent:
    """One beat of a trial. ``provisional``: the trial still runs, the final speed comes later."""

    trial: int
    beat: int
    amplitude_rad: float
    reference_m_s: float
    speed_m_s: float | None
    sigma_m_s: float | None
    samples: int
    saturated: bool
    provisional: bool

    @classmethod
    def of(cls, m: Message) -> BeatEvent:
        """From TAILBEAT_BEAT."""
        measured = bool(m.flags & _MEASURED)
        return _of(
            cls,
            m,
            speed_m_s=_number(m.speed_m_s) if measured else None,
            sigma_m_s=_number(m.sigma_m_s) if measured else None,
            saturated=bool(m.flags & _SATURATED),
            provisional=bool(m.flags & _PROVISIONAL),
        )


@dataclass(frozen=True)
class LearnReport:
    """What the board learned from a trial; ``iteration`` is the one the trial swam."""

    trial: int
    iteration: int
    max_abs_error_m_s: float
    rms_error_m_s: float
    best_max_abs_error_m_s: float | None
    measured_beats: int
    saturated_beats: int
    improved: bool
    rolled_back: bool

    @classmethod
    def of(cls, m: Message) -> LearnReport:
        """From TAILBEAT_LEARN_REPORT."""
        return _of(
            cls,
            m,
            best_max_abs_error_m_s=_number(m.best_max_abs_error_m_s),
            improved=bool(m.flags & _IMPROVED),
            rolled_back=bool(m.flags & _ROLLED_BACK),
        )


@dataclass(frozen=True)
class TrialFile:
    """A trial's log on the board."""

    number: int
    path: str
    size_bytes: int


@dataclass(frozen=True)
class TrialOutcome:
    """How a trial went. ``end``: complete, aborted:REASON or fault:NAME.

    ``beats`` are the beats that came over the wire; on a bad link some may be missing, the trial's
    log has all. ``interrupted``: somebody pressed Ctrl-C.
    """

    number: int
    iteration: int
    end: str
    executed_beats: int
    beats: list[BeatEvent] = field(default_factory=list)
    interrupted: bool = False


@dataclass(frozen=True)
class ImuInfo:
    """TAILBEAT_IMU_INFO. ``error``: what the sensor complained of last, in words."""

    state: str
    problem: ImuProblem
    error: str | None
    model: str | None
    firmware: str | None
    baud: int | None
    rate_hz: int
    port: int | None

    @classmethod
    def of(cls, m: Message) -> ImuInfo:
        """From the message."""
        return _of(
            cls,
            m,
            state=_name(IMU_STATES, m.state),
            problem=problem_info(m.problem),
            error=error_words(m.error) if m.error else None,
            model=text_of(m.model) or None,
            firmware=text_of(m.firmware) or None,
            baud=m.baud or None,
            port=m.port or None,
        )


@dataclass(frozen=True)
class ImuFrame:
    """One frame of the fish's IMU, body axes; ``time_s`` by the board's clock. ``sequence`` counts
    all frames the board got since its boot."""

    sequence: int
    time_s: float
    accel_m_s2: tuple[float, ...]
    rate_rad_s: tuple[float, ...]
    ypr_deg: tuple[float, ...]


def imu_health(bits: int) -> list[tuple[str, str]]:
    """What is not as it should be, and what to do about it."""
    return [words for bit, words in IMU_HEALTH.items() if bits & bit]


def build_id_of(link: Link, version: Message, tries: int = 1) -> str:
    """The firmware's build: the board sends it as a line of text behind its AUTOPILOT_VERSION,
    whose own field cuts it."""
    for attempt in range(tries):
        if attempt:
            link.request("AUTOPILOT_VERSION")
        heard = link.recv(
            "STATUSTEXT", link.patient(0.5), lambda m: text_of(m.text).startswith(_BUILD)
        )
        if heard is not None:
            return text_of(heard.text).removeprefix(_BUILD)
    return text_of(bytes(version.flight_custom_version))


def health_dict(m: Message) -> dict[str, int | str]:
    """TAILBEAT_HEALTH with the reset cause as a word."""
    values: dict[str, int | str] = {name: getattr(m, name) for name in m.get_fieldnames()}
    values["reset_cause"] = _name(RESET_CAUSES, m.reset_cause)
    return values


def _of(made: type[T], m: Message, **values: Any) -> T:
    """A dataclass from a message: ``values``, and the message's fields of the same names."""
    same = {f.name for f in fields(made)} - set(values)  # type: ignore[arg-type]
    return made(**values, **{name: getattr(m, name) for name in same})


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _name(names: tuple[str, ...], index: int) -> str:
    return names[index] if 0 <= index < len(names) else str(index)


Event = dict[str, Any]


def status_event(status: BoardStatus) -> Event:
    """A status as one event; the fault as number and name."""
    event: Event = {"event": "status", **vars(status)}
    event["fault"] = status.fault.number
    event["fault_name"] = status.fault.name
    return event


def beat_event(beat: BeatEvent) -> Event:
    """A settled beat as one event."""
    return {"event": "beat", **vars(beat)}


def live_event(m: Message) -> Event:
    """TAILBEAT_LIVE as one event; None where there is no value."""
    values = {name: getattr(m, name) for name in m.get_fieldnames() if name != "time_boot_ms"}
    values = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
    return {"event": "live", "time_s": m.time_boot_ms * 1e-3, **values}


def text_event(m: Message) -> Event:
    """A line of text as one event."""
    return {"event": "text", "severity": m.severity, "text": text_of(m.text)}


WATCHED: dict[str, Callable[[Message], Event]] = {
    "TAILBEAT_STATUS": lambda m: status_event(BoardStatus.of(m)),
    "TAILBEAT_BEAT": lambda m: beat_event(BeatEvent.of(m)),
    "TAILBEAT_LIVE": live_event,
    "TAILBEAT_HEALTH": lambda m: {"event": "health", **health_dict(m)},
    "TAILBEAT_LEARN_REPORT": lambda m: {"event": "learned", **vars(LearnReport.of(m))},
    "STATUSTEXT": text_event,
}


_ALL_FRAMES = 0.0
_OFF = -1.0
_WAIT_S = 0.5
_ASK_AGAIN_S = 2.0  # the board ends the stream when it has heard no host for a while
_US_WRAP = 1 << 32
_AXES = 3


def imu_frames(link: Link, clock: BoardClock, duration_s: float) -> Generator[ImuFrame, None, None]:
    """Every frame the board gets for so long, of board time; gaps show in ``sequence``."""
    wait_s = link.patient(_WAIT_S)
    now_s = link.transport.now_s()
    end_s = now_s + duration_s / clock.rate
    ask_s = now_s
    try:
        while (now_s := link.transport.now_s()) < end_s:
            if now_s >= ask_s:
                _want(link, _ALL_FRAMES)
                ask_s = link.transport.now_s() + link.patient(_ASK_AGAIN_S)
            message = link.recv("TAILBEAT_IMU", min(wait_s, end_s - now_s))
            clock.keep()
            if message is not None:
                ask_s = link.transport.now_s() + link.patient(_ASK_AGAIN_S)
                yield from _frames(message, clock.now_s())
    finally:
        with contextlib.suppress(TailbeatError):
            _want(link, _OFF)


def _want(link: Link, interval_us: float) -> None:
    number = float(mavlink.MAVLINK_MSG_ID_TAILBEAT_IMU)
    link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us)


def _frames(m: Message, board_s: float) -> Iterator[ImuFrame]:
    for i in range(min(m.count, len(m.time_us))):
        axes = slice(_AXES * i, _AXES * (i + 1))
        yield ImuFrame(
            sequence=m.sequence + i,
            time_s=unwrapped_s(m.time_us[i], board_s),
            accel_m_s2=tuple(m.accel_m_s2[axes]),
            rate_rad_s=tuple(m.rate_rad_s[axes]),
            ypr_deg=tuple(m.ypr_deg[axes]),
        )


def unwrapped_s(low_us: int, board_s: float) -> float:
    """The board time nearest to ``board_s`` whose low 32 bits, in microseconds, are ``low_us``."""
    wraps = round((board_s * 1e6 - low_us) / _US_WRAP)
    return (low_us + max(wraps, 0) * _US_WRAP) * 1e-6
