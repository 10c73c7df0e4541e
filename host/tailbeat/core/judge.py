"""Which trials are judged and which is the best, by the board's own code (firmware/ilc/judge.h)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from tailbeat.core.arrays import F32
from tailbeat.core.native import ffi, lib


def counts(error_m_s: F32, complete: bool) -> bool:
    """Whether a trial is judged.

    Parameters
    ----------
    error_m_s : shape (beats,), NaN = not measured.
    complete : whether it was executed to its end.
    """
    return bool(lib.judge_counts(_Native(error_m_s).trial, complete))


def best_at(errors: Iterable[F32]) -> int | None:
    """Index of the best of trials that are judged, in the order they were executed; None = there
    are none. Their errors as for ``counts``."""
    best: int | None = None
    best_m_s = 0.0
    peaks = ffi.new("judge_peaks_t *")
    for at, error_m_s in enumerate(errors):
        native = _Native(error_m_s)
        if best is None or lib.judge_is_better(peaks, best_m_s, native.trial):
            best, best_m_s = at, max_abs(error_m_s)
            lib.judge_keep(peaks, native.trial)
    return best


def on_common_beats(one_m_s: F32, other_m_s: F32) -> tuple[float, float]:
    """max|e| of two trials on the beats that both measured; NaN when there are none."""
    common = np.isfinite(one_m_s) & np.isfinite(other_m_s)
    return max_abs(one_m_s[common]), max_abs(other_m_s[common])


def max_abs(error_m_s: F32) -> float:
    """Over the measured beats; NaN when there are none."""
    known = np.abs(error_m_s[np.isfinite(error_m_s)])
    return float(known.max()) if known.size else float("nan")


class _Native:
    """A trial as the C code takes it. Its arrays live as long as this."""

    def __init__(self, error_m_s: F32) -> None:
        self._error = np.ascontiguousarray(error_m_s, dtype=np.float32)
        self._measured = np.isfinite(self._error).view(np.uint8)
        self.trial: Any = ffi.new("law_trial_t *")
        self.trial.beats = self._error.size
        self._held = (
            ffi.from_buffer("float[]", self._error),
            ffi.from_buffer("uint8_t[]", self._measured),
        )
        self.trial.error_m_s, self.trial.measured = self._held
