"""How the fish's heading swung in a swim, as its IMU felt it: from the trial's file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat._native import lib
from tailbeat.errors import InputError
from tailbeat.trial_log import SLOT_S, Trial

Floats = NDArray[np.float64]

_BEATS_MIN = 5.0
# The IMU's own filter and rounding: somewhere between nothing and a servo frame; the wire comes
# on top of it.
_LATE_S = 0.010
LATE_SIGMA_S = 0.006
_BITS_PER_BYTE = 10


class Wobble:
    """The IMU's heading over time since the swim's begin: the sum of its turns at the ends of the
    slots, and a cubic spline through them (ten points per beat). Before the swim, and after it if
    the turns reach to its end, it stands still."""

    def __init__(self, trial: Trial) -> None:
        """Raises InputError when the file holds no turns."""
        turn = trial.slots.table()["turn_rad"]
        known = np.isfinite(turn)
        index = trial.slots.index[known].astype(int)
        swim_s = trial.executed_beats * trial.beat_s
        if len(index) * SLOT_S < _BEATS_MIN * trial.beat_s:
            raise InputError(
                f"the file of trial {trial.number} does not say how the fish turned",
                "Without an IMU, or with an older firmware, film the LED or say --start.",
            )
        self.beat_s = trial.beat_s
        self.end_s = (int(index.max()) + 1) * SLOT_S
        slots = np.full(int(index.max()) + 1, np.nan)
        slots[index] = turn[known]
        self._known = np.isfinite(slots)
        self._still_after = self.end_s > swim_s - 1.5 * SLOT_S
        heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(slots))])
        self._spline = CubicSpline(np.arange(len(heading)) * SLOT_S, heading)
        wire_s = _BITS_PER_BYTE * int(lib.NATIVE_IMU_FRAME_BYTES) / _baud(trial)
        self._late_s = _LATE_S + wire_s

    def heading_rad(self, t_s: Floats) -> Floats:
        """At times since the begin; unknown turns count as none."""
        return np.asarray(self._spline(np.clip(t_s + self._late_s, 0, self.end_s)))

    def known(self, t_s: Floats) -> NDArray[np.bool_]:
        """Whether the fish's turns are known then."""
        slot = np.clip((t_s / SLOT_S).astype(int), 0, len(self._known) - 1)
        after = (t_s >= self.end_s) & self._still_after
        return np.asarray((t_s < 0) | after | ((t_s < self.end_s) & self._known[slot]))


def _baud(trial: Trial) -> float:
    baud = trial.params.get("IMU_BAUD", 0.0)
    return baud if baud > 0 else 115200.0
