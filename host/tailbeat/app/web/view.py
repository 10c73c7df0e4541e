"""What there is to see at one moment, and how what is told changes it. No web toolkit, no fish.

How things are put on the page: short words, numbers with their units.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

from tailbeat.core.errors import TailbeatError, reason
from tailbeat.core.printable import mm, printable
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.link.messages import BeatEvent, BoardStatus
from tailbeat.session.events import (
    Assessed,
    Countdown,
    Event,
    LiveValues,
    StepProgress,
    TrialStarted,
)
from tailbeat.session.outcome import RecordedTrial, Travel
from tailbeat.session.presenter import log_line

Phase = Literal[
    "connecting", "idle", "working", "preflight", "countdown", "swimming", "deciding", "asking",
    "failed",
]  # fmt: skip
MOVING: tuple[Phase, ...] = ("preflight", "countdown", "swimming")
"""Phases in which the tail beats or is about to."""

STOPPED = ("ABORTED", "FAULT")
LOG_LINES = 200


@dataclass(frozen=True)
class PageState:
    """What the page shows. ``serial`` grows with every change. ``reference_m_s``, ``speed_m_s``,
    ``amplitude_rad``: of the trial under way or the last one, one per beat, None for what is not
    known. ``next_trial``, ``iteration``, ``travel``: of the trial that START begins. ``pending``: a
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
    recorded: RecordedTrial | None = None
    question: str = ""
    rows: tuple[TrialRow, ...] = ()
    error_bound_m_s: float | None = None
    start_error_m_s: float | None = None
    assessment: str = ""
    problem: str = ""
    fault: str = ""
    log: tuple[str, ...] = ()
    logged: int = 0
    done: int = 0


def logged(now: PageState, text: str, clock: str) -> PageState:
    """One line more in the log, the oldest go."""
    line = f"{clock}  {printable(text)}"
    return replace(now, log=(*now.log[-LOG_LINES + 1 :], line), logged=now.logged + 1)


def by_status(now: PageState, status: BoardStatus) -> PageState:
    """What the board says of itself once a second."""
    stopped = status.state in STOPPED and status.fault.number != 0
    fault = status.fault
    is_under_way = status.state in ("RUNNING", "SETTLING")
    return replace(
        now,
        state=status.state,
        battery_v=None if status.battery_at_limit else status.battery_v,
        iteration=status.iteration,
        next_trial=status.next_trial,
        pending=status.pending_trial,
        beat=status.beat if is_under_way else None,
        fault=f"{fault.meaning}. {fault.remedy}" if stopped else "",
    )


def by_beat(now: PageState, beat: BeatEvent) -> PageState:
    """A beat that has been executed, of a trial that somebody else may have started."""
    if beat.trial != now.trial:
        now = _cleared(now, beat.trial)
    return _with_beat(now, beat)


def after(now: PageState, event: Event, clock: str) -> PageState:
    """The snapshot after one event of a series."""
    now = _changed(now, event)
    text = log_line(event)
    return logged(now, text, clock) if text else now


def _changed(now: PageState, event: Event) -> PageState:
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
            return replace(now, assessment=_assessment(event))
    return now


def _cleared(now: PageState, trial: int) -> PageState:
    none = (None,) * len(now.reference_m_s)
    return replace(now, trial=trial, speed_m_s=none, amplitude_rad=none, recorded=None)


def _step(now: PageState, event: StepProgress) -> PageState:
    others = [s for s in now.steps if s.step != event.step]
    at = next((i for i, s in enumerate(now.steps) if s.step == event.step), len(others))
    steps = (*others[:at], event, *others[at:])
    return replace(now, phase="preflight", step=event.text, left_s=event.left_s, steps=steps)


def _with_beat(now: PageState, beat: BeatEvent) -> PageState:
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


