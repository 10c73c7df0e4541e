"""How things are put on the page: short words, numbers with their units."""

from __future__ import annotations

import math

from tailbeat.app.web.state import GuideStep, PageState
from tailbeat.core.printable import mm
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.session.events import StepProgress
from tailbeat.session.outcome import Travel

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


def guide_shown(now: PageState) -> tuple[GuideStep, ...]:
    """All steps while the guided job is under way, then what it ended with: START stays in
    sight."""
    return now.guide if now.phase != "idle" else now.guide[-1:]


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
        return "The board has no reference yet: START gives it the thesis's; another one: below."
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
