"""CSV files with one value per beat, and speeds against time."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError, reason

Floats = NDArray[np.float32]


def read_column(path: Path, column: str, gaps: bool = False) -> Floats:
    """The ``column`` of a file ``beat,<column>``; beats count from 0 without holes.

    With ``gaps`` an empty cell or ``nan`` is NaN, otherwise refused.
    """
    rows = _rows(path, ("beat", column))
    values = np.empty(len(rows), dtype=np.float32)
    for k, (number, beat, value) in enumerate(rows):
        if beat != str(k):
            raise InputError(
                f"{path.name}, row {number}, column beat: '{beat}' where {k} is due.",
                "Beats count from 0, one row each.",
            )
        values[k] = _value(path, number, column, value, gaps)
    return values


def read_speeds(path: Path, beats: int, beat_s: float) -> Floats:
    """Speeds per beat: from ``beat,speed_m_s`` as they are, from ``t_s,v_m_s`` as means over each
    beat (NaN where a beat is not covered). float32, shape (beats,)."""
    if "speed_m_s" in _header(read_table(path, "t_s,v_m_s or beat,speed_m_s")):
        values = read_column(path, "speed_m_s", gaps=True)
        if len(values) != beats:
            raise InputError(
                f"{path.name} has {len(values)} beats, the trial has {beats}.",
                "Give one row per beat; leave cells empty where nothing was measured.",
            )
        return values
    rows = _rows(path, ("t_s", "v_m_s"))
    time = np.array([_value(path, n, "t_s", t, False) for n, t, _ in rows])
    speed = np.array([_value(path, n, "v_m_s", v, False) for n, _, v in rows])
    later = np.flatnonzero(np.diff(time) <= 0)
    if later.size:
        raise InputError(
            f"{path.name}, row {rows[later[0] + 1][0]}, column t_s: time does not rise.",
            "Sort by time.",
        )
    return _means(time, speed, beats, beat_s)


def _means(
    time: NDArray[np.float64], speed: NDArray[np.float64], beats: int, beat_s: float
) -> Floats:
    """Exact means of the straight lines through the points."""
    distance = np.concatenate([[0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)])
    means = np.full(beats, np.nan, dtype=np.float32)
    slack_s = 1e-6 * beat_s
    for k in range(beats):
        begin, end = k * beat_s, (k + 1) * beat_s
        if time[0] > begin + slack_s or time[-1] < end - slack_s:
            continue
        means[k] = (_at(time, speed, distance, end) - _at(time, speed, distance, begin)) / beat_s
    return means


def _at(
    time: NDArray[np.float64],
    speed: NDArray[np.float64],
    distance: NDArray[np.float64],
    t: float,
) -> float:
    i = min(max(int(np.searchsorted(time, t, side="right")) - 1, 0), len(time) - 2)
    dt = min(max(t, time[0]), time[-1]) - time[i]
    slope = (speed[i + 1] - speed[i]) / (time[i + 1] - time[i])
    return float(distance[i] + speed[i] * dt + slope * dt**2 / 2)


def read_table(path: Path, columns: str) -> list[list[str]]:
    """The cells of a CSV file; ``columns`` are named when it is none. Raises InputError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        return list(csv.reader(text.splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        remedy = f"Give a CSV file with the columns {columns}."
        raise InputError(f"cannot read {path} ({reason(error)}).", remedy) from error


def _header(table: list[list[str]]) -> list[str]:
    return [cell.strip() for cell in table[0]] if table else []


def _rows(path: Path, columns: tuple[str, str]) -> list[tuple[int, str, str]]:
    """(row number, first cell, second cell) of every row that is not empty."""
    wanted = ",".join(columns)
    table = read_table(path, wanted)
    header = _header(table)
    for column in columns:
        if column not in header:
            raise InputError(
                f"{path.name}, row 1: the header has no column {column}.",
                f"The first row must be {wanted}.",
            )
    at = [header.index(column) for column in columns]
    rows = []
    for number, row in enumerate(table[1:], start=2):
        if any(cell.strip() for cell in row):
            first, second = (row[i].strip() if i < len(row) else "" for i in at)
            rows.append((number, first, second))
    if not rows:
        raise InputError(f"{path.name} has a header but no numbers.", f"Add rows of {wanted}.")
    return rows


def _value(path: Path, number: int, column: str, cell: str, gaps: bool) -> float:
    if gaps and cell.lower() in ("", "nan"):
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{path.name}, row {number}, column {column}: '{cell}' is no finite number.",
            "Write it like 0.0791.",
        )
    return value
