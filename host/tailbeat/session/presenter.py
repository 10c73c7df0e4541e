"""The words for the events of a session, for the terminal and the page alike."""

from __future__ import annotations

import math

from tailbeat.core.printable import mm
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.link.messages import LearnReport
from tailbeat.session.events import (
    Assessed,
    BoardText,
    Countdown,
    Event,
    HoldRequest,
    InputChosen,
    InterruptRequested,
    LinkLost,
    LinkRestored,
    LiveValues,
    Notice,
    StepBegun,
    StepEnded,
    StepProgress,
    TrialDecided,
    TrialDiagnosed,
    TrialEnded,
    TrialStarted,
    TrialStopped,
    TrialWarning,
)
from tailbeat.session.outcome import RecordedTrial, StopKind, StopReason

SEVERITY_WARNING = 4  # MAV_SEVERITY_WARNING; lower is worse
_MARKS = {True: "ok", False: "no", None: ".."}
_DECIDED = {
    "keep": "kept",
    "repeat": "counts as a repeat, nothing is learned; the same input is next",
    "discard": "discarded, does not count; the same input is next",
}


_SILENT_S = 1.5  # of board time: it says something every second
_SHORTER = (  # the first first
    "amplitude", "speed", "beat", "amplitude", "battery", "link", "speed", "speed"
)  # fmt: skip


def alert(event: Event) -> str:
    """What must be told whatever else is kept quiet; empty for everything else."""
    match event:
        case LinkLost():
            return "the link broke; trying to get it back (without it the board stops by itself)"
        case LinkRestored(state):
            trials = state == "RUNNING"
            then = "the trial continues" if trials else "the board has stopped the tail meanwhile"
            return f"the link is back; {then}"
        case InterruptRequested():
            return "Ctrl-C: the tail is being stopped"
        case Notice(text) | TrialWarning(text) | HoldRequest(text):
            return text
        case BoardText(severity, text):
            return text if severity <= SEVERITY_WARNING else ""
        case TrialStopped(StopReason(StopKind.OPERATOR, text)):
            return text
        case TrialStopped(reason):
            return f"stopped: {reason}"
    return ""


def result(event: Event) -> str:
    """What a trial came to; empty for everything else."""
    match event:
        case TrialDecided(trial, decision):
            reason = f" ({decision.reason})" if decision.reason else ""
            return f"trial {trial}: {_DECIDED[decision.kind]}{reason}"
        case LearnReport():
            best = ", the best so far" if event.improved else ""
            return (
                f"learned from trial {event.trial}: max|e| {mm(event.max_abs_error_m_s)} mm/s,"
                f" RMS {mm(event.rms_error_m_s)}{best}"
            )
        case InputChosen():
            return input_text(event)
        case StepBegun(number, of, name, why, takes, press):
            return f"{number}/{of} {name}: {why} ({'; '.join(filter(None, (takes, press)))})"
        case StepEnded(name, done, words):
            return f"{_MARKS[done]:>2}  {name}: {words}"
        case Assessed():
            return event.words
        case TrialDiagnosed(trial, causes) if causes:
            return f"trial {trial}, what holds it back: {causes[0].text}. {causes[0].proposal}"
    return ""


LAWS = {
    "p": "by the P law on the board",
    "model": "model-based, planned on this computer",
    "best": "the best one so far, once more",
}


def input_text(event: InputChosen) -> str:
    """Which law makes the next input and why, with what it is predicted to do."""
    if event.expected_m_s is None:
        return f"next input: {LAWS[event.law]} ({event.why})"
    low, median, high = map(mm, event.expected_m_s)
    return (
        f"next input: {LAWS[event.law]} ({event.why}); predicted max|e| {median} mm/s"
        f" ({low} to {high})"
    )


