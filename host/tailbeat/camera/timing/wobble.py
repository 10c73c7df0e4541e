"""How the fish's heading swung in a swim, as its IMU felt it: from the trial's file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tailbeat._native import lib
from tailbeat.errors import InputError
from tailbeat.trial_log import SLOT_S, Trial

Floats = NDArray[np.float64]

BEATS_MIN = 5
# On top of the wire. A VN-100 filters nothing that is late: its output is the mean over just the
# time since its last one (register 85), from 800 Hz samples. The simulated one is a servo frame
# late (LAG_US in hal/sim/vn100_sense.c: its fish is known up to one frame ago). What a real one and
# its mounting add has not been measured. So anything from nothing to a servo frame, evenly: its
# middle, and its standard deviation; a simulated swim is found 10 ms too early.
_LATE_S = 0.010
LATE_SIGMA_S = 0.006
_BITS_PER_BYTE = 10


class Wobble:
    """The IMU's heading over time since the swim's begin: the sum of its turns at the ends of the
    slots, and a cubic spline through them (ten points per beat). Before the swim, and after it if
    the turns reach to its end, it stands still. The IMU tells it late: by its frame's way over the
    wire and 10 +- LATE_SIGMA_S more (half a servo frame: nothing in the data sheet, a whole one in
    the simulator)."""

    def __init__(self, trial: Trial) -> None:
        """Raises InputError when the file holds no turns or the swim was too short."""
        turn = trial.slots.table()["turn_rad"]
        known = np.isfinite(turn)
        index = trial.slots.index[known].astype(int)
        swim_s = trial.executed_beats * trial.beat_s
        if trial.executed_beats < BEATS_MIN:
            raise too_short(trial)
        if len(index) * SLOT_S < BEATS_MIN * trial.beat_s:
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


def too_short(trial: Trial) -> InputError:
    """That of a swim that was aborted before its wobble or LED tell anything."""
    beats = trial.executed_beats
    return InputError(
        f"trial {trial.number} swam only {beats} beat{'s' * (beats != 1)}: "
        "too short to be put in time with a film",
        "Say when the swim begins: --start.",
    )


def _baud(trial: Trial) -> float:
    baud = trial.params.get("IMU_BAUD", 0.0)
    return baud if baud > 0 else 115200.0
