"""What the model learns from: one swim, as amplitudes and the speeds they gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tailbeat.trial_log import Trial

Array = NDArray[np.float64]

SIGMA_M_S = 0.001  # of a beat's speed that tells none


@dataclass(frozen=True)
class Swim:
    """All arrays have one value per beat. ``amplitude_rad``: as the tail did it (saturated; 0 where
    the swim was over). ``speed_m_s``: measured over ground, NaN = not measured. ``sigma_m_s``: its
    standard deviation, the measurement's alone. ``reference_crc``, ``trial``: 0 = unknown.
    ``swum_beats``: how many were swum before an early end; None = all."""

    amplitude_rad: Array
    speed_m_s: Array
    sigma_m_s: Array
    beat_s: float = 1.0
    reference_crc: int = 0
    trial: int = 0
    iteration: int = 0
    battery_v: float | None = None
    swum_beats: int | None = None

    @property
    def beats(self) -> int:
        """Length of the swim."""
        return len(self.amplitude_rad)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Beats that have a speed."""
        return np.isfinite(self.speed_m_s)


def swim_of(trial: Trial) -> Swim:
    """From a trial's file. Beats after an early end have amplitude 0 and no speed."""
    beats = trial.beats
    swum = np.arange(len(beats.applied_rad)) < trial.executed_beats
    amplitude = np.where(swum & np.isfinite(beats.applied_rad), beats.applied_rad, 0.0)
    speed = np.where(swum, beats.speed_m_s, np.nan).astype(np.float64)
    known = np.isfinite(beats.sigma_m_s) & (beats.sigma_m_s > 0)
    sigma = np.where(known, beats.sigma_m_s, SIGMA_M_S).astype(np.float64)
    volts = [volt for _, volt in trial.battery_v]
    return Swim(
        amplitude_rad=amplitude.astype(np.float64),
        speed_m_s=speed,
        sigma_m_s=sigma,
        beat_s=trial.beat_s,
        reference_crc=trial.reference_crc,
        trial=trial.number,
        iteration=trial.iteration,
        battery_v=float(np.mean(volts)) if volts else None,
        swum_beats=None if swum.all() else trial.executed_beats,
    )


def last_input(swims: Sequence[Swim], beats: int) -> Array:
    """The amplitudes that were swum last, beat by beat, by ``swims`` of one reference: what lies
    beyond an early end is of an earlier swim, NaN where no swim came so far."""
    amplitude = np.full(beats, np.nan)
    for swim in swims:
        end = beats if swim.swum_beats is None else swim.swum_beats
        amplitude[:end] = swim.amplitude_rad[:end]
    return amplitude
