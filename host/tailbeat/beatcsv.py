"""CSV files: cells with their row and column, and one value per beat."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError, reason

Floats = NDArray[np.float32]

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_WITH_COMMAS = "Save it with commas between columns and decimal points, like 0.5,0.0791."


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
    """The cells of a CSV file with commas between them; ``columns`` are named when it is none. Only
    empty cells may lie behind the header's last column. Raises InputError."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        table = list(csv.reader(text.splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        remedy = f"Give a CSV file with the columns {columns}."
        raise InputError(f"cannot read {path} ({reason(error)}).", remedy) from error
    if table:
        _require_commas(path.name, table)
    return table


def _require_commas(name: str, table: list[list[str]]) -> None:
    """A spreadsheet that writes decimal commas puts semicolons, or nothing else, between cells."""
    for sign, what in ((";", "semicolons"), ("\t", "tabs")):
        if len(table[0]) == 1 and sign in table[0][0]:
            raise InputError(f"{name} has {what} between its columns.", _WITH_COMMAS)
    width = len(table[0])
    for number, row in enumerate(table[1:], start=2):
        if any(cell.strip() for cell in row[width:]):
            what = f"{len(row)} cells, the header has {width}"
            raise InputError(f"{name}, row {number} has {what}.", _WITH_COMMAS)


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


def spreadsheet_text(text: str) -> str:
    """Text as a cell that no spreadsheet takes for a formula: with an apostrophe in front if it
    begins like one."""
    return f"'{text}" if text[:1] in _FORMULA else text


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
