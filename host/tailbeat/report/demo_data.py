"""What a report is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tailbeat.core.arrays import F32, F64


@dataclass(frozen=True)
class Swim:
    """One trial of the series. Arrays have shape (beats,); NaN = not measured."""

    iteration: int
    number: int
    speed_m_s: F32
    amplitude_rad: F32  # as swum
    max_abs_error_m_s: float
    rms_error_m_s: float
    saturated_beats: int
    distance_m: float
    end: str


@dataclass(frozen=True)
class Series:
    """A learned series with everything the report prints."""

    title: str
    subtitle: str
    simulated: bool
    reference_name: str
    reference_m_s: F32
    beat_s: float
    amplitude_max_rad: float
    start_error_m_s: float  # of iteration 0, the zero input: max of the reference
    floor_m_s: float | None
    floor_lsq_m_s: float | None
    swims: list[Swim]
    settings: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def mid_s(self) -> F64:
        """Middle of every beat, s."""
        return np.asarray((np.arange(len(self.reference_m_s)) + 0.5) * self.beat_s, np.float64)
