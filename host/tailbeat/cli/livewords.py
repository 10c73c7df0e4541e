"""What is said of a guided swim, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tailbeat.cli.common import mm

if TYPE_CHECKING:
    from tailbeat.day.person import Event

SEVERITY_WARNING = 4  # MAV_SEVERITY_WARNING; lower is worse
_SILENT_S = 1.5  # of board time: it says something every second
_MARKS = {True: "ok", False: "no", None: ".."}

_LINK_NEWS = {
    "link_lost": "the link broke; trying to get it back (without it the board stops by itself)",
    "link_back": "the link is back",
    "interrupted": "Ctrl-C: the tail is being stopped",
}


def link_news(event: Event) -> str | None:
    """What happened to the connection; None for everything else."""
    words = _LINK_NEWS.get(event["event"])
    if words is None or event["event"] != "link_back":
        return words
    swims = event["state"] == "RUNNING"
    return f"{words}; {'it swims on' if swims else 'the board has stopped the tail meanwhile'}"


def loud(event: Event) -> str | None:
    """What must be told whatever else is kept quiet; None for everything else."""
    if event["event"] in ("warning", "hold", "notice"):
        return str(event["text"])
    if event["event"] == "text" and event["severity"] <= SEVERITY_WARNING:
        return str(event["text"])
    return f"stopped: {event['reason']}" if event["event"] == "guard" else None


def step_text(event: Event) -> str:
    """One step of the ritual."""
    left_s = event.get("left_s")
    left = f" ({math.ceil(left_s)} s)" if left_s and event["ok"] is None else ""
    return f"{_MARKS[event['ok']]:>2}  {event['step']}: {event['text']}{left}"


def countdown_text(event: Event) -> str:
    """Hands out."""
    left_s = event["left_s"]
    return f"it swims in {left_s} s: hands out (any key stops)" if left_s > 0 else "it swims"


def live_text(event: Event, keys: bool) -> str:
    """The line while it swims."""
    at, of = event["beat"], event["beats"]
    beat = f"beat {at + 1}/{of}" if at is not None and of else "starting"
    parts = [beat, f"v {mm(event['speed_m_s'])} mm/s", f"wanted {mm(event['reference_m_s'])}"]
    if event["amplitude_rad"] is not None:
        parts.append(f"amplitude {math.degrees(event['amplitude_rad']):.1f} deg")
    if event["battery_v"] is not None:
        parts.append(f"{event['battery_v']:.2f} V")
    silent_s = event["silent_s"]
    silent = silent_s is not None and silent_s > _SILENT_S
    parts.append(f"link silent {silent_s:.0f} s" if silent else "link ok")
    if keys:
        parts.append("any key stops")
    return ("simulated  " if event["simulated"] else "") + "  ".join(parts)


def swum_lines(event: Event) -> list[str]:
    """What a person needs to decide."""
    outcome, straight = event["outcome"], event["straight"]
    measured = f"{event['measured_beats']} of {event['beats']} beats measured"
    lines = [
        f"trial {outcome.number}, iteration {outcome.iteration}: {outcome.end}, "
        f"{outcome.executed_beats} beats, {measured}",
        f"  max|e| {mm(event['max_abs_error_m_s'])} mm/s, RMS {mm(event['rms_error_m_s'])}; "
        f"{_straight_text(straight)}; {_battery_text(event)}",
    ]
    return lines + [f"  ! {problem}" for problem in event["problems"]]


def _straight_text(straight: object) -> str:
    if straight is None:
        return "straightness not known"
    mean_deg = math.degrees(getattr(straight, "mean_yaw_rad", math.nan))
    worst_deg = math.degrees(getattr(straight, "worst_yaw_rad", math.nan))
    word = "NOT straight" if getattr(straight, "crooked", False) else "straight"
    return f"{word} (yaw {mean_deg:+.1f} deg, {worst_deg:+.1f} at worst)"


def _battery_text(event: Event) -> str:
    start_v, end_v = event["battery_start_v"], event["battery_end_v"]
    if start_v is None or end_v is None:
        return "battery not known"
    return f"battery {start_v:.2f} to {end_v:.2f} V"


def decided_text(event: Event) -> str:
    """What becomes of it."""
    words = {
        "keep": "kept",
        "repeat": "counts as a repeat, nothing is learned; the same amplitudes swim again",
        "discard": "discarded, counts for nothing; the same amplitudes swim again",
    }
    reason = f" ({event['reason']})" if event["reason"] else ""
    return f"trial {event['trial']}: {words[event['decision']]}{reason}"


def learned_text(event: Event) -> str:
    """What the board made of it."""
    best = ", the best so far" if event["improved"] else ""
    return (
        f"learned from trial {event['trial']}: max|e| {mm(event['max_abs_error_m_s'])} mm/s,"
        f" RMS {mm(event['rms_error_m_s'])}{best}"
    )
