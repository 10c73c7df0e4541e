"""CSV files: cells with their row and column, and one value per beat."""

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
    rows = read_rows(path, ("beat", column))
    values = np.empty(len(rows), dtype=np.float32)
    for k, (number, (beat, value)) in enumerate(rows):
        if beat != str(k):
            raise InputError(
                f"{path.name}, row {number}, column beat: '{beat}' where {k} is due.",
                "Beats count from 0, one row each.",
            )
        values[k] = value_of(path.name, number, column, value, gaps)
    return values


def read_table(path: Path, columns: str) -> list[list[str]]:
    """The cells of a CSV file; ``columns`` are named when it is none. Raises InputError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        return list(csv.reader(text.splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        remedy = f"Give a CSV file with the columns {columns}."
        raise InputError(f"cannot read {path} ({reason(error)}).", remedy) from error


def read_rows(path: Path, columns: tuple[str, ...]) -> list[tuple[int, list[str]]]:
    """(row number, cells of ``columns``) of every row that is not empty. Raises InputError when the
    header lacks one of them, or there are no rows."""
    wanted = ",".join(columns)
    table = read_table(path, wanted)
    header = [cell.strip() for cell in table[0]] if table else []
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
            rows.append((number, [row[i].strip() if i < len(row) else "" for i in at]))
    if not rows:
        raise InputError(f"{path.name} has a header but no numbers.", f"Add rows of {wanted}.")
    return rows


def value_of(name: str, number: int, column: str, cell: str, gaps: bool = False) -> float:
    """A cell as a number; with ``gaps`` an empty one or ``nan`` is NaN. Raises InputError, which
    names the file, row and column."""
    if gaps and cell.lower() in ("", "nan"):
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{name}, row {number}, column {column}: '{cell}' is no finite number.",
            "Write it like 0.0791.",
        )
    return value
