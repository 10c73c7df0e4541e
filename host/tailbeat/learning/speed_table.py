"""A fish from a table of steady speeds: the thesis's drag coefficient, and a line through the rows.

A cruising fish no longer speeds up, so (8.3)-(8.13) leave F = alpha*v**2 with F = H1 - H2*v**2. How
fast it gets there, and how late its thrust comes, no steady speed can tell: those are assumed, over
a range that the answers stand for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.csv import read_table
from tailbeat.core.errors import InputError
from tailbeat.core.reference import THESIS_PLATEAU_M_S
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified

COLUMNS = ("amplitude_rad", "speed_m_s")
ASSUMED = ("kappa_per_m", "delay_s")
KAPPA_PER_M = (5.0, 10.0, 20.0)
DELAY_S = (0.1, 0.3, 0.5)
_PHASES = 256  # the integrands are smooth and periodic: the sum over a beat is exact to rounding


@dataclass(frozen=True)
class ThesisFish:
    """What (8.3)-(8.13) need of a fish; the defaults are the thesis's. ``tail_area_m2``: A."""

    mass_kg: float = 0.4
    length_m: float = 0.36
    density_kg_m3: float = 1000.0
    tail_area_m2: float = math.pi * 0.165**2 / 4
    beat_s: float = 1.0

    def check(self) -> None:
        """Raises InputError unless all are finite and above 0."""
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"a fish with {name} = {value:g} makes no sense.", "Correct it.")

    def thrust_terms(self, amplitude_rad: F64) -> tuple[F64, F64]:
        """(H1 in N, H2 in kg/m) of (8.5)-(8.10) for amplitudes of any shape."""
        phase = 2 * np.pi * (np.arange(_PHASES) + 0.5) / _PHASES
        theta = np.asarray(amplitude_rad, dtype=np.float64)[..., None]
        angle = theta * np.sin(phase)
        heave_m_s = 2 / 3 * np.pi / self.beat_s * theta * self.length_m * np.cos(phase)
        half = self.density_kg_m3 * self.tail_area_m2 / 2
        h1 = half * np.mean((heave_m_s / np.cos(angle) ** 2) ** 2, axis=-1)
        h2 = half * np.mean(np.tan(angle) ** 2, axis=-1)
        return np.asarray(h1), np.asarray(h2)

    def drag_kg_m(self, amplitude_rad: F64, steady_m_s: F64) -> float:
        """alpha: least squares of F = alpha*v**2 over steady cruises, shape (rows,)."""
        h1, h2 = self.thrust_terms(amplitude_rad)
        v2 = steady_m_s**2
        return float(np.sum((h1 - h2 * v2) * v2) / np.sum(v2**2))


@dataclass(frozen=True)
class Line:
    """speed = slope*(amplitude - dead zone); ``rms_m_s`` over the rows it was drawn through."""

    slope_m_s_rad: float
    dead_zone_rad: float
    rms_m_s: float


