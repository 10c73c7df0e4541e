"""What is known of one fish: its model, models as likely, how its trials scatter. A JSON file.

A fish from a table of steady speeds: the thesis's drag coefficient, and a line through the rows.

A cruising fish no longer speeds up, so (8.3)-(8.13) leave F = alpha*v**2 with F = H1 - H2*v**2. How
fast it gets there, and how late its thrust comes, no steady speed can tell: those are assumed, over
a range that the answers stand for.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from datetime import datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.csv import read_rows, value_of
from tailbeat.core.decode import convert, read
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain, replace_file
from tailbeat.core.reference import THESIS_PLATEAU_M_S
from tailbeat.learning.fish_model import NUMBERS, PARAMS, FishModel, TrialSpeeds
from tailbeat.learning.fit import Prior, vector_of
from tailbeat.learning.scatter import Scatter

_FORMAT = "tailbeat identified 1"
_REMEDY = "Identify the fish: tailbeat session identify --out FILE"


@dataclass(frozen=True)
class Identified:
    """``models``: the bootstrap's, at least one. ``covariance``: as in Fit, or 4 x 4.
    ``scatter``: how trials differ. ``assumed``: names of ``FishModel`` fields that no data spoke of
    (a table of steady speeds tells nothing of kappa and delay). ``source``: ``table``, ``runs``,
    ``trials`` or ``none`` (any fish). ``alpha_kg_m``: the thesis's drag coefficient by (8.5)-(8.13)
    where steady speeds are known."""

    model: FishModel
    models: list[FishModel]
    covariance: F64
    scatter: Scatter = field(default_factory=Scatter)
    source: str = "runs"
    assumed: tuple[str, ...] = ()
    unique_id: str = ""
    made: str = ""
    alpha_kg_m: float | None = None
    trials: list[TrialSpeeds] = field(default_factory=list)

    @property
    def whole_covariance(self) -> F64:
        """Of all numbers: where only the first four were identified, as by earlier versions and
        from a table, the shape is known no better than of any fish."""
        known = np.asarray(self.covariance, dtype=np.float64)
        whole = Prior().covariance
        whole[: len(known), : len(known)] = known
        return whole

    @property
    def band(self) -> dict[str, tuple[float, float]]:
        """95 % interval of every field of the model, from the bootstrap."""
        rows = {name: [getattr(m, name) for m in self.models] for name in vars(self.model)}
        low_high = {n: np.percentile(values, [2.5, 97.5]) for n, values in rows.items()}
        return {name: (float(low), float(high)) for name, (low, high) in low_high.items()}

    def as_dict(self) -> dict[str, Any]:
        """What the file holds: JSON types, SI units; NaN as null."""
        names = ("unique_id", "made", "source", "assumed", "alpha_kg_m", "model", "band")
        count = len(self.covariance)
        models = [list(asdict(model).values())[:count] for model in self.models]
        values = {name: getattr(self, name) for name in (*names, "covariance", "scatter")}
        found: dict[str, Any] = plain(
            {"format": _FORMAT, **values, "models": models, "swims": self.trials}
        )
        return found

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all, and so that it lasts."""
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n")

    @classmethod
    def from_dict(cls, raw: dict[str, Any]) -> Identified:
        """Of what ``as_dict`` gave. Raises InputError."""
        return convert(raw, cls, "the identified fish", _REMEDY, prepare=_checked)

    @classmethod
    def load(cls, path: Path) -> Identified:
        """Raises InputError when it is not there or damaged."""
        return read(path, cls, _REMEDY, prepare=_checked)


def any_fish() -> Identified:
    """What is known of a fish before anything was measured of it: the usual one, and how fish
    differ."""
    usual = Prior()
    return Identified(
        usual.model, [usual.model], usual.covariance, source="none", assumed=tuple(NUMBERS)
    )


