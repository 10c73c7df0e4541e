"""Whether the board was switched off since it last swam: the hull was open, the ballast may have
shifted, and nobody has said so."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tailbeat.experiment.journal import Journal
    from tailbeat.fish import Fish

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
