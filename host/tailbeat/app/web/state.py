"""What there is to see at one moment, and how what is told changes it. No web toolkit, no fish."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

from tailbeat.core.arrays import F64
from tailbeat.core.errors import TailbeatError, reason
from tailbeat.core.printable import printable
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.link.messages import BeatEvent, BoardStatus
from tailbeat.link.params import Parameter
from tailbeat.session.events import (
    Assessed,
    Countdown,
    Event,
    InputChosen,
    LinkLost,
    LinkRestored,
    LiveValues,
    StepBegun,
    StepEnded,
    StepProgress,
    TrialDiagnosed,
    TrialEnded,
    TrialStarted,
)
from tailbeat.session.guards import LENGTH_M, NOSE_M
from tailbeat.session.outcome import RecordedTrial
from tailbeat.session.presenter import input_text, log_line, result

Phase = Literal[
    "connecting", "idle", "working", "preflight", "countdown", "swimming", "deciding", "asking",
    "failed",
]  # fmt: skip
MOVING: tuple[Phase, ...] = ("preflight", "countdown", "swimming")
"""Phases in which the tail beats or is about to."""

STOPPED = ("ABORTED", "FAULT")
LOG_LINES = 200
_TRACK_POINTS = 400
_TRACK_STEP_M = 0.01  # 4 m in all: the path of a whole trial, with its sway

Point = tuple[float, float]


@dataclass(frozen=True)
class GuideStep:
    """A step of the guided job; ``done`` None: under way."""

    name: str
    words: str
    done: bool | None = None


@dataclass(frozen=True)
class TrialCurve:
    """Beat by beat, None = not measured, or not executed."""

    trial: int
    iteration: int
    reference_m_s: tuple[float, ...]
    speed_m_s: tuple[float | None, ...]
    amplitude_rad: tuple[float | None, ...]
    saturated: tuple[bool, ...]


@dataclass(frozen=True)
class PageState:
    """What the page shows. ``serial`` grows with every change. ``reference_m_s``, ``speed_m_s``,
    ``amplitude_rad``: of the trial under way or the last one, one per beat, None for what is not
    known. ``run``: the name of one without a reference, see TrialStarted. ``next_trial``,
    ``iteration``, ``travel``: of the trial that START begins. ``pending``: a trial that waits on
    the board. ``problem``: one line for a person, with what to do. ``failed``: which request ended
    with it, or which parameter. ``fault``: why the board stopped, likewise; empty = it has not.
    ``logged``: lines since the beginning, of which ``log`` holds the last. ``done``: how many
    wishes have been dealt with. ``guide``: of the guided job, ``law`` and ``diagnosis`` in words.
    ``track``: where the camera saw the fish, from the start of the trial, x ahead and y to the
    right; ``start_pose``: x, y and heading there, of the trial before until it is seen. ``walls``:
    corners of the water likewise, by the camera's calibration, empty = not known; ``end_walls_m``:
    where ``TANK_LEN_M`` has the walls behind and ahead of the start. ``room_m``: the tank
    clearance. ``curves``: of the trials in ``rows``, and ``made_by``: what made the input of each.
    ``params``: empty = not read yet. ``number``: that a question wants typed. ``reported``: whether
    the experiment has a report; ``pictures``: whether there is a camera's picture."""

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
    run: str = ""
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
    made_by: tuple[str, ...] = ()
    error_bound_m_s: float | None = None
    start_error_m_s: float | None = None
    assessment: str = ""
    problem: str = ""
    failed: str = ""
    fault: str = ""
    log: tuple[str, ...] = ()
    logged: int = 0
    done: int = 0
    guide: tuple[GuideStep, ...] = ()
    law: str = ""
    diagnosis: str = ""
    track: tuple[Point, ...] = ()
    start_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    walls: tuple[Point, ...] = ()
    end_walls_m: tuple[float, float] | None = None
    room_m: float | None = None
    curves: tuple[TrialCurve, ...] = ()
    params: tuple[Parameter, ...] = ()
    number: float | None = None
    reported: bool = False
    pictures: bool = False


def logged(now: PageState, text: str, clock: str) -> PageState:
    """One line more in the log, the oldest go."""
    line = f"{clock}  {printable(on_the_page(text))}"
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
        fault=on_the_page(f"{fault.meaning}. {fault.remedy}") if stopped else "",
    )


def by_beat(now: PageState, beat: BeatEvent) -> PageState:
    """A beat that has been executed, of a trial that somebody else may have started."""
    if beat.trial != now.trial:
        now = _cleared(now, beat.trial)
    return _with_beat(now, beat)


def after(now: PageState, event: Event, clock: str) -> PageState:
    """The snapshot after one event of a series."""
    now = _changed(now, event)
    text = log_line(replace(event, press="") if isinstance(event, StepBegun) else event)  # no keys
    return logged(now, text, clock) if text else now


_CUT = (
    "The link to the fish is broken; this program tries to get it back. ABORT does not reach the"
    " fish meanwhile: use the switch on it."
)