def log_line(event: Event) -> str:
    """The line in a log of a session; empty: none."""
    match event:
        case StepProgress(step, text, ok):
            return "" if ok is None else f"{step}: {text}"
        case TrialStarted(trial, iteration, run):
            return f"trial {trial} runs, {run or f'iteration {iteration}'}"
        case TrialEnded(trial, end):
            return f"trial {trial} has ended: {end}"
    return alert(event) or result(event)


def step_text(event: StepProgress) -> str:
    """One preflight step."""
    left = f" ({event.left_s} s)" if event.left_s and event.ok is None else ""
    return f"{_MARKS[event.ok]:>2}  {event.step}: {event.text}{left}"


def countdown_text(event: Countdown) -> str:
    """Hands out of the water."""
    left_s = event.left_s
    return f"it swims in {left_s} s: hands out (any key stops)" if left_s > 0 else "it swims"


def live_text(event: LiveValues, keys: bool, width: int) -> str:
    """The line while it swims, in ``width`` columns: of what has no room the least needed is
    shortened, or goes, first. What it is, how to stop it and the link stay."""
    parts = _live_parts(event)
    fixed = ["simulated"] if event.simulated else []
    fixed += ["any key stops"] if keys else []
    used = dict.fromkeys(parts, 0)

    def line() -> str:
        chosen = [forms[used[name]] for name, forms in parts.items()]
        return "  ".join(part for part in (*fixed, *chosen) if part)

    for name in _SHORTER:
        if len(line()) <= width:
            break
        used[name] = min(used[name] + 1, len(parts[name]) - 1)
    return line()


def _live_parts(event: LiveValues) -> dict[str, tuple[str, ...]]:
    """In order on the line, each from its long form to its short one."""
    at, of = event.beat, event.beats
    beat = (f"beat {at + 1}/{of}", f"{at + 1}/{of}") if at is not None and of else ("starting",)
    speed, reference = mm(event.speed_m_s), mm(event.reference_m_s)
    silent_s, volts, angle_rad = event.silent_s, event.battery_v, event.amplitude_rad
    silent = silent_s is not None and silent_s > _SILENT_S
    late = (f"link silent {silent_s:.0f} s", f"silent {silent_s:.0f} s") if silent else ("link ok",)
    angle = "" if angle_rad is None else f"{math.degrees(angle_rad):.1f} deg"
    return {
        "link": late,
        "beat": beat,
        "speed": (
            f"v {speed} mm/s  reference {reference}",
            f"{speed} of {reference} mm/s",
            f"{speed}/{reference} mm/s",
            f"{speed}/{reference}",
        ),
        "amplitude": (f"amplitude {angle}" if angle else "", angle, ""),
        "battery": ("" if volts is None else f"{volts:.2f} V", ""),
    }


def record_lines(record: RecordedTrial) -> list[str]:
    """What an operator needs to decide on a trial."""
    outcome = record.outcome
    stopped = f" ({record.stopped})" if record.stopped else ""
    measured = f"{record.measured_beats} of {record.beats} beats measured"
    errors = f"max|e| {mm(record.max_abs_error_m_s)} mm/s, RMS {mm(record.rms_error_m_s)}"
    return [
        f"trial {outcome.number}: {outcome.end}{stopped}, "
        f"{outcome.executed_beats} beats, {measured}",
        f"  largest error {errors}; {_straight_text(record.straight)}; {_battery_text(record)}",
    ]


def _straight_text(straight: HeadingDrift | None) -> str:
    if straight is None:
        return "straightness not known"
    mean_deg = math.degrees(straight.mean_yaw_rad)
    worst_deg = math.degrees(straight.worst_yaw_rad)
    word = "NOT straight" if straight.crooked else "straight"
    return f"{word} (yaw {mean_deg:+.1f} deg, {worst_deg:+.1f} at worst)"


def _battery_text(record: RecordedTrial) -> str:
    start_v, end_v = record.battery_start_v, record.battery_end_v
    if start_v is None or end_v is None:
        return "battery not known"
    return f"battery {start_v:.2f} to {end_v:.2f} V"
