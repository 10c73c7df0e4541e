"""An experiment for other programs: CSV, MATLAB and Parquet. Units are in the column names."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.csv import spreadsheet_text
from tailbeat.core.errors import InputError
from tailbeat.core.extras import is_installed, need, remedy
from tailbeat.core.files import write_whole
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis, analyse, round_to
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow

PARQUET = "parquet"
FORMATS = ("csv", "mat", PARQUET)
_ARROW = "pyarrow"
_NEEDS_ARROW = "Writing Parquet files needs pyarrow"

_ROW_COLUMNS = (
    "epoch",
    "undecided",
    "file",
    "time",
    "input",
    "decision",
    "reason",
    "repeat_of",
    "complete",
    "learned",
    "rolled_back",
    "measured_beats",
    "saturated_beats",
    "distance_m",
    "contraction",
    "noise_low",
    "noise_high",
    "battery_start_v",
    "battery_end_v",
)
_STRAIGHT_COLUMNS = ("mean_yaw_rad", "worst_yaw_rad", "curvature_1_m")
# Of more than single precision: nine digits, for the last ones are another processor's own.
_COMPUTED = (
    "rms_error_m_s",
    "distance_m",
    "contraction",
    "noise_low",
    "noise_high",
    "noise_m_s",
    *_STRAIGHT_COLUMNS,
)
_MAT_COLUMNS = tuple(name for name in _ROW_COLUMNS if name != "time")
_MAT_HEAD_BYTES = 116
_MAKE_ROOM = "Make room on this computer, or choose another folder."

Table = dict[str, Any]


def export(
    experiment: Experiment, formats: Sequence[str] = (), folder: Path | None = None
) -> list[Path]:
    """Writes ``export/`` in the experiment's folder (or ``folder``) and returns the files: every
    trial, discarded ones too, with what was decided. The same experiment gives the same bytes.

    Parameters:
        formats: some of ``FORMATS``; none = all that can be written here (``missing_formats``).

    Raises:
        InputError: a format is unknown or needs a package that is not installed.
    """
    formats = formats or [name for name in FORMATS if name != PARQUET or is_installed(_ARROW)]
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise InputError(f"there is no format {unknown[0]}.", f"Use {', '.join(FORMATS)}.")
    analysis = analyse(experiment)
    if folder is None:
        folder = experiment.require_own(experiment.export_folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {folder}.", "Make the place writable.") from error
    tables = {
        "trials": _trial_table(analysis),
        "beats": _beat_table(analysis),
        "slots": _slot_table(analysis),
    }
    writers = {
        "csv": lambda: _csv_files(tables),
        "mat": lambda: {"trials.mat": _mat_file(analysis)},
        PARQUET: lambda: _parquet_files(tables),
    }
    paths = []
    for name, content in ((n, c) for one in formats for n, c in writers[one]().items()):
        paths.append(folder / name)
        write_whole(paths[-1], content, _MAKE_ROOM)
    return paths


def missing_formats() -> str:
    """What ``export`` leaves out by itself here, why, and what to do; empty when it is nothing."""
    if is_installed(_ARROW):
        return ""
    return f"Parquet files were left out: they need pyarrow. {remedy('export')}"


def _trial_table(analysis: Analysis) -> Table:
    """One row per trial. What older tools wrote comes first, in their order."""
    rows = [
        _trial_row(trial, row, analysis)
        for trial, row in zip(analysis.trials, analysis.rows, strict=True)
    ]
    return {key: [row[key] for row in rows] for key in rows[0]}


def _trial_row(trial: Trial, row: TrialRow, analysis: Analysis) -> Table:
    straight = row.straight
    found = {
        "trial": trial.number,
        "iteration": trial.iteration,
        "end": trial.end,
        "executed_beats": trial.executed_beats,
        "max_abs_error_m_s": trial.max_abs_error_m_s(),
        "rms_error_m_s": row.rms_error_m_s,
        "reference_crc": f"{trial.reference_crc:08x}",
        "board": trial.board,
        "build_id": trial.build_id,
        **{name: getattr(row, name) for name in _ROW_COLUMNS},
        **{name: getattr(straight, name, math.nan) for name in _STRAIGHT_COLUMNS},
        "straight_source": straight.source if straight is not None else "",
        "crooked": straight is not None and straight.crooked,
        "noise_m_s": analysis.noise_m_s,
        "noise_freedom": analysis.noise_freedom,
        "simulated": analysis.simulated,
    }
    return found | {name: round_to(found[name]) for name in _COMPUTED}


def _beat_table(analysis: Analysis) -> Table:
    """One row per trial and beat."""
    trials = analysis.trials
    beats = [len(trial.beats.samples) for trial in trials]
    table: Table = {
        "trial": np.repeat([trial.number for trial in trials], beats),
        "iteration": np.repeat([trial.iteration for trial in trials], beats),
        "beat": np.concatenate([np.arange(count) for count in beats]),
    }
    columns = [trial.beats.table() for trial in trials]
    table |= {name: np.concatenate([held[name] for held in columns]) for name in columns[0]}
    return table | _beside(analysis, beats)


def _slot_table(analysis: Analysis) -> Table:
    """One row per trial and 0.1 s of measured speed."""
    trials = analysis.trials
    counts = [len(trial.slots.index) for trial in trials]
    tables = [trial.slots.table() for trial in trials]
    return {
        "trial": np.repeat([trial.number for trial in trials], counts),
        **{name: np.concatenate([table[name] for table in tables]) for name in tables[0]},
        **_beside(analysis, counts),
    }


def _beside(analysis: Analysis, counts: list[int]) -> Table:
    """What is the same along a trial, so that each table can be read alone."""
    return {
        "file": np.repeat([row.file for row in analysis.rows], counts),
        "epoch": np.repeat([row.epoch for row in analysis.rows], counts),
        "decision": np.repeat([row.decision for row in analysis.rows], counts),
        "simulated": np.repeat([analysis.simulated for _ in counts], counts),
    }


def _csv_files(tables: dict[str, Table]) -> dict[str, bytes]:
    files = {}
    for name, table in tables.items():
        text = io.StringIO()
        out = csv.writer(text, lineterminator="\n")
        out.writerow(table)
        out.writerows(map(_cells, zip(*table.values(), strict=True)))
        files[f"{name}.csv"] = text.getvalue().encode()
    return files


def _cells(row: tuple[Any, ...]) -> list[Any]:
    cells = []
    for value in row:
        if isinstance(value, float | np.floating):
            cells.append("" if np.isnan(value) else repr(float(value)))
        else:
            cells.append(spreadsheet_text(value) if isinstance(value, str) else value)
    return cells


def _mat_file(analysis: Analysis) -> bytes:
    """Matrices of shape (trials, beats), filled up with NaN, and vectors per trial."""
    from scipy.io import savemat

    trials = analysis.trials
    beats = max(len(trial.beats.samples) for trial in trials)
    content: Table = {
        "trial": np.array([trial.number for trial in trials], dtype=np.float64),
        "iteration": np.array([trial.iteration for trial in trials], dtype=np.float64),
        "max_abs_error_m_s": np.array([trial.max_abs_error_m_s() for trial in trials]),
        "end": np.array([trial.end for trial in trials], dtype=object),
    }
    columns = [trial.beats.table() for trial in trials]
    for name in columns[0]:
        matrix = np.full((len(trials), beats), np.nan)
        for i, held in enumerate(columns):
            matrix[i, : len(held[name])] = held[name]
        content[name] = matrix
    table = _trial_table(analysis)
    for name in (*_MAT_COLUMNS, *_COMPUTED):
        words = isinstance(table[name][0], str)
        content[name] = np.array(table[name], dtype=object if words else np.float64)
    content["noise_freedom"] = float(analysis.noise_freedom)
    content["simulated"] = float(analysis.simulated)
    file = io.BytesIO()
    savemat(file, content, oned_as="column", do_compression=True)
    return _headed(file.getvalue(), analysis)


def _headed(content: bytes, analysis: Analysis) -> bytes:
    """scipy puts the time of making into the text that a MATLAB file begins with."""
    simulated = ", simulated" if analysis.simulated else ""
    text = f"MATLAB 5.0 MAT-file, tailbeat{simulated}".encode("ascii")
    return text.ljust(_MAT_HEAD_BYTES) + content[_MAT_HEAD_BYTES:]


def _parquet_files(tables: dict[str, Table]) -> dict[str, bytes]:
    arrow = need(_ARROW, "export", _NEEDS_ARROW)
    parquet = need("pyarrow.parquet", "export", _NEEDS_ARROW)
    files = {}
    for name in sorted(tables):
        file = io.BytesIO()
        parquet.write_table(arrow.table(tables[name]), file)
        files[f"{name}.parquet"] = file.getvalue()
    return files
