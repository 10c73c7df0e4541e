"""What the battery allows: told before the board refuses, from how it fell so far.

Whether the board was switched off since it last swam: the hull was open, the ballast may have
shifted, and nobody has said so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.experiment.journal import Journal

_LOOK_BACK = 3  # swims the fall is averaged over: one reading scatters by some 20 mV


@dataclass(frozen=True)
class Drain:
    """One swim's voltages: ``start_v`` at rest before it, ``end_v`` at its end, ``least_v`` the
    least while the servo drew its current."""

    start_v: float
    end_v: float
    least_v: float


def too_low(now_v: float, params: Mapping[str, float]) -> str | None:
    """Why the board would refuse to arm, or None."""
    limit_v = params.get("BATT_LOW_V", 0.0)
    if limit_v <= 0 or now_v >= limit_v:
        return None
    return f"the battery has {now_v:.2f} V, and below {limit_v:.2f} V the board does not arm"


def forecast(now_v: float, drains: Sequence[Drain], params: Mapping[str, float]) -> str | None:
    """What will go wrong in the next swim or the one after it, or None. ``drains``: of the swims
    on this battery, oldest first."""
    recent = drains[-_LOOK_BACK:]
    if not recent:
        return None
    sag_v = max(drain.start_v - drain.least_v for drain in recent)
    critical_v = params.get("BATT_CRIT_V", 0.0)
    if critical_v > 0 and now_v - sag_v < critical_v:
        return (
            f"the battery will not last: it has {now_v:.2f} V, a swim takes it {sag_v:.2f} V down,"
            f" and below {critical_v:.2f} V the tail stops; change it before this swim"
        )
    starts = [*(drain.start_v for drain in recent), now_v]
    fall_v = (starts[0] - starts[-1]) / len(recent)
    low_v = params.get("BATT_LOW_V", 0.0)
    if low_v > 0 and fall_v > 0 and now_v - fall_v < low_v:
        return (
            f"the battery has {now_v:.2f} V and falls by {fall_v:.2f} V per swim: below"
            f" {low_v:.2f} V the board will not arm after this one; have a charged one ready"
        )
    return None


_KNOWN = ("begun", "resumed", "restarted")
_CLOCKS_S = 30.0  # the laptop's clock may be set meanwhile; nobody swaps a battery in less
_CLOCKS_PART = 1e-3  # far beyond what two clocks run apart


def switched_off_since(fish: Fish, journal: Journal) -> int | None:
    """The trial since which the board was switched off and on without 'session resume'; None = it
    was not, or nobody can tell.

    By the board's clock, which counts from 0. Of a simulated board, whose clock has its own pace,
    only one that has gone back is told."""
    entries = [one for one in journal.entries() if one["what"] in _KNOWN]
    trial = next((one["trial"] for one in reversed(entries) if one["what"] == "begun"), None)
    last = entries[-1] if entries else {}
    if trial is None or last.get("board_s") is None:
        return None
    now_s = fish.status().time_s  # the clock of an open link takes a while to follow a restart
    if now_s < last["board_s"]:
        return int(trial)
    return int(trial) if not fish.info().simulated and _was_off(last, now_s) else None


def _was_off(last: dict[str, Any], now_s: float) -> bool:
    """Whether the board counts less time since then than the computer."""
    passed = datetime.now().astimezone() - datetime.fromisoformat(last["time"])
    passed_s = passed.total_seconds()
    counted_s = now_s - float(last["board_s"])
    return passed_s - counted_s > _CLOCKS_S + _CLOCKS_PART * abs(passed_s)


def accepted(fish: Fish, journal: Journal) -> None:
    """Somebody knows of it, and the day goes on."""
    journal.add("restarted", board_s=fish.clock.now_s())
