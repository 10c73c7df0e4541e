"""The LED's code as a waveform in time, from the firmware's own blink.h."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tailbeat._native import lib

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TICK_S = float(lib.NATIVE_FRAME_US) * 1e-6
SYMBOL_TICKS = int(lib.NATIVE_BLINK_SYMBOL_FRAMES)
BLOCK_SYMBOLS = int(lib.NATIVE_BLINK_BLOCK_FRAMES) // SYMBOL_TICKS
SYMBOL_S = SYMBOL_TICKS * TICK_S
NUMBERS = 256  # the code counts trials modulo this
REPEAT_S = 80.0  # and blocks modulo 16


@cache
def symbols(number: int, count: int) -> Bools:
    """The first ``count`` symbols of a swim of that trial, shape (count,)."""
    return np.array([lib.blink_on(SYMBOL_TICKS * i, number) for i in range(count)], dtype=bool)


@cache
def codebook(count: int) -> Bools:
    """Those of all trials, shape (NUMBERS, count)."""
    whole = round(REPEAT_S / SYMBOL_S)
    one = np.array([symbols(number, whole) for number in range(NUMBERS)])
    return np.tile(one, (1, -(-count // whole)))[:, :count]


@dataclass(frozen=True)
class Waveform:
    """The LED during a swim; ``lit_s`` is how long it has been on at each symbol's begin."""

    lit_s: Floats
    length_s: float

    @classmethod
    def of(cls, number: int, length_s: float) -> Waveform:
        """Of a swim of that trial and length."""
        on = codebook(max(1, int(np.ceil(length_s / SYMBOL_S - 1e-9))))[number]
        return cls(np.concatenate([[0.0], np.cumsum(on) * SYMBOL_S]), length_s)

    def lit(self, t_s: Floats, exposure_s: float) -> Floats:
        """Part (0..1) of exposures of that length in which it was on; ``t_s``: their middles, from
        the begin of the swim and well inside it."""
        edges_s = np.arange(len(self.lit_s)) * SYMBOL_S
        after = np.interp(t_s + exposure_s / 2, edges_s, self.lit_s)
        before = np.interp(t_s - exposure_s / 2, edges_s, self.lit_s)
        return np.asarray((after - before) / exposure_s)
