"""What the board says, as plain values. Units stand in the names; None = there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.faults import FaultInfo, fault_info
from tailbeat.link import Message

STATES = ("BOOT", "IDLE", "ARMED", "RUNNING", "SETTLING", "LEARNING", "ABORTED", "FAULT")
BOARD_KINDS = {1: "fish", 2: "simulated", 3: "emulated"}
SIMULATED_FISH = ("simulated", "emulated")  # kinds of boards with no real fish around them
RESET_CAUSES = ("power", "backup", "watchdog", "software", "reset pin")

_MEASURED, _SATURATED = 1, 2
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

    @classmethod
    def of(cls, m: Message) -> BoardStatus:
        """From the message."""
        return cls(
            time_s=m.time_boot_ms * 1e-3,
            state=_name(STATES, m.state),
            fault=fault_info(m.fault),
            trial=m.trial or None,
            next_trial=m.next_trial,
            pending_trial=m.pending_trial or None,
            last_learned_trial=m.last_learned_trial or None,
            reference_crc=m.reference_crc or None,
            best_max_abs_error_m_s=_number(m.best_max_abs_error_m_s),
            iteration=m.iteration,
            best_iteration=m.best_iteration or None,
            beats=m.beats,
            beat=m.beat,
            battery_v=m.battery_mv * 1e-3,
            worse_streak=m.worse_streak,
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
    """One beat of a trial, once its speed has settled."""

    trial: int
    beat: int
    amplitude_rad: float
    reference_m_s: float
    speed_m_s: float | None
    sigma_m_s: float | None
    samples: int
    saturated: bool

    @classmethod
    def of(cls, m: Message) -> BeatEvent:
        """From TAILBEAT_BEAT."""
        measured = bool(m.flags & _MEASURED)
        return cls(
            trial=m.trial,
            beat=m.beat,
            amplitude_rad=m.amplitude_rad,
            reference_m_s=m.reference_m_s,
            speed_m_s=_number(m.speed_m_s) if measured else None,
            sigma_m_s=_number(m.sigma_m_s) if measured else None,
            samples=m.samples,
            saturated=bool(m.flags & _SATURATED),
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
        return cls(
            trial=m.trial,
            iteration=m.iteration,
            max_abs_error_m_s=m.max_abs_error_m_s,
            rms_error_m_s=m.rms_error_m_s,
            best_max_abs_error_m_s=_number(m.best_max_abs_error_m_s),
            measured_beats=m.measured_beats,
            saturated_beats=m.saturated_beats,
            improved=bool(m.flags & _IMPROVED),
            rolled_back=bool(m.flags & _ROLLED_BACK),
        )


@dataclass(frozen=True)
class Amplitudes:
    """The stored (unsaturated) amplitudes that swim next. ``values``: float32, (beats,), rad."""

    iteration: int
    beats: int
    reference_crc: int
    values: NDArray[np.float32]


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


def health_dict(m: Message) -> dict[str, int | str]:
    """TAILBEAT_HEALTH with the reset cause as a word."""
    values: dict[str, int | str] = {name: getattr(m, name) for name in m.get_fieldnames()}
    values["reset_cause"] = _name(RESET_CAUSES, m.reset_cause)
    return values


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _name(names: tuple[str, ...], index: int) -> str:
    return names[index] if 0 <= index < len(names) else str(index)
