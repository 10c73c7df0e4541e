"""What there is to see at one moment, and how what is told changes it. No web toolkit, no fish."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from tailbeat.core.printable import printable
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import (
    Assessed,
    Countdown,
    Event,
    LiveValues,
    StepProgress,
    TrialStarted,
)
from tailbeat.session.presenter import log_line

if TYPE_CHECKING:
    from tailbeat.experiment.analysis import TrialRow
    from tailbeat.link.messages import BoardStatus
    from tailbeat.session.collect import Swum

Phase = Literal[
    "connecting", "idle", "working", "ritual", "countdown", "swimming", "deciding", "asking",
    "failed",
]  # fmt: skip
MOVING: tuple[Phase, ...] = ("ritual", "countdown", "swimming")
"""Phases in which the tail beats or is about to."""

STOPPED = ("ABORTED", "FAULT")
LOG_LINES = 200


@dataclass(frozen=True)
class Snapshot:
    """What the page shows. ``serial`` grows with every change. ``reference_m_s``, ``speed_m_s``,
    ``amplitude_rad``: of the swim under way or the last one, one per beat, None for what is not
    known. ``next_trial``, ``iteration``, ``travel``: of the swim that START begins. ``pending``: a
    trial that waits on the board. ``problem``: one line for a person, with what to do. ``fault``:
    why the board stopped, likewise; empty = it has not. ``logged``: lines since the beginning, of
    which ``log`` holds the last. ``done``: how many wishes have been dealt with."""

    serial: int = 0
    phase: Phase = "connecting"
    connection: str = ""
    simulated: bool = False
    board: str = ""
    unique_id: str = ""
    state: str = ""
    battery_v: float | None = None
    battery_low_v: float = 0.0
    imu: str = ""
    imu_well: bool | None = None
    experiment: str = ""
    iteration: int = 0
    next_trial: int | None = None
    pending: int | None = None
    travel: str = ""
    trial: int | None = None
    beat_s: float = 1.0
    beat: int | None = None
    step: str = ""
    steps: tuple[StepProgress, ...] = ()
    left_s: float | None = None
    amplitude_max_rad: float | None = None
    reference_m_s: tuple[float, ...] = ()
    speed_m_s: tuple[float | None, ...] = ()
    amplitude_rad: tuple[float | None, ...] = ()
    swum: Swum | None = None
    question: str = ""
    rows: tuple[TrialRow, ...] = ()
    floor_m_s: float | None = None
    start_error_m_s: float | None = None
    verdict: str = ""
    problem: str = ""
    fault: str = ""
    log: tuple[str, ...] = ()
    logged: int = 0
    done: int = 0


def logged(now: Snapshot, text: str, clock: str) -> Snapshot:
    """One line more in the log, the oldest go."""
    line = f"{clock}  {printable(text)}"
    return replace(now, log=(*now.log[-LOG_LINES + 1 :], line), logged=now.logged + 1)


def by_status(now: Snapshot, status: BoardStatus) -> Snapshot:
    """What the board says of itself once a second."""
    stopped = status.state in STOPPED and status.fault.number != 0
    fault = status.fault
    swims = status.state in ("RUNNING", "SETTLING")
    return replace(
        now,
        state=status.state,
        battery_v=None if status.battery_at_limit else status.battery_v,
        iteration=status.iteration,
        next_trial=status.next_trial,
        pending=status.pending_trial,
        beat=status.beat if swims else None,
        fault=f"{fault.meaning}. {fault.remedy}" if stopped else "",
    )


def by_beat(now: Snapshot, beat: BeatEvent) -> Snapshot:
    """A beat that has been swum, of a swim that somebody else may have started."""
    if beat.trial != now.trial:
        now = _cleared(now, beat.trial)
    return _with_beat(now, beat)


def after(now: Snapshot, event: Event, clock: str) -> Snapshot:
    """The snapshot after one event of a series."""
    now = _changed(now, event)
    text = log_line(event)
    return logged(now, text, clock) if text else now


def _changed(now: Snapshot, event: Event) -> Snapshot:
    match event:
        case StepProgress():
            return _step(now, event)
        case Countdown(left_s):
            return replace(now, phase="countdown", left_s=left_s, step="hands out of the water")
        case TrialStarted(trial):
            return replace(_cleared(now, trial), phase="swimming", step="", left_s=None)
        case BeatEvent():
            return _with_beat(now, event)
        case LiveValues():
            battery_v = now.battery_v if event.battery_v is None else event.battery_v
            return replace(now, beat=event.beat, battery_v=battery_v)
        case Assessed():
            return replace(now, verdict=_assessment(event))
    return now


def _cleared(now: Snapshot, trial: int) -> Snapshot:
    none = (None,) * len(now.reference_m_s)
    return replace(now, trial=trial, speed_m_s=none, amplitude_rad=none, swum=None)


def _step(now: Snapshot, event: StepProgress) -> Snapshot:
    others = [s for s in now.steps if s.step != event.step]
    at = next((i for i, s in enumerate(now.steps) if s.step == event.step), len(others))
    steps = (*others[:at], event, *others[at:])
    return replace(now, phase="ritual", step=event.text, left_s=event.left_s, steps=steps)


def _with_beat(now: Snapshot, beat: BeatEvent) -> Snapshot:
    changes: dict[str, Any] = {}
    for name in ("speed_m_s", "amplitude_rad"):
        old: tuple[float | None, ...] = getattr(now, name)
        value = getattr(beat, name)
        if 0 <= beat.beat < len(old) and value is not None:
            changes[name] = (*old[: beat.beat], value, *old[beat.beat + 1 :])
    return replace(now, **changes)


def _assessment(event: Assessed) -> str:
    if event.stop:
        return f"{event.words} Stop: {event.stop_reason}. {event.advice}"
    return f"{event.words} {event.saturation}" if event.saturation else event.words
