"""The compiled laws in either precision and the slow plants, bound with cffi.

The memory laws of host/native/thesis/learner.h on numpy arrays, in double or in the board's float.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.errors import TailbeatError
from tailbeat.core.law import PAST_KINDS
from tailbeat.core.native import Native, load_library

Precision = Literal["double", "float"]

_BITS = {"double": 64, "float": 32}


@cache
def load(precision: Precision = "double") -> Native:
    """The library whose ``number_t`` is ``precision``.

    Raises:
        NativeLibraryError: when it is not there or was built for another machine.
    """
    return load_library(f"thesis{_BITS[precision]}")


def pointer(native: Native, values: F64 | None) -> Any:
    """``double *`` to the array's own numbers; NULL for None."""
    return native.ffi.NULL if values is None else native.ffi.from_buffer("double[]", values)


UNLIMITED = 1e30  # of inputs: LAW_LIMIT
HISTORIES = {"zero": 0, "first": 1, "none": 2}
TAILS = {"error": 0, "keep": 1, "hold-new": 2, "hold-old": 3}


class LearnerRefused(TailbeatError):
    """The law does not fit the trial, or the trial diverged beyond what can be computed."""


@dataclass(frozen=True)
class LearnerConfig:
    """``buffer_learner_config_t``; fields and units as in ilc/law.h and learner.h.

    ``weights``: for ``past="window"``, newest first, (input, kp, kd) each; their number is the
    window. ``step`` is the sample period, ``lead`` whole or half samples.
    """

    samples: int
    step: float = 1.0
    kp: float = 0.0
    kd: float = 0.0
    lead: float = 0.0
    q_len: int = 1
    tail: str = "keep"
    low: float = -UNLIMITED
    high: float = UNLIMITED
    past: str = "last"
    history: str = "zero"
    weights: Sequence[tuple[float, float, float]] = field(default=())

    def native(self) -> dict[str, Any]:
        """As the struct's fields."""
        law = {
            "kp_rad_s_m": self.kp, "kd_rad_s2_m": self.kd, "amplitude_min_rad": self.low,
            "amplitude_max_rad": self.high, "beat_s": self.step, "lead_beats": self.lead,
            "q_len": self.q_len, "tail": TAILS[self.tail],
        }  # fmt: skip
        return {
            "law": law, "samples": self.samples, "past": PAST_KINDS[self.past].number,
            "history": HISTORIES[self.history], "window": len(self.weights),
            "weight": [dict(zip(("input", "kp", "kd"), one, strict=True)) for one in self.weights],
        }  # fmt: skip


class Learner:
    """One learner; memory of its own. Not for threads.

    Raises:
        LearnerRefused: from the constructor, when the config does not hold together.
    """

    def __init__(
        self,
        config: LearnerConfig,
        first: ArrayLike | None = None,
        precision: Precision = "double",
    ):
        self._native = load(precision)
        ffi, lib = self._native.ffi, self._native.lib
        self.config = config
        made = ffi.new("buffer_learner_config_t *", config.native())
        size = lib.buffer_learner_bytes(made)
        self._memory = ffi.new("double[]", size // 8 + 1)  # aligned for either number
        self._learner = ffi.new("buffer_learner_t *")
        self._report = ffi.new("law_report_t *")
        start = ffi.NULL
        if first is not None:
            start = ffi.new(f"{precision}[]", self._samples(first, "first inputs").tolist())
        if size == 0 or lib.buffer_learner_init(self._learner, made, start, self._memory, size):
            raise LearnerRefused(
                "the law does not fit the trial.",
                "Lead and filter must be shorter than it, every number finite.",
            )

    def input(self) -> F64:
        """What the plant gets in the next trial, saturated; a new array."""
        values = np.empty(self.config.samples)
        self._native.lib.whole_trial_input(self._learner, pointer(self._native, values))
        return values

    def learn(self, error: ArrayLike, valid: int | None = None) -> None:
        """Ends a trial. ``error`` = reference - measured, one per sample, NaN = not measured;
        samples from ``valid`` on (default: none) count as not measured, too.

        Raises:
            LearnerRefused: when the errors are too large to compute with; nothing is learned.
        """
        values = pointer(self._native, self._samples(error, "errors"))
        until = self.config.samples if valid is None else valid
        if self._native.lib.whole_trial_learn(self._learner, values, until, self._report):
            raise LearnerRefused(
                "the errors have grown beyond what can be computed with.", "The law diverges here."
            )

    def _samples(self, given: ArrayLike, what: str) -> F64:
        values = np.ascontiguousarray(given, dtype=np.float64)
        if values.shape != (self.config.samples,):
            raise LearnerRefused(
                f"{values.shape} {what} for {self.config.samples} samples.", "Give one of each."
            )
        return values
