"""The tables of an experiment: trials, beats, slots. Units are the last part of a column's name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis, round_to
from tailbeat.experiment.trial_rows import TrialRow

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

Table = dict[str, Any]


def tables_of(analysis: Analysis) -> dict[str, Table]:
    """All tables of an experiment.

    Parameters
    ----------
    analysis : Analysis
        The experiment.

    Returns
    -------
    dict of str to dict
        ``trials``, ``beats`` (one row per trial and beat) and ``slots`` (one row per trial and
        0.1 s); each is a dict of columns.
    """
    return {
        "trials": trial_table(analysis),
        "beats": _beat_table(analysis),
        "slots": _slot_table(analysis),
    }


def trial_table(analysis: Analysis) -> Table:
    """One row per trial. The columns of older tools come first, in their order."""
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