def _changed(now: PageState, event: Event) -> PageState:
    match event:
        case StepProgress():
            return _step(now, event)
        case Countdown(left_s):
            return replace(now, phase="countdown", left_s=left_s, step="hands out of the water")
        case LinkLost():
            return replace(now, problem=_CUT)
        case LinkRestored():
            return replace(now, problem="" if now.problem == _CUT else now.problem)
        case TrialEnded():
            return replace(now, steps=())  # of the checks before it
        case TrialStarted(trial, _, run):
            return replace(_cleared(now, trial, run), phase="swimming", step="", left_s=None)
        case BeatEvent():
            return _with_beat(now, event)
        case LiveValues():
            battery_v = now.battery_v if event.battery_v is None else event.battery_v
            return replace(now, beat=event.beat, battery_v=battery_v)
        case Assessed():
            return replace(now, assessment=on_the_page(_assessment(event)))
        case StepBegun(_, _, name, why, takes):
            return _guided(now, GuideStep(name, f"{why} ({takes})"))
        case StepEnded(name, done, words):
            return _guided(now, GuideStep(name, on_the_page(words), done))
        case InputChosen():
            return replace(now, law=on_the_page(input_text(event)))
        case TrialDiagnosed():
            return replace(now, diagnosis=on_the_page(result(event)))
    return now


def _guided(now: PageState, step: GuideStep) -> PageState:
    """Steps keep their places; one that begins ends the one before it."""
    before = now.guide
    if step.done is None:
        before = tuple(replace(one, done=one.done is not False) for one in before)
    names = [one.name for one in before]
    if step.name in names:
        at = names.index(step.name)
        return replace(now, guide=(*before[:at], step, *before[at + 1 :]))
    return replace(now, guide=(*before, step))


def by_place(now: PageState, place: Point, heading_rad: float = 0.0) -> PageState:
    """Where the camera sees the fish; what hardly differs is left out."""
    if not now.track:
        now = replace(now, start_pose=(*place, heading_rad))
    else:
        x_m, y_m = now.track[-1]
        if abs(place[0] - x_m) + abs(place[1] - y_m) < _TRACK_STEP_M:
            return now
    return replace(now, track=(*now.track[-_TRACK_POINTS + 1 :], place))


def end_walls_m(tank_m: float, fish_m: float) -> tuple[float, float] | None:
    """From the marker of a fish that starts with its tail at the wall behind it; None: the tank is
    not checked. As far along the fish as on one of LENGTH_M."""
    if tank_m <= 0:
        return None
    behind_m = (1 - NOSE_M / LENGTH_M) * fish_m
    return -behind_m, tank_m - behind_m


def corners(area_m: F64 | None) -> tuple[Point, ...]:
    """Of the water, as a calibration (n, 2) has them; none when it has none."""
    return () if area_m is None else tuple((float(x), float(y)) for x, y in area_m)


def _cleared(now: PageState, trial: int, run: str = "") -> PageState:
    reference = () if run else now.reference_m_s
    none = (None,) * len(reference)
    return replace(
        now, trial=trial, run=run, reference_m_s=reference, speed_m_s=none, amplitude_rad=none,
        recorded=None, track=(), diagnosis="",
    )  # fmt: skip


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
        if now.run:  # how many there will be it does not say
            old += (None,) * (beat.beat + 1 - len(old))
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
        words = on_the_page(str(error) if isinstance(error, TailbeatError) else reason(error))
        if words != self.now.problem:
            self.say(words)
        self.set(problem=words)

    def wait(self, until: Callable[[PageState], bool], patience_s: float = 10.0) -> PageState:
        """The first snapshot for which ``until`` holds. Raises TimeoutError."""
        with self._changed:
            if not self._changed.wait_for(lambda: until(self.now), patience_s):
                raise TimeoutError(f"still {self.now}")
            return self.now


def clock() -> str:
    """The time in the log."""
    return datetime.now().strftime("%H:%M:%S")


# Longer ones first. An option that no control has is a command of its own.
_CONTROLS = tuple(
    (re.compile(rf"'?\btailbeat {pattern}'?"), control)
    for pattern, control in (
        (r"session commission(?! --)", "START with 'Commissioning: again'"),
        (r"trial run(?: --until \w+)?(?! --)", "START"),
        (r"trial learn(?! --)", "START"),
        (r"trial discard --reason WHY", "START, then Discard"),
        (r"start(?! --)\b", "START"),
        (r"board clear", "'Clear the fault' on this page"),
        (r"(?:stop|board disarm)\b(?! --)", "ABORT"),
        (
            r"params (?:list|save|set(?: [A-Z_]+(?: [0-9]+(?:[.][0-9]+)?)?)?)"
            r"(?:,? tailbeat params save)?",
            "'Parameters' on this page",
        ),
        (
            r"reference upload(?: (?:thesis|trapezoid|cosine)[\w:.,]*\b| \S*\.csv)?"
            r"(?: --warm-start board)?",
            "'Change the reference' on this page",
        ),
        (r"report\b(?! --)", "'Write the report' on this page"),
    )
)
_NEEDS_BOARD = re.compile(
    r"tailbeat (session|params|trial|board|info|stop|start|reference upload|experiment new)\b"
)


def on_the_page(words: str) -> str:
    """A message that names a command of the terminal, in the words of the page: its own control
    where it has one, else that the command needs the port which the page holds."""
    words = words.replace("the same command", "START")
    for pattern, control in _CONTROLS:
        words = pattern.sub(control, words)
    if _NEEDS_BOARD.search(words) is None or _END in words:
        return words
    return f"{words.rstrip('.')}. {_END}"


_END = "End this page before that command: Ctrl-C where tailbeat session web runs."


def unexpected(error: Exception) -> str:
    """What to do about an error in this package."""
    return (
        f"something went wrong that should not ({type(error).__name__}: {error})."
        " Switch the fish off if its tail beats, start 'tailbeat session web' again and report "
        "this."
    )
