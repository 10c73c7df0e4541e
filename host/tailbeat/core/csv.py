"""CSV files: cells with their row and column, and one value per beat.

Speeds that were measured after a trial: CSV files to one value per beat.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.core.errors import InputError, reason
from tailbeat.core.lazy_arrays import F32, F64, np

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_WITH_COMMAS = "Save it with commas between columns and decimal points, like 0.5,0.0791."


def read_column(path: Path, column: str, gaps: bool = False) -> F32:
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


def table_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table as CSV; None = an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


def spreadsheet_text(text: str) -> str:
    """Text as a cell that no spreadsheet takes for a formula: with an apostrophe in front if it
    begins like one."""
    return f"'{text}" if text[:1] in _FORMULA else text


def value_of(
    name: str, number: int, column: str, cell: str, gaps: bool = False, least: float = -math.inf
) -> float:
    """A cell as a number, ``least`` or more; with ``gaps`` an empty one or ``nan`` is NaN. Raises
    InputError, which names the file, row and column."""
    if gaps and cell.lower() in ("", "nan"):
        return math.nan
    where = f"{name}, row {number}, column {column}"
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: '{cell}' is no finite number.", "Write it like 0.0791.")
    if value < least:
        raise InputError(f"{where}: {value:g} is less than {least:g}.", f"From {least:g} on.")
    return value


TIMED = ("t_s", "v_m_s")
FORMS = "t_s,v_m_s or beat,speed_m_s"
_SPEED_MAX_M_S = 1.0  # no fish of this kind; 80 of something is mm/s
_HOLE_SPACINGS = 1.5  # rows further apart than so many of the usual spacing have a hole between
_SLACK = 1e-6  # of a beat, for times that were rounded


@dataclass(frozen=True)
class BeatSpeeds:
    """One value per beat, float32, shape (beats,); NaN = not measured. ``sigma_m_s`` None = the
    file does not tell."""

    speed_m_s: F32
    sigma_m_s: F32 | None = None

    @property
    def measured(self) -> int:
        """How many beats have a speed."""
        return int(np.isfinite(self.speed_m_s).sum())


def read_speeds(path: Path, beats: int, beat_s: float, trial: int | None = None) -> BeatSpeeds:
    """Speeds per beat of one of two forms of file.

    ``beat,speed_m_s``: as they are; an empty cell = not measured. ``t_s,v_m_s``, t_s from the begin
    of the trial: means over each beat of the straight lines through the points. Further columns of
    the second form may be:

    ``window_s``: a value is itself a mean over such a window around t_s. A beat's value is then the
    mean over what is left of the beat when half a window is taken off both ends, the value in the
    middle for a window of one beat (as the board does, firmware/speed/speed.h), and a beat with a
    hole there is not measured: rows further apart than 1.5 times their usual (median) spacing, or
    than half a beat.
    ``sigma_m_s``: averaged in the same way, and divided by the square root of the number of windows
    that fit into the beat (by nothing when there are none: neighbours may share their noise).
    ``trial``: whose speeds these are; must be ``trial``, unless that is None.

    Raises InputError, with row and column where there is one: not in SI units, no number, times
    that do not rise, another trial's, not paired with a trial, no beat covered.
    """
    header = [cell.strip() for cell in (read_table(path, FORMS) or [[]])[0]]
    if "speed_m_s" in header:
        return BeatSpeeds(_per_beat(path, beats))
    table = _Table(path, header)
    if trial is not None and "trial" in header:
        table.check_trial(trial)
    time, speed = table.column("t_s"), table.column("v_m_s", _is_speed, "m/s, like 0.0791")
    table.check_rising(time)
    window_s = table.window_s(beat_s) if "window_s" in header else None
    sigma = table.column("sigma_m_s", _is_sigma, "m/s, > 0") if "sigma_m_s" in header else None
    hole_s = math.inf
    if window_s and len(time) > 1:
        hole_s = min(_HOLE_SPACINGS * float(np.median(np.diff(time))), beat_s / 2)
    cut_s = (window_s or 0.0) / 2
    means = _Means(time, hole_s, _SLACK * beat_s)
    begins = np.arange(beats) * beat_s
    spans = [(b + cut_s, b + beat_s - cut_s) for b in begins]
    found = BeatSpeeds(means.over(speed, spans))
    if found.measured == 0:
        raise InputError(
            f"{path.name} covers no beat: its times are {time[0]:g} to {time[-1]:g}.",
            "t_s counts seconds from the begin of the trial.",
        )
    if sigma is None:
        return found
    windows = beat_s / window_s if window_s else 1.0
    shared = means.over(sigma, spans) / math.sqrt(windows)
    return BeatSpeeds(found.speed_m_s, shared.astype(np.float32))


def _per_beat(path: Path, beats: int) -> F32:
    values = read_column(path, "speed_m_s", gaps=True)
    if len(values) != beats:
        raise InputError(
            f"{path.name} has {len(values)} beats, the trial has {beats}.",
            "Give one row per beat; leave cells empty where nothing was measured.",
        )
    return values


def _is_speed(value: float) -> bool:
    return abs(value) <= _SPEED_MAX_M_S


def _is_sigma(value: float) -> bool:
    return 0 < value <= _SPEED_MAX_M_S


def _is_window(value: float) -> bool:
    return value >= 0


class _Table:
    """A file with TIMED and perhaps more columns."""

    def __init__(self, path: Path, header: list[str]) -> None:
        wanted = TIMED + tuple(
            name for name in ("sigma_m_s", "window_s", "trial") if name in header
        )
        self._name = path.name
        self._rows = read_rows(path, wanted)
        self._at = {name: i for i, name in enumerate(wanted)}

    def cells(self, name: str) -> list[tuple[int, str]]:
        """(row number, cell) of one column."""
        at = self._at[name]
        return [(number, cells[at]) for number, cells in self._rows]

    def column(
        self,
        name: str,
        makes_sense: Callable[[float], bool] = math.isfinite,
        unit: str = "",
    ) -> F64:
        """The numbers of one column; those that make no sense are refused."""
        values = np.empty(len(self._rows))
        for i, (number, cell) in enumerate(self.cells(name)):
            values[i] = value_of(self._name, number, name, cell)
            if not makes_sense(values[i]):
                raise self.wrong(number, name, f"'{cell}' makes no sense", f"It is in {unit}.")
        return values

    def wrong(self, number: int, name: str, what: str, remedy: str) -> InputError:
        return InputError(f"{self._name}, row {number}, column {name}: {what}.", remedy)

    def check_rising(self, time: F64) -> None:
        later = np.flatnonzero(np.diff(time) <= 0)
        if later.size:
            number = self._rows[later[0] + 1][0]
            raise self.wrong(number, "t_s", "time does not rise", "Sort by time.")

    def check_trial(self, trial: int) -> None:
        for number, cell in self.cells("trial"):
            if not cell:
                raise InputError(
                    f"{self._name}: the film is not paired with a trial",
                    f"Pair it: tailbeat camera track FILM --trial {trial:04d}.ulg",
                )
            if not (cell.isascii() and cell.isdecimal()):
                raise self.wrong(number, "trial", f"'{cell}' is no trial", "Track the film again.")
            if int(cell) != trial:
                raise self.wrong(
                    number,
                    "trial",
                    f"these speeds are of trial {int(cell)}, not {trial}",
                    "Give the file of the trial that waits for its speeds.",
                )

    def window_s(self, beat_s: float) -> float:
        """The one window of all rows."""
        values = self.column("window_s", _is_window, "s, 0 or more")
        for value, (number, _) in zip(values, self._rows, strict=True):
            if abs(value - values[0]) > 1e-3 * beat_s:
                raise self.wrong(number, "window_s", "another window than above", "Use one.")
            if value > (1 + 1e-3) * beat_s:
                raise self.wrong(
                    number,
                    "window_s",
                    f"a mean over {value:g} s, and a beat of this trial has {beat_s:g} s",
                    f"Track the film with --beat {beat_s:g}.",
                )
        return min(float(values[0]), beat_s)


class _Means:
    """Exact means of straight lines through points at ``time``, except across holes."""

    def __init__(self, time: F64, hole_s: float, slack_s: float) -> None:
        self._time, self._slack_s = time, slack_s
        holes = np.flatnonzero(np.diff(time) > hole_s)
        self._first = np.concatenate([[0], holes + 1])  # of each stretch without holes
        self._last = np.concatenate([holes, [len(time) - 1]])

    def over(self, value: F64, spans: list[tuple[float, float]]) -> F32:
        """Mean over each span, NaN where it is not covered."""
        return np.array([self._mean(value, *span) for span in spans], dtype=np.float32)

    def _mean(self, value: F64, begin: float, end: float) -> float:
        time, slack_s = self._time, self._slack_s
        inside = (time[self._first] <= begin + slack_s) & (time[self._last] >= end - slack_s)
        if not inside.any():
            return math.nan
        stretch = int(np.argmax(inside))
        some = slice(self._first[stretch], self._last[stretch] + 1)
        t, v = time[some], value[some]
        begin, end = (min(max(x, t[0]), t[-1]) for x in (begin, end))
        if end - begin <= slack_s:
            return float(np.interp((begin + end) / 2, t, v))
        between = t[(t > begin) & (t < end)]
        corners = np.concatenate([[begin], between, [end]])
        return float(np.trapezoid(np.interp(corners, t, v), corners) / (end - begin))
