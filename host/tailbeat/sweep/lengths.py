"""How much of each trial is swum before something ends it: full, or drawn for each fish and trial.

A length belongs to (seed, trial), whatever was drawn before it, so that a fish is cut short in the
same trials with every law.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError

_REMEDY = "Write it like uniform:20,50 (beats) or uniform:44,58,50 (of 50 for a full trial)."


@dataclass(frozen=True)
class Lengths:
    """The trial would end after a time drawn evenly from ``low`` to ``high``; ``full`` of the same
    unit last as long as the reference, 0 = as many as it has beats."""

    low: float
    high: float
    full: float = 0.0

    def executed(self, seed: int, trial: int, beats: int) -> int:
        """Whole beats that trial ``trial`` (1 = the first) has of ``beats``."""
        drawn = self.low + _share(seed, trial) * (self.high - self.low)
        return min(beats, math.floor(drawn * beats / (self.full or beats)))


def parse(text: str) -> Lengths | None:
    """``""``: every trial is full (None). ``uniform:LOW,HIGH`` in beats, ``uniform:LOW,HIGH,FULL``
    where FULL is a full trial. Raises InputError for anything else."""
    if not text:
        return None
    kind, _, arguments = text.partition(":")
    try:
        values = [float(part) for part in arguments.split(",")]
    except ValueError:
        values = []
    if kind != "uniform" or len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise InputError(f"'{text}' is no length of trials.", _REMEDY)
    found = Lengths(*values)
    if not 0 <= found.low <= found.high or (len(values) == 3 and found.full <= 0):
        raise InputError(f"no trial is as long as '{text}'.", _REMEDY)
    return found


def executed(
    lengths: Lengths | None, seeds: Sequence[int], trial: int, beats: int
) -> NDArray[np.int64]:
    """Whole beats that each fish swims of ``beats`` in its trial ``trial``."""
    if lengths is None:
        return np.full(len(seeds), beats)
    return np.array([lengths.executed(seed, trial, beats) for seed in seeds])


def _share(seed: int, trial: int) -> float:
    """[0, 1), to 53 bits."""
    digest = hashlib.sha256(f"length {seed} {trial}".encode()).digest()
    return (int.from_bytes(digest[:8], "little") >> 11) * 2.0**-53
