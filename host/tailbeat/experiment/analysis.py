"""Everything that is derived from an experiment's raw files: ``analysis.json``.

A pure function of ``raw/``, ``journal.jsonl`` and ``settings.json``, written so that the same
files give the same bytes on any machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.straight import Straightness
    from tailbeat.trial_log import Trial

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrialRow:
    """One swim. ``decision``: keep, repeat, discard, or empty when nobody decided (it counts as
    kept). ``repeat_of``: the first trial with the same amplitudes, 0 = this is the first.
    ``contraction``: max|e| over that of the last kept trial of the iteration before, NaN = none.
    ``learned``, ``rolled_back``: what the board did with it."""

    trial: int
    iteration: int
    end: str
    decision: str
    reason: str
    repeat_of: int
    max_abs_error_m_s: float
    rms_error_m_s: float
    measured_beats: int
    saturated_beats: int
    distance_m: float
    contraction: float
    learned: bool
    rolled_back: bool
    straight: Straightness | None
    battery_start_v: float
    battery_end_v: float
    input: str
    file: str
    time: str


@dataclass(frozen=True)
class Band:
    """Per iteration, over its swims that were not discarded: how many, median and 5 to 95 % band of
    max|e| and RMS; of one swim all three are the same. Shape (iterations,)."""

    iteration: NDArray[np.int64]
    swims: NDArray[np.int64]
    max_median_m_s: Floats
    max_low_m_s: Floats
    max_high_m_s: Floats
    rms_median_m_s: Floats
    rms_low_m_s: Floats
    rms_high_m_s: Floats


@dataclass(frozen=True)
class Analysis:
    """``rows``: every swim, discarded ones too, in the order they were swum. ``trials``: the same
    as read from the files. ``floor_m_s``: max|e| of the best input of the identified fish.
    ``noise_m_s``: standard deviation of max|e| between repeats, NaN = no repeats."""

    name: str
    simulated: bool
    board: str
    unique_id: str
    fish: str
    law: str
    reference_name: str
    reference_crc: int
    reference_m_s: Floats
    beat_s: float
    amplitude_max_rad: float
    conditions: dict[str, Any]
    rows: list[TrialRow]
    trials: list[Trial]
    band: Band
    floor_m_s: float
    floor_lsq_m_s: float
    noise_m_s: float
    start_error_m_s: float  # of the zero input: the reference's largest speed
    problems: list[str] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """As plain JSON values, without the trials' samples."""
        raise NotImplementedError


def analyse(experiment: Experiment) -> Analysis:
    """Reads and derives. Raises InputError: no trials, damaged raw files."""
    raise NotImplementedError


def write_analysis(experiment: Experiment) -> Path:
    """``analysis.json``."""
    raise NotImplementedError
