"""How things are put on the page: short words, numbers with their units."""

from __future__ import annotations

import math

from tailbeat.app.web.state import GuideStep, PageState
from tailbeat.core.printable import mm
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.session.events import StepProgress
from tailbeat.session.outcome import RecordedTrial, Travel

SILENT_S = 3.0
_BATTERY_MARGIN_V = 0.3  # above BATT_LOW_V: one more trial, then the next battery

STATES = {
    "BOOT": "starting",
    "IDLE": "at rest",
    "ARMED": "armed: the tail may start",
    "RUNNING": "trial running",
    "SETTLING": "executed, evaluating the last beats",
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
    "swimming": "Trial running",
    "deciding": "Your decision",
    "asking": "A question",
    "failed": "Failed",
}
DECISIONS = {
    "keep": ("Keep", "the fish learns from it"),
    "repeat": ("Repeat", "counts as a repeated trial; the same input is executed again"),
    "discard": ("Discard", "counts for nothing; the same input is executed again"),
}


def phase_line(now: PageState) -> str:
    """What is going on, as a headline."""
    if now.phase == "swimming":
        running, beats = now.run.capitalize() or PHASES["swimming"], len(now.reference_m_s)
        of = f" of {beats}" if beats else ""
        return running if now.beat is None else f"{running}: {now.beat}{of} beats done"
    if now.phase == "countdown" and now.left_s is not None:
        return f"Hands out of the water: {now.left_s:.0f}"
    if now.phase == "deciding" and now.recorded is not None:
        return decision_line(now.recorded)
    if now.phase == "idle" and now.fault:
        return "Stopped"
    return PHASES[now.phase]


def decision_line(recorded: RecordedTrial) -> str:
    """What is to be decided."""
    return f"Keep trial {recorded.outcome.number}?"


def announcement(now: PageState) -> str:
    """What a screen reader says of itself: the phase and what became of the last step. Not the
    beat, which changes every second."""
    words = [PHASES[now.phase]]
    if now.phase == "preflight":
        words += [step.text for step in now.steps if step.ok is not None][-1:]
    elif now.phase in ("working", "idle"):
        words += [f"{step.name}: {step.words}" for step in now.guide][-1:]
    return ". ".join(words)


def steps_shown(now: PageState) -> tuple[StepProgress, ...]:
    """The preflight checks, while they are under way."""
    return now.steps if now.phase in ("preflight", "countdown") else ()


def guide_shown(now: PageState) -> tuple[GuideStep, ...]:
    """All steps while the guided job is under way, then what it ended with: START stays in
    sight."""
    return now.guide if now.phase != "idle" else now.guide[-1:]


def live_line(now: PageState) -> str:
    """The last beat that is known, while it swims."""
    beat = max((k for k, v in enumerate(now.speed_m_s) if v is not None), default=None)
    if now.phase != "swimming" or beat is None:
        return ""
    line = f"{mm(now.speed_m_s[beat])} mm/s"
    line += f", reference {mm(now.reference_m_s[beat])}" if now.reference_m_s else ""
    amplitude = now.amplitude_rad[beat]
    return line if amplitude is None else f"{line}; tail ±{math.degrees(amplitude):.0f}°"


def travel_line(travel: Travel) -> str:
    """How far the next trial goes, and whether the tank is long enough."""
    words = f"travel distance {travel.expected_m:.2f} m, at worst {travel.worst_m:.2f} m"
    if math.isfinite(travel.room_m):
        words += f"; tank clearance {travel.room_m:.2f} m"
    return words if travel.fits else f"TANK TOO SHORT: {words}"


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
        return f"Trial {now.pending} is not decided yet: START asks about it first."
    if now.phase not in ("idle", "connecting"):
        return ""
    if not now.reference_m_s and now.experiment:
        what = "it and what was learned along it; another one (below) begins anew"
        return f"The board has lost its reference. START restores {what}."
    if not now.reference_m_s:
        return "The board has no reference yet. START uploads the thesis's; choose another below."
    line = f"START: trial {now.next_trial}, iteration {max(now.iteration, 1)}"
    return f"{line}; {now.travel}" if now.travel else line


def battery(now: PageState) -> tuple[str, str]:
    """Text and look: ``well``, ``low`` or ``unknown``."""
    if now.battery_v is None or now.battery_v <= 0:
        return "battery ?", "unknown"
    low = now.battery_v < now.battery_low_v + _BATTERY_MARGIN_V
    return f"battery {now.battery_v:.1f} V" + (" LOW" if low else ""), "low" if low else "well"


def imu(now: PageState) -> tuple[str, str]:
    """Likewise."""
    if now.imu_well is None:
        return "IMU ?", "unknown"
    return ("IMU ok", "well") if now.imu_well else ("IMU: fault", "low")


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
    """Link, battery and IMU; the last two are not well because they once were."""
    of_board = (battery(now), imu(now))
    if is_stale(now, silent_s):
        of_board = (of_board[0][0], "unknown"), (of_board[1][0], "unknown")
    return link(now, silent_s), *of_board


def is_stale(now: PageState, silent_s: float | None) -> bool:
    """Whether what is shown of the board may be wrong by now."""
    return now.phase == "connecting" or silent_s is None or silent_s >= SILENT_S


def heading_drift(found: HeadingDrift) -> str:
    """The largest one of a trial."""
    return f"heading drift {math.degrees(found.worst_yaw_rad):+.0f}°"


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
