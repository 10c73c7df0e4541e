"""An experiment for other programs: CSV, MATLAB and Parquet. Units are in the column names."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.errors import InputError
from tailbeat.experiment.folder import Experiment
from tailbeat.trial_log import Trial

FORMATS = ("csv", "mat", "parquet")

_BEAT_COLUMNS = (
    "amplitude_rad",
    "applied_rad",
    "reference_m_s",
    "speed_m_s",
    "sigma_m_s",
    "error_m_s",
    "samples",
)


def export(experiment: Experiment, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Writes ``export/`` in the experiment's folder and returns the files."""
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise InputError(f"there is no format {unknown[0]}.", f"Use {', '.join(FORMATS)}.")
    trials = experiment.trials()
    if not trials:
        raise InputError(
            f"{experiment.name} holds no trials.", "Pull some: tailbeat trial pull --into FOLDER"
        )
    folder = experiment.export_folder
    folder.mkdir(exist_ok=True)
    writers = {"csv": _write_csv, "mat": _write_mat, "parquet": _write_parquet}
    return [path for name in formats for path in writers[name](folder, trials)]


def _trial_row(trial: Trial) -> dict[str, Any]:
    return {
        "trial": trial.number,
        "iteration": trial.iteration,
        "end": trial.end,
        "executed_beats": trial.executed_beats,
        "max_abs_error_m_s": trial.max_abs_error_m_s(),
        "rms_error_m_s": trial.rms_error_m_s(),
        "reference_crc": f"{trial.reference_crc:08x}",
        "board": trial.board,
        "build_id": trial.build_id,
    }


def _beat_table(trials: Sequence[Trial]) -> dict[str, Any]:
    """One row per trial and beat."""
    beats = [len(trial.beats.samples) for trial in trials]
    table: dict[str, Any] = {
        "trial": np.repeat([trial.number for trial in trials], beats),
        "iteration": np.repeat([trial.iteration for trial in trials], beats),
        "beat": np.concatenate([np.arange(count) for count in beats]),
    }
    for name in _BEAT_COLUMNS:
        table[name] = np.concatenate([getattr(trial.beats, name) for trial in trials])
    return table


def _slot_table(trials: Sequence[Trial]) -> dict[str, Any]:
    """One row per trial and 0.1 s of measured speed."""
    counts = [len(trial.slots.index) for trial in trials]
    tables = [trial.slots.table() for trial in trials]
    return {
        "trial": np.repeat([trial.number for trial in trials], counts),
        **{name: np.concatenate([table[name] for table in tables]) for name in tables[0]},
    }


def _write_csv(folder: Path, trials: Sequence[Trial]) -> list[Path]:
    rows = [_trial_row(trial) for trial in trials]
    summary = {key: [row[key] for row in rows] for key in rows[0]}
    tables = {"trials": summary, "beats": _beat_table(trials), "slots": _slot_table(trials)}
    paths = []
    for name, table in tables.items():
        path = folder / f"{name}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(table)
            out.writerows(map(_cells, zip(*table.values(), strict=True)))
        paths.append(path)
    return paths


def _cells(row: tuple[Any, ...]) -> list[Any]:
    cells = []
    for value in row:
        if isinstance(value, float | np.floating):
            cells.append("" if np.isnan(value) else repr(float(value)))
        else:
            cells.append(value)
    return cells


def _write_mat(folder: Path, trials: Sequence[Trial]) -> list[Path]:
    """Matrices of shape (trials, beats), filled up with NaN, and vectors per trial."""
    from scipy.io import savemat

    beats = max(len(trial.beats.samples) for trial in trials)
    content: dict[str, Any] = {
        "trial": np.array([trial.number for trial in trials], dtype=np.float64),
        "iteration": np.array([trial.iteration for trial in trials], dtype=np.float64),
        "max_abs_error_m_s": np.array([trial.max_abs_error_m_s() for trial in trials]),
        "rms_error_m_s": np.array([trial.rms_error_m_s() for trial in trials]),
        "end": np.array([trial.end for trial in trials], dtype=object),
    }
    for name in _BEAT_COLUMNS:
        matrix = np.full((len(trials), beats), np.nan)
        for i, trial in enumerate(trials):
            values = getattr(trial.beats, name)
            matrix[i, : len(values)] = values
        content[name] = matrix
    path = folder / "trials.mat"
    savemat(path, content, oned_as="column", do_compression=True)
    return [path]


def _write_parquet(folder: Path, trials: Sequence[Trial]) -> list[Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    paths = []
    for name, table in (("beats", _beat_table(trials)), ("slots", _slot_table(trials))):
        path = folder / f"{name}.parquet"
        pq.write_table(pa.table(table), path)
        paths.append(path)
    return paths