class Screen:
    """The snapshot that is shown. Any thread may look; only the worker's changes it, so that
    snapshots do not overtake each other."""

    def __init__(self) -> None:
        self.now = PageState()
        self._changed = threading.Condition()

    def show(self, snapshot: PageState) -> None:
        """From now on."""
        with self._changed:
            self.now = replace(snapshot, serial=self.now.serial + 1)
            self._changed.notify_all()

    def set(self, **changes: Any) -> None:
        """Likewise; the rest stays."""
        self.show(replace(self.now, **changes))

    def say(self, text: str) -> None:
        """One line more in the log."""
        self.show(logged(self.now, text, clock()))

    def trouble(self, error: Exception) -> None:
        """What is wrong, with what to do."""
        words = str(error) if isinstance(error, TailbeatError) else reason(error)
        is_new = (words := from_the_page(words)) != self.now.problem
        self.set(problem=words)
        if is_new:
            self.say(words)

    def wait(self, until: Callable[[PageState], bool], patience_s: float = 10.0) -> PageState:
        """The first snapshot for which ``until`` holds. Raises TimeoutError."""
        with self._changed:
            if not self._changed.wait_for(lambda: until(self.now), patience_s):
                raise TimeoutError(f"still {self.now}")
            return self.now


def clock() -> str:
    """The time in the log."""
    return datetime.now().strftime("%H:%M:%S")


def from_the_page(words: str) -> str:
    """Commands need the port that the page holds."""
    if "tailbeat session" not in words and "tailbeat params" not in words:
        return words
    return f"{words.rstrip('.')}. End this page first: Ctrl-C where tailbeat session web runs."


def unexpected(error: Exception) -> str:
    """What to do about an error in this package."""
    return (
        f"something went wrong that should not ({type(error).__name__}: {error})."
        " Switch the fish off if its tail beats, start 'tailbeat session web' again and report "
        "this."
    )


SILENT_S = 3.0
_BATTERY_MARGIN_V = 0.3  # above BATT_LOW_V: one more trial, then the next battery

STATES = {
    "BOOT": "starting",
    "IDLE": "at rest",
    "ARMED": "armed: the tail may start",
    "RUNNING": "swimming",
    "SETTLING": "executed, sorting out the last beats",
    "LEARNING": "learning",
    "ABORTED": "stopped on request",
    "FAULT": "stopped by a fault",
}
PHASES = {
    "connecting": "Connecting",
    "idle": "Ready",
    "working": "Working",
    "preflight": "Getting ready",
    "countdown": "Hands out of the water",
    "swimming": "Swimming",
    "deciding": "Your decision",
    "asking": "A question",
    "failed": "Failed",
}
DECISIONS = {
    "keep": ("Keep", "the fish learns from it"),
    "repeat": ("Repeat", "counts as a repeat, nothing is learned, the same swims again"),
    "discard": ("Discard", "counts for nothing, the same swims again"),
}


def phase_line(now: PageState) -> str:
    """What is going on, as a headline."""
    if now.phase == "swimming" and now.reference_m_s:
        beat = "" if now.beat is None else f": beat {min(now.beat + 1, len(now.reference_m_s))}"
        return f"Swimming{beat} of {len(now.reference_m_s)}" if beat else "Swimming"
    if now.phase == "countdown" and now.left_s is not None:
        return f"Hands out of the water: {now.left_s:.0f}"
    if now.phase == "deciding" and now.recorded is not None:
        return f"What becomes of trial {now.recorded.outcome.number}?"
    if now.phase == "idle" and now.fault:
        return "Stopped"
    return PHASES[now.phase]


def steps_shown(now: PageState) -> tuple[StepProgress, ...]:
    """The preflight checks, while they are under way."""
    return now.steps if now.phase in ("preflight", "countdown") else ()


