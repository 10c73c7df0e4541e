"""What the journal says of each swim."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Told:
    """Of one trial's file. ``decision`` empty: nobody decided. ``learned`` None: the journal does
    not tell (an older tool, or commands without a series). ``swum``: it tells of the swim.
    ``battery_start_v``: before the tail loaded it; a log begins later."""

    decision: str = ""
    reason: str = ""
    learned: bool | None = None
    rolled_back: bool = False
    time: str = ""
    swum: bool = False
    battery_start_v: float | None = None


def told_of(entries: Iterable[Mapping[str, Any]], names: Mapping[str, str]) -> dict[str, Told]:
    """By the file's name. ``names``: of every raw file, that of the file its trial is now (a log
    that grew was kept again). An entry that names no file is of the last one swum with its number;
    a board that was made anew counts from 1 again."""
    told = {name: Told() for name in names.values()}
    file_of = {Path(name).stem: name for name in names}
    for entry in entries:
        number = entry.get("trial")
        stem = f"{number:04d}" if isinstance(number, int) else ""
        file = Path(str(entry.get("file") or file_of.get(stem, ""))).name
        if file not in names:
            continue
        if entry["what"] == "swum":
            file_of[stem] = file
        told[names[file]] = _with(told[names[file]], entry)
    return told


def _with(told: Told, entry: Mapping[str, Any]) -> Told:
    if entry["what"] == "swum":
        volts = entry.get("battery_start_v")
        return replace(told, time=str(entry["time"]), swum=True, battery_start_v=volts)
    if entry["what"] == "decided":
        decision, reason = str(entry.get("decision", "")), str(entry.get("reason") or "")
        learned = told.learned or False  # a decision alone: it has not happened, or not yet
        return replace(told, decision=decision, reason=reason, learned=learned, swum=True)
    if entry["what"] == "withdrawn":
        return replace(told, decision="", reason="")
    if entry["what"] == "learned":
        return replace(told, learned=True, rolled_back=bool(entry.get("rolled_back")))
    return told
