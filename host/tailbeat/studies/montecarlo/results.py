"""The columns of a Monte Carlo study's results, their Parquet files, what they depend on,
and the rows as arrays."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.extras import LazyModule, need

FAILED = "failed"  # the verdict on a fish that could not be identified or taught

TEXT_COLUMNS = ("plant", "law", "noise", "corner", "reference", "swum_law", "verdict", "failure")
_WHOLE = ("seed", "iteration", "saturated_beats", "measured_beats", "executed_beats")
_NUMBER = (
    "kappa_per_m",
    "max_abs_error_m_s",
    "true_max_abs_error_m_s",
    "input_max_abs_error_m_s",
    "rms_error_m_s",
    "true_rms_error_m_s",
    "floor_minimax_m_s",
    "floor_lsq_m_s",
    "predicted_floor_m_s",
    "predicted_max_abs_error_m_s",
    "predicted_low_m_s",
    "predicted_high_m_s",
    "ratio",
    "ratio_low",
    "ratio_high",
    "gain_rad_s_m",
    "lead_beats",
    "amplitude_min_rad",
    "amplitude_max_rad",
    "step_rad",
    "true_min_m_s",
    "true_max_m_s",
    "travel_m",
    "refuted",
)
DERIVED = ("near_bound", "ratio_inside", "prediction_inside", "floor_prediction_error")
NUMBER_COLUMNS = (*_NUMBER, *_WHOLE, *DERIVED)


def _needed(module: str) -> Any:
    return need(module, "export", "A sweep writes Parquet files and needs pyarrow")


pyarrow = LazyModule("pyarrow", lambda: _needed("pyarrow"))
parquet = LazyModule("pyarrow.parquet", lambda: _needed("pyarrow.parquet"))
Table = Any
"""A ``pyarrow.Table``."""


@cache
def schema() -> Any:
    """The ``pyarrow.Schema`` of the results."""
    return pyarrow.schema(
        [(name, pyarrow.string()) for name in TEXT_COLUMNS]
        + [(name, pyarrow.int64()) for name in _WHOLE]
        + [(name, pyarrow.float64()) for name in _NUMBER]
    )


@cache
def identity() -> dict[str, str]:
    """What must be the same wherever cells of one study are computed."""
    import numpy
    import scipy

    package = Path(__file__).parent.parent
    code = hashlib.sha256()
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".so"):
            code.update(path.relative_to(package).as_posix().encode())
            code.update(path.read_bytes())
    return {
        "tailbeat": version("tailbeat"),
        "code": code.hexdigest()[:16],
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "pyarrow": _needed("pyarrow").__version__,
    }


def to_bytes(table: Table) -> bytes:
    """A table of ``schema()`` as the bytes of a Parquet file."""
    out = io.BytesIO()
    parquet.write_table(table, out, compression="zstd")
    return out.getvalue()


Group = tuple[str, ...]

FISH = ("plant", "law", "noise", "corner")
GROUP = (*FISH, "reference")
_LATER = ("input_max_abs_error_m_s", "refuted")
_RANGES = (  # derived column, what is predicted, its 5 % and 95 %
    ("ratio_inside", "ratio", "ratio_low", "ratio_high"),
    ("prediction_inside", "max_abs_error_m_s", "predicted_low_m_s", "predicted_high_m_s"),
)
_NEAR_M_S = 0.0005  # and a tenth of the bound: an input as near as that is at its bound


@dataclass(frozen=True)
class Rows:
    """Columns of results as arrays of one length. A column of text holds places in its list in
    ``texts``; comparing texts row by row is slow."""

    columns: dict[str, NDArray[Any]]
    texts: dict[str, list[str]]

    @classmethod
    def of(cls, table: Table) -> Rows:
        """With the derived columns."""
        columns, texts = {}, {}
        for name in table.column_names:
            column = table[name].combine_chunks()
            if name in TEXT_COLUMNS:
                column = column.dictionary_encode()
                texts[name], column = column.dictionary.to_pylist(), column.indices
            columns[name] = column.to_numpy(zero_copy_only=False)
        for name in _LATER:  # results of earlier versions lack these
            columns.setdefault(name, np.full(table.num_rows, np.nan))
        for name, of, low, high in _RANGES:
            columns[name] = _inside(columns[of], columns[low], columns[high])
        near = 1.1 * columns["floor_minimax_m_s"] + _NEAR_M_S
        columns["near_bound"] = (columns["input_max_abs_error_m_s"] <= near).astype(np.float64)
        bound = columns["floor_lsq_m_s"]
        with np.errstate(invalid="ignore", divide="ignore"):  # a bound of 0 or none
            columns["floor_prediction_error"] = np.abs(columns["predicted_floor_m_s"] / bound - 1)
        return cls(columns, texts)

    def __len__(self) -> int:
        return len(self.columns["seed"])

    @property
    def failures(self) -> Rows:
        """One row of every fish that could not be identified or taught."""
        failed = self.select({"verdict": FAILED})
        keys = np.column_stack([failed.columns[name] for name in (*FISH, "seed")])
        return failed.where(np.sort(np.unique(keys, axis=0, return_index=True)[1]))

    def where(self, chosen: NDArray[Any]) -> Rows:
        """Some of them, by a mask or by places."""
        return Rows({name: all_[chosen] for name, all_ in self.columns.items()}, self.texts)

    def words(self, name: str) -> list[str]:
        """A column of text."""
        return [self.texts[name][place] for place in self.columns[name]]

    def select(self, wanted: dict[str, Any]) -> Rows:
        """Those whose columns have one of the values; ``word*``: that begin with it."""
        mask = np.ones(len(self), dtype=bool)
        for name, values in wanted.items():
            many = values if isinstance(values, list) else [values]
            begins = tuple(str(one)[:-1] for one in many if str(one).endswith("*"))
            chosen = [one in many or one.startswith(begins) for one in self.texts[name]]
            mask &= np.array(chosen, dtype=bool)[self.columns[name]]
        return self.where(mask)

    def of_fish(self, seeds: NDArray[Any]) -> Rows:
        """The rows of fish in that order, some perhaps more than once, each as a fish of its own;
        those of other fish are left out."""
        order = np.argsort(self.columns["seed"], kind="stable")
        there = self.columns["seed"][order]
        begin, end = np.searchsorted(there, seeds), np.searchsorted(there, seeds, "right")
        counts = end - begin
        places = np.repeat(begin - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        chosen = order[places]
        found = self.where(chosen)
        return Rows({**found.columns, "seed": np.repeat(np.arange(len(seeds)), counts)}, self.texts)

    def groups(self) -> Iterator[tuple[Group, Rows]]:
        """In the order in which they come."""
        if not len(self):
            return
        rows = np.column_stack([self.columns[name] for name in GROUP])
        keys, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        for i in np.argsort(first):
            key = tuple(self.texts[name][place] for name, place in zip(GROUP, keys[i], strict=True))
            yield key, self.where(which.ravel() == i)

    def grid(self, name: str) -> F64:
        """(fish, iterations) of a column of one group, iteration 0 first."""
        order = np.lexsort((self.columns["iteration"], self.columns["seed"]))
        fish = len(np.unique(self.columns["seed"]))
        found: F64 = self.columns[name][order].reshape(fish, -1).astype(np.float64)
        return found


def _inside(value: F64, low: F64, high: F64) -> F64:
    """1 or 0; NaN where any of them is not known."""
    inside = np.where((low <= value) & (value <= high), 1.0, 0.0)
    return np.where(np.isfinite(low + high + value), inside, np.nan)