@dataclass(frozen=True)
class Table:
    """What a table of steady speeds tells. Arrays: shape (rows,), by rising amplitude.

    ``gain_min_m_s_rad``/``gain_max_m_s_rad``: the flattest and the steepest piece between
    neighbouring rows. ``thesis_m_s``: the speeds (8.13) settles at with ``alpha_kg_m``.
    """

    amplitude_rad: F64
    speed_m_s: F64
    fish: ThesisFish
    alpha_kg_m: float
    line: Line
    gain_min_m_s_rad: float
    gain_max_m_s_rad: float
    thesis_m_s: F64
    identified: Identified

    @property
    def kappa_thesis_per_m(self) -> float:
        """alpha/M of (8.13): the drag of a fish whose mass is only its own."""
        return self.alpha_kg_m / self.fish.mass_kg

    @property
    def coast_s(self) -> float:
        """M/(2*alpha*v) at the thesis's cruise: how long its fish takes to slow down, s."""
        return 1 / (2 * self.kappa_thesis_per_m * THESIS_PLATEAU_M_S)

    @property
    def note(self) -> str:
        """Why kappa is not taken from alpha."""
        return (
            f"alpha/M = {self.kappa_thesis_per_m:.0f} 1/m is a time constant of "
            f"{self.coast_s * 1e3:.0f} ms; a swimming fish coasts for seconds. Steady speeds "
            "cannot tell: kappa and delay are assumed until runs are swum."
        )

    def rows(self) -> list[dict[str, float]]:
        """One per row, with what the line and the thesis's model miss it by."""
        model = self.identified.model.steady_m_s(self.amplitude_rad)
        columns = {
            "amplitude_rad": self.amplitude_rad,
            "speed_m_s": self.speed_m_s,
            "line_m_s": model,
            "line_residual_m_s": self.speed_m_s - model,
            "thesis_m_s": self.thesis_m_s,
            "thesis_residual_m_s": self.speed_m_s - self.thesis_m_s,
        }
        return [
            {name: float(values[k]) for name, values in columns.items()}
            for k in range(len(self.speed_m_s))
        ]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; keys end in their unit."""
        return {
            "source": "table",
            "alpha_kg_m": self.alpha_kg_m,
            "kappa_thesis_per_m": self.kappa_thesis_per_m,
            "coast_thesis_s": self.coast_s,
            "note": self.note,
            "slope_m_s_rad": self.line.slope_m_s_rad,
            "dead_zone_rad": self.line.dead_zone_rad,
            "line_rms_m_s": self.line.rms_m_s,
            "gain_min_m_s_rad": self.gain_min_m_s_rad,
            "gain_max_m_s_rad": self.gain_max_m_s_rad,
            "assumed": {name: getattr(self.identified.model, name) for name in ASSUMED},
            "band": self.identified.band,
            "rows": self.rows(),
        }


def from_table(path: Path, fish: ThesisFish | None = None) -> Table:
    """Reads ``amplitude_rad,speed_m_s`` (steady cruise) and identifies the fish as far as that
    goes. Raises InputError, one line, for a table that cannot be one."""
    amplitude, speed = read_rows(path)
    return identify_table(amplitude, speed, fish, path.name)


def identify_table(
    amplitude_rad: F64, speed_m_s: F64, fish: ThesisFish | None = None, name: str = "the table"
) -> Table:
    """The same from arrays, sorted by rising amplitude, at least two rows."""
    fish = fish or ThesisFish()
    fish.check()
    line = _line(amplitude_rad, speed_m_s)
    pieces = np.diff(speed_m_s) / np.diff(amplitude_rad)
    if line.slope_m_s_rad <= 0 or pieces.min() <= 0:
        raise InputError(
            f"{name}: the speed does not rise with the amplitude everywhere.",
            "A faster tail must swim faster; look for swapped columns or a spoilt row.",
        )
    h1, h2 = fish.thrust_terms(amplitude_rad)
    alpha = fish.drag_kg_m(amplitude_rad, speed_m_s)
    if alpha <= 0:
        raise InputError(
            f"{name}: no tail of this fish could swim so fast (the drag comes out negative).",
            "Give amplitudes in rad and speeds in m/s, and the fish's own length and tail area.",
        )
    return Table(
        amplitude_rad=amplitude_rad,
        speed_m_s=speed_m_s,
        fish=fish,
        alpha_kg_m=alpha,
        line=line,
        gain_min_m_s_rad=float(pieces.min()),
        gain_max_m_s_rad=float(pieces.max()),
        thesis_m_s=np.sqrt(h1 / (alpha + h2)),
        identified=_identified(amplitude_rad, speed_m_s, line, alpha),
    )


def _line(amplitude: F64, speed: F64) -> Line:
    """Least squares; through the origin when the dead zone would come out below 0."""
    offset, slope = np.polynomial.polynomial.polyfit(amplitude, speed, 1)
    if offset > 0:
        offset, slope = 0.0, amplitude @ speed / (amplitude @ amplitude)
    rms = float(np.sqrt(np.mean((speed - offset - slope * amplitude) ** 2)))
    return Line(float(slope), float(-offset / slope) if slope else 0.0, rms)


def _identified(amplitude: F64, speed: F64, line: Line, alpha_kg_m: float) -> Identified:
    """Every assumed kappa and delay with the line and each line that leaves one row out."""
    lines = [line, *_jackknife(amplitude, speed)]
    models = [
        FishModel(kappa, one.slope_m_s_rad, one.dead_zone_rad, delay)
        for kappa, delay, one in product(KAPPA_PER_M, DELAY_S, lines)
    ]
    model = FishModel(KAPPA_PER_M[1], line.slope_m_s_rad, line.dead_zone_rad, DELAY_S[1])
    scale = np.array(
        [
            [math.log(m.kappa_per_m), math.log(m.slope_m_s_rad), m.dead_zone_rad, m.delay_s]
            for m in models
        ]
    )
    return Identified(
        model=model,
        models=models,
        covariance=np.cov(scale.T),
        source="table",
        assumed=ASSUMED,
        made=datetime.now().astimezone().isoformat(timespec="seconds"),
        alpha_kg_m=alpha_kg_m,
    )


def _jackknife(amplitude: F64, speed: F64) -> list[Line]:
    if len(amplitude) < 3:
        return []
    kept = [np.arange(len(amplitude)) != k for k in range(len(amplitude))]
    lines = [_line(amplitude[rows], speed[rows]) for rows in kept]
    return [one for one in lines if one.slope_m_s_rad > 0]


def read_rows(path: Path) -> tuple[F64, F64]:
    """(amplitude_rad, speed_m_s) of a table, by rising amplitude. Raises InputError."""
    wanted = ",".join(COLUMNS)
    cells = read_table(path, wanted)
    header = [cell.strip() for cell in cells[0]] if cells else []
    for column in COLUMNS:
        if column not in header:
            raise InputError(
                f"{path.name}, row 1: the header has no column {column}.",
                f"The first row must be {wanted}.",
            )
    at = [header.index(column) for column in COLUMNS]
    rows = [
        [_value(path, number, name, row[i] if i < len(row) else "")
         for name, i in zip(COLUMNS, at, strict=True)]
        for number, row in enumerate(cells[1:], start=2)
        if any(cell.strip() for cell in row)
    ]  # fmt: skip
    return _sorted(path, rows)


def _sorted(path: Path, rows: list[list[float]]) -> tuple[F64, F64]:
    if len({row[0] for row in rows}) < 2:
        raise InputError(
            f"{path.name} has {len(rows)} row{'' if len(rows) == 1 else 's'} of use; a line needs "
            "two amplitudes.",
            "Give steady speeds at two or more amplitudes, three for an error.",
        )
    table = np.array(sorted(rows))
    # Repeats of an amplitude stand for one row: their mean.
    amplitude = np.unique(table[:, 0])
    speed = np.array([table[table[:, 0] == one, 1].mean() for one in amplitude])
    return amplitude, speed


def _value(path: Path, number: int, column: str, cell: str) -> float:
    text = cell.strip()
    where = f"{path.name}, row {number}, column {column}"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: '{text}' is no finite number.", "Write it like 0.0791.")
    if value <= 0:
        raise InputError(
            f"{where}: {value:g} is not above 0.", "Leave out rows in which the fish did not swim."
        )
    if column == COLUMNS[0] and value >= math.pi / 2:
        raise InputError(
            f"{where}: a tail does not swing by {value:g} rad.", "Give radians; 45 degrees = 0.785."
        )
    return value