def live_line(now: PageState) -> str:
    """The last beat that is known, while it swims."""
    beat = max((k for k, v in enumerate(now.speed_m_s) if v is not None), default=None)
    if now.phase != "swimming" or beat is None:
        return ""
    line = f"{mm(now.speed_m_s[beat])} mm/s, reference {mm(now.reference_m_s[beat])}"
    amplitude = now.amplitude_rad[beat]
    return line if amplitude is None else f"{line}; tail ±{math.degrees(amplitude):.0f}°"


def travel_line(travel: Travel) -> str:
    """How far it will come."""
    room = f" of {travel.room_m:.2f} m" if math.isfinite(travel.room_m) else ""
    words = f"it will come about {travel.expected_m:.2f} m{room}, at worst {travel.worst_m:.2f} m"
    return words if travel.fits else f"NO ROOM: {words}"


def where_line(now: PageState) -> str:
    """Which board, and what it does."""
    kinds = {"fish": "fish", "simulated": "simulated fish", "emulated": "emulated board"}
    if not now.connection:
        return "no fish yet"
    where = f"{kinds.get(now.board, now.board)} on {now.connection}"
    state = STATES.get(now.state, now.state)
    return f"{where}: {state}" if state else where


def next_line(now: PageState) -> str:
    """What START will do."""
    if now.pending is not None and now.phase == "idle":
        return f"Trial {now.pending} waits: START asks what becomes of it first."
    if not now.reference_m_s:
        return "The board has no reference yet: give it one below, then swim."
    line = f"START: trial {now.next_trial}, iteration {max(now.iteration, 1)}"
    if now.phase not in ("idle", "connecting"):
        return ""
    return f"{line}; {now.travel}" if now.travel else line


def battery(now: PageState) -> tuple[str, str]:
    """Text and look: ``well``, ``low`` or ``unknown``."""
    if now.battery_v is None or now.battery_v <= 0:
        return "battery ?", "unknown"
    low = now.battery_v < now.battery_low_v + _BATTERY_MARGIN_V
    return f"battery {now.battery_v:.1f} V" + (" LOW" if low else ""), "low" if low else "well"


def imu(now: PageState) -> tuple[str, str]:
    """Likewise; ``IMU`` is the motion sensor in the fish."""
    if now.imu_well is None:
        return "motion sensor ?", "unknown"
    return ("motion sensor ok", "well") if now.imu_well else ("motion sensor: look", "low")


def link(now: PageState, silent_s: float | None) -> tuple[str, str]:
    """Likewise, of the radio."""
    if now.phase == "connecting":
        return "not connected", "low"
    if silent_s is None:
        return "link ?", "unknown"
    if silent_s < SILENT_S:
        return f"link {max(silent_s, 0.0):.1f} s", "well"
    return f"silent for {silent_s:.0f} s", "low"


def chips(now: PageState, silent_s: float | None) -> tuple[tuple[str, str], ...]:
    """Link, battery and motion sensor; the last two are not well because they once were."""
    of_board = (battery(now), imu(now))
    if is_stale(now, silent_s):
        of_board = (of_board[0][0], "unknown"), (of_board[1][0], "unknown")
    return link(now, silent_s), *of_board


def is_stale(now: PageState, silent_s: float | None) -> bool:
    """Whether what is shown of the board may be wrong by now."""
    return now.phase == "connecting" or silent_s is None or silent_s >= SILENT_S


def straight(row: TrialRow) -> str:
    """Whether it swam straight; empty = not known."""
    found = row.straight
    if found is None:
        return ""
    off_deg = math.degrees(found.worst_yaw_rad)
    return f"crooked, {off_deg:+.0f}°" if found.crooked else "straight"


def row_line(row: TrialRow) -> str:
    """What became of a trial, in words."""
    decision = {"keep": "kept", "repeat": "repeated", "discard": "discarded"}.get(
        row.decision, "not decided"
    )
    parts = [decision + (f": {row.reason}" if row.reason else "")]
    if row.end != "complete":
        parts.append(row.end.replace(":", ": ").lower())
    if row.rolled_back:
        parts.append("rolled back")
    return "; ".join(parts)
