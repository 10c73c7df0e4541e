"""What there is to see at one moment, and how what is told changes it. No web toolkit, no fish."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from tailbeat.core.printable import printable

if TYPE_CHECKING:
    from tailbeat.experiment.analysis import TrialRow
    from tailbeat.link.messages import BeatEvent, BoardStatus
    from tailbeat.session.collect import Swum
    from tailbeat.session.operator import Event

Phase = Literal[
    "connecting", "idle", "working", "ritual", "countdown", "swimming", "deciding", "asking",
    "failed",
]  # fmt: skip
MOVING: tuple[Phase, ...] = ("ritual", "countdown", "swimming")
"""Phases in which the tail beats or is about to."""

STOPPED = ("ABORTED", "FAULT")
LOG_LINES = 200
_WARNING = 4  # MAV_SEVERITY_WARNING; lower is worse

_NEWS = {
    "link_lost": "the link broke; trying to get it back (without it the fish stops by itself)",
    "link_back": "the link is back",
    "interrupted": "stopping",
}


@dataclass(frozen=True)
class Step:
    """One step of the ritual. ``ok`` None = under way; ``left_s`` None = unknown."""

    name: str
    text: str
    ok: bool | None
    left_s: float | None


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
    steps: tuple[Step, ...] = ()
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
    values = {"speed_m_s": beat.speed_m_s, "amplitude_rad": beat.amplitude_rad}
    return _with_beat(now, beat.beat, values)


def after(now: Snapshot, event: Event, clock: str) -> Snapshot:
    """The snapshot after one event of a series, see person.Event."""
    kind = str(event["event"])
    change = _CHANGES.get(kind)
    if change is not None:
        now = change(now, event)
    text = _words(kind, event)
    return logged(now, text, clock) if text else now


def _cleared(now: Snapshot, trial: int) -> Snapshot:
    none = (None,) * len(now.reference_m_s)
    return replace(now, trial=trial, speed_m_s=none, amplitude_rad=none, swum=None)


def _step(now: Snapshot, event: Event) -> Snapshot:
    step = Step(str(event["step"]), str(event["text"]), event.get("ok"), event.get("left_s"))
    others = [s for s in now.steps if s.name != step.name]
    at = next((i for i, s in enumerate(now.steps) if s.name == step.name), len(others))
    steps = (*others[:at], step, *others[at:])
    return replace(now, phase="ritual", step=step.text, left_s=step.left_s, steps=steps)


def _countdown(now: Snapshot, event: Event) -> Snapshot:
    return replace(now, phase="countdown", left_s=event["left_s"], step="hands out of the water")


def _started(now: Snapshot, event: Event) -> Snapshot:
    now = _cleared(now, int(event["trial"]))
    return replace(now, phase="swimming", step="", left_s=None)


def _beat(now: Snapshot, event: Event) -> Snapshot:
    values = {name: event.get(name) for name in ("speed_m_s", "amplitude_rad")}
    return _with_beat(now, int(event["beat"]), values)


def _with_beat(now: Snapshot, beat: int, values: dict[str, float | None]) -> Snapshot:
    changes: dict[str, Any] = {}
    for name, value in values.items():
        old: tuple[float | None, ...] = getattr(now, name)
        if 0 <= beat < len(old) and value is not None:
            changes[name] = (*old[:beat], value, *old[beat + 1 :])
    return replace(now, **changes)


def _live(now: Snapshot, event: Event) -> Snapshot:
    battery_v = event.get("battery_v")
    return replace(
        now,
        beat=event.get("beat", now.beat),
        battery_v=now.battery_v if battery_v is None else battery_v,
    )


def _verdict(now: Snapshot, event: Event) -> Snapshot:
    words = str(event["words"])
    if event.get("stop"):
        words = f"{words} Stop: {event['stop_reason']}. {event['advice']}"
    elif event.get("saturation"):
        words = f"{words} {event['saturation']}"
    return replace(now, verdict=words)


_CHANGES: dict[str, Callable[[Snapshot, Any], Snapshot]] = {
    "step": _step,
    "countdown": _countdown,
    "started": _started,
    "beat": _beat,
    "live": _live,
    "verdict": _verdict,
}


def _words(kind: str, event: Event) -> str:
    """The line in the log; empty = none."""
    if kind in _NEWS:
        return _NEWS[kind]
    if kind in ("notice", "warning", "hold"):
        return str(event["text"])
    if kind == "text":
        return str(event["text"]) if event["severity"] <= _WARNING else ""
    if kind == "step":
        return f"{event['step']}: {event['text']}" if event.get("ok") is not None else ""
    words = _SAID.get(kind)
    return words(event) if words else ""


def _learned(event: Event) -> str:
    back = "; the best amplitudes so far swim again (it was much worse twice)"
    return f"learned from trial {event['trial']}" + (back if event.get("rolled_back") else "")


def _decided(event: Event) -> str:
    why = f" ({event['reason']})" if event.get("reason") else ""
    return f"trial {event['trial']}: {event['decision']}{why}"


_SAID: dict[str, Callable[[Event], str]] = {
    "started": lambda e: f"trial {e['trial']} swims, iteration {e['iteration']}",
    "ended": lambda e: f"trial {e['trial']} has ended: {e['end']}",
    "guard": lambda e: f"stopped: {e['reason']}",
    "decided": _decided,
    "learned": _learned,
    "verdict": lambda e: str(e["words"]),
}