def now_text() -> str:
    """The local time, for ``made``."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def _checked(raw: dict[str, Any]) -> dict[str, Any]:
    """With models by the names of their numbers. Raises KeyError, TypeError or ValueError."""
    if raw["format"] != _FORMAT:
        raise ValueError(f"this is no identified fish, its format is {raw['format']}")
    models = [dict(zip(NUMBERS[: len(row)], row, strict=True)) for row in raw["models"]]
    covariance = np.array(raw["covariance"], dtype=np.float64)
    numbers = [*covariance.ravel(), *(v for m in (raw["model"], *models) for v in m.values())]
    if (
        len(covariance) not in (len(PARAMS), len(NUMBERS))
        or not models
        or not all(map(math.isfinite, numbers))
    ):
        raise ValueError("its numbers make no model")
    return raw | {"models": models, "trials": raw["swims"]}


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
class SpeedLine:
    """speed = slope*(amplitude - dead zone); ``rms_m_s`` over the rows it was drawn through."""

    slope_m_s_rad: float
    dead_zone_rad: float
    rms_m_s: float


@dataclass(frozen=True)
class SpeedTable:
    """What a table of steady speeds tells. Arrays: shape (rows,), by rising amplitude.

    ``gain_min_m_s_rad``/``gain_max_m_s_rad``: the flattest and the steepest piece between
    neighbouring rows. ``thesis_m_s``: the speeds (8.13) settles at with ``alpha_kg_m``.
    """

    amplitude_rad: F64
    speed_m_s: F64
    fish: ThesisFish
    alpha_kg_m: float
    line: SpeedLine
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
            "cannot tell: kappa and delay are assumed until runs are executed."
        )

    def rows(self) -> list[dict[str, float]]:
        """One per row, with what the line and the thesis's model miss it by."""
        line = self.identified.model.steady_m_s(self.amplitude_rad)
        columns = {
            "amplitude_rad": self.amplitude_rad,
            "speed_m_s": self.speed_m_s,
            "line_m_s": line,
            "line_residual_m_s": self.speed_m_s - line,
            "thesis_m_s": self.thesis_m_s,
            "thesis_residual_m_s": self.speed_m_s - self.thesis_m_s,
        }
        values = np.column_stack(list(columns.values())).tolist()
        return [dict(zip(columns, row, strict=True)) for row in values]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; keys end in their unit."""
        names = (
            "alpha_kg_m", "kappa_thesis_per_m", "note", "gain_min_m_s_rad", "gain_max_m_s_rad",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names} | {
            "source": "table",
            "coast_thesis_s": self.coast_s,
            "slope_m_s_rad": self.line.slope_m_s_rad,
            "dead_zone_rad": self.line.dead_zone_rad,
            "line_rms_m_s": self.line.rms_m_s,
            "assumed": {name: getattr(self.identified.model, name) for name in ASSUMED},
            "band": self.identified.band,
            "rows": self.rows(),
        }


def from_table(path: Path, fish: ThesisFish | None = None) -> SpeedTable:
    """Reads ``amplitude_rad,speed_m_s`` (steady cruise) and identifies the fish as far as that
    goes. Raises InputError, one line, for a table that cannot be one."""
    return identify_table(*read_steady_speeds(path), fish, path.name)


def identify_table(
    amplitude_rad: F64, speed_m_s: F64, fish: ThesisFish | None = None, name: str = "the table"
) -> SpeedTable:
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
    return SpeedTable(
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


def _line(amplitude: F64, speed: F64) -> SpeedLine:
    """Least squares; through the origin when the dead zone would come out below 0."""
    offset, slope = np.polynomial.polynomial.polyfit(amplitude, speed, 1)
    if offset > 0:
        offset, slope = 0.0, amplitude @ speed / (amplitude @ amplitude)
    rms = float(np.sqrt(np.mean((speed - offset - slope * amplitude) ** 2)))
    return SpeedLine(float(slope), float(-offset / slope) if slope else 0.0, rms)


def _identified(amplitude: F64, speed: F64, line: SpeedLine, alpha_kg_m: float) -> Identified:
    """Every assumed kappa and delay with the line and each line that leaves one row out."""
    lines = [line, *_jackknife(amplitude, speed)]
    models = [
        FishModel(kappa, one.slope_m_s_rad, one.dead_zone_rad, delay)
        for kappa, delay, one in product(KAPPA_PER_M, DELAY_S, lines)
    ]
    model = FishModel(KAPPA_PER_M[1], line.slope_m_s_rad, line.dead_zone_rad, DELAY_S[1])
    return Identified(
        model=model,
        models=models,
        covariance=np.cov(np.array([vector_of(one)[: len(PARAMS)] for one in models]).T),
        source="table",
        assumed=ASSUMED,
        made=now_text(),
        alpha_kg_m=alpha_kg_m,
    )


def _jackknife(amplitude: F64, speed: F64) -> list[SpeedLine]:
    if len(amplitude) < 3:
        return []
    kept = [np.arange(len(amplitude)) != k for k in range(len(amplitude))]
    lines = [_line(amplitude[rows], speed[rows]) for rows in kept]
    return [one for one in lines if one.slope_m_s_rad > 0]


def read_steady_speeds(path: Path) -> tuple[F64, F64]:
    """(amplitude_rad, speed_m_s) of a table, by rising amplitude; rows of one amplitude stand for
    their mean. Raises InputError."""
    cells = [
        [_positive(path.name, number, *one) for one in zip(COLUMNS, row, strict=True)]
        for number, row in read_rows(path, COLUMNS)
    ]
    table = np.array(sorted(cells))
    amplitude = np.unique(table[:, 0])
    if len(amplitude) < 2:
        raise InputError(
            f"{path.name} has {len(table)} row{'s'[: len(table) != 1]} of use; a line needs "
            "two amplitudes.",
            "Give steady speeds at two or more amplitudes, three for an error.",
        )
    return amplitude, np.array([table[table[:, 0] == one, 1].mean() for one in amplitude])


def _positive(name: str, number: int, column: str, cell: str) -> float:
    value = value_of(name, number, column, cell)
    where = f"{name}, row {number}, column {column}"
    if value <= 0:
        raise InputError(
            f"{where}: {value:g} is not above 0.", "Leave out rows in which the fish did not swim."
        )
    if column == COLUMNS[0] and value >= math.pi / 2:
        raise InputError(
            f"{where}: a tail does not swing by {value:g} rad.", "Give radians; 45 degrees = 0.785."
        )
    return value
