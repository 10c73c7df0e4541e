"""An experiment as a MATLAB file."""

from __future__ import annotations

import io

import numpy as np

from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.export_tables import Table, trial_table
from tailbeat.experiment.units import units_of

_HEAD_BYTES = 116
_NAMES = {"end": "trial_end"}  # ``end`` is a keyword of MATLAB
_LEFT_OUT = ("time",)


def mat_file(analysis: Analysis) -> bytes:
    """Write the trials as a MATLAB 5.0 file, the same bytes each time.

    Parameters
    ----------
    analysis : Analysis
        The experiment.

    Returns
    -------
    bytes
        Matrices of shape (trials, beats), filled up with NaN, columns of shape (trials, 1), and the
        struct ``units``: the unit of each variable that has one.
    """
    from scipy.io import savemat

    content = {**_columns(analysis), **_matrices(analysis.trials)}
    content["units"] = units_of(content)
    file = io.BytesIO()
    savemat(file, content, oned_as="column", do_compression=True)
    return _headed(file.getvalue(), analysis)


def _columns(analysis: Analysis) -> Table:
    """One value per trial: numbers, or text as a cell array."""
    return {
        _NAMES.get(name, name): np.array(
            values, dtype=object if isinstance(values[0], str) else np.float64
        )
        for name, values in trial_table(analysis).items()
        if name not in _LEFT_OUT
    }


def _matrices(trials: list[Trial]) -> Table:
    beats = max(len(trial.beats.samples) for trial in trials)
    columns = [trial.beats.table() for trial in trials]
    found = {}
    for name in columns[0]:
        matrix = np.full((len(trials), beats), np.nan)
        for i, held in enumerate(columns):
            matrix[i, : len(held[name])] = held[name]
        found[name] = matrix
    return found


def _headed(content: bytes, analysis: Analysis) -> bytes:
    """scipy puts the time of making into the text that a MATLAB file begins with."""
    simulated = ", simulated" if analysis.simulated else ""
    text = f"MATLAB 5.0 MAT-file, tailbeat{simulated}".encode("ascii")
    return text.ljust(_HEAD_BYTES) + content[_HEAD_BYTES:]
