"""The columns of a Monte Carlo study's results, their Parquet files, and what they depend on."""

from __future__ import annotations

import hashlib
import io
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

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
        if path.suffix in (".py", ".so", ".cdef"):
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
