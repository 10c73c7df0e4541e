"""What is said of a guided swim, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tailbeat.app.cli._terminal import mm

if TYPE_CHECKING:
    from tailbeat.session.operator import Event

SEVERITY_WARNING = 4  # MAV_SEVERITY_WARNING; lower is worse
_SILENT_S = 1.5  # of board time: it says something every second
_MARKS = {True: "ok", False: "no", None: ".."}

_SHORTER = (  # the first first
    "amplitude", "speed", "beat", "amplitude", "battery", "link", "speed", "speed"
)  # fmt: skip

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
    from tailbeat.session.guards import BY_HAND

    if event["event"] in ("warning", "hold", "notice"):
        return str(event["text"])
    if event["event"] == "text" and event["severity"] <= SEVERITY_WARNING:
        return str(event["text"])
    if event["event"] != "guard":
        return None
    reason = str(event["reason"])
    return reason if reason == BY_HAND else f"stopped: {reason}"


def step_text(event: Event) -> str:
    """One step of the ritual."""
    left_s = event.get("left_s")
    left = f" ({math.ceil(left_s)} s)" if left_s and event["ok"] is None else ""
    return f"{_MARKS[event['ok']]:>2}  {event['step']}: {event['text']}{left}"


def countdown_text(event: Event) -> str:
    """Hands out."""
    left_s = event["left_s"]
    return f"it swims in {left_s} s: hands out (any key stops)" if left_s > 0 else "it swims"


def live_text(event: Event, keys: bool, width: int) -> str:
    """The line while it swims, in ``width`` columns: of what has no room the least needed is
    shortened, or goes, first. What it is, how to stop it and the link stay."""
    parts = _live_parts(event)
    fixed = ["simulated"] if event["simulated"] else []
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


def _live_parts(event: Event) -> dict[str, tuple[str, ...]]:
    """In order on the line, each from its long form to its short one."""
    at, of = event["beat"], event["beats"]
    beat = (f"beat {at + 1}/{of}", f"{at + 1}/{of}") if at is not None and of else ("starting",)
    speed, wanted = mm(event["speed_m_s"]), mm(event["reference_m_s"])
    silent_s, volts, angle_rad = event["silent_s"], event["battery_v"], event["amplitude_rad"]
    silent = silent_s is not None and silent_s > _SILENT_S
    late = (f"link silent {silent_s:.0f} s", f"silent {silent_s:.0f} s") if silent else ("link ok",)
    angle = "" if angle_rad is None else f"{math.degrees(angle_rad):.1f} deg"
    return {
        "link": late,
        "beat": beat,
        "speed": (
            f"v {speed} mm/s  wanted {wanted}",
            f"{speed} of {wanted} mm/s",
            f"{speed}/{wanted} mm/s",
            f"{speed}/{wanted}",
        ),
        "amplitude": (f"amplitude {angle}" if angle else "", angle, ""),
        "battery": ("" if volts is None else f"{volts:.2f} V", ""),
    }


def swum_lines(event: Event) -> list[str]:
    """What a person needs to decide."""
    from tailbeat.session.collect import NOT_COMPLETE

    outcome, straight = event["outcome"], event["straight"]
    measured = f"{event['measured_beats']} of {event['beats']} beats measured"
    cut = f"{NOT_COMPLETE} {outcome.end}"
    ends = [problem.removeprefix(f"{NOT_COMPLETE} ") for problem in event["problems"]]
    end = next((one for one in ends if one.startswith(outcome.end)), outcome.end)
    lines = [
        f"trial {outcome.number}, iteration {outcome.iteration}: {end}, "
        f"{outcome.executed_beats} beats, {measured}",
        f"  max|e| {mm(event['max_abs_error_m_s'])} mm/s, RMS {mm(event['rms_error_m_s'])}; "
        f"{_straight_text(straight)}; {_battery_text(event)}",
    ]
    others = [problem for problem in event["problems"] if not problem.startswith(cut)]
    return lines + [f"  ! {problem}" for problem in others]


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
