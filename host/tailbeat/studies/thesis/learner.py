"""The compiled laws in either precision: firmware/ilc and the slow plants, bound with cffi.

The memory laws of firmware/ilc/learner.h on numpy arrays, in double or in the board's float.
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
from tailbeat.core.native import HERE, Native, load_library

Precision = Literal["double", "float"]

_BITS = {"double": 64, "float": 32}


@cache
def load(precision: Precision = "double") -> Native:
    """The library whose ``number_t`` is ``precision``.

    Raises:
        NativeLibraryError: when it is not there or was built for another machine.
    """
    bits = _BITS[precision]
    return load_library(HERE / f"thesis{bits}.cdef", HERE / f"libtailbeat_thesis{bits}.so")


UNLIMITED = 1e30  # of inputs: LAW_LIMIT
PASTS = {"last": 0, "mean": 1, "window": 2}
HISTORIES = {"zero": 0, "first": 1, "none": 2}
TAILS = {"error": 0, "keep": 1, "hold-new": 2, "hold-old": 3}
_BAD_INPUT = 2


class LearnerRefused(TailbeatError):
    """The law does not fit the trial, or the trial diverged beyond what can be computed."""


@dataclass(frozen=True)
class LearnerConfig:
    """``learner_config_t``; fields and units as in ilc/law.h and ilc/learner.h.

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
        native = load(precision)
        self._ffi, self._lib = native.ffi, native.lib
        self.config = config
        self._number = "double" if precision == "double" else "float"
        made = self._native_config(config)
        size = self._lib.learner_bytes(made)
        self._memory = self._ffi.new("double[]", size // 8 + 1)  # aligned for either number
        self._learner = self._ffi.new("learner_t *")
        self._report = self._ffi.new("law_report_t *")
        start = (
            self._ffi.NULL
            if first is None
            else self._ffi.new(f"{self._number}[]", np.asarray(first, np.float64).tolist())
        )
        if first is not None and np.shape(first) != (config.samples,):
            raise LearnerRefused(
                f"{np.shape(first)} first inputs for {config.samples} samples.", "Give one of each."
            )
        if size == 0 or self._lib.learner_init(self._learner, made, start, self._memory, size):
            raise LearnerRefused(
                "the law does not fit the trial.",
                "Lead and filter must be shorter than it, every number finite.",
            )

    def _native_config(self, config: LearnerConfig) -> Any:
        law = {
            "kp_rad_s_m": config.kp,
            "kd_rad_s2_m": config.kd,
            "amplitude_min_rad": config.low,
            "amplitude_max_rad": config.high,
            "beat_s": config.step,
            "lead_beats": config.lead,
            "q_len": config.q_len,
            "tail": TAILS[config.tail],
        }
        made = self._ffi.new("learner_config_t *")
        made.law = law
        made.samples = config.samples
        made.past, made.history = PASTS[config.past], HISTORIES[config.history]
        made.window = len(config.weights)
        for j, (weight, kp, kd) in enumerate(config.weights):
            made.weight[j] = {"input": weight, "kp": kp, "kd": kd}
        return made

    def input(self) -> F64:
        """What the plant gets in the next trial, saturated; a new array."""
        values = np.empty(self.config.samples)
        self._lib.whole_trial_input(self._learner, self._pointer(values))
        return values

    def learn(self, error: ArrayLike, valid: int | None = None) -> None:
        """Ends a trial. ``error`` = wanted - measured, one per sample, NaN = not measured;
        samples from ``valid`` on (default: none) count as not measured, too.

        Raises:
            LearnerRefused: when the errors are too large to compute with; nothing is learned.
        """
        values = np.ascontiguousarray(error, dtype=np.float64)
        if values.shape != (self.config.samples,):
            raise LearnerRefused(
                f"{values.shape} errors for {self.config.samples} samples.", "Give one of each."
            )
        until = self.config.samples if valid is None else valid
        if self._lib.whole_trial_learn(self._learner, self._pointer(values), until, self._report):
            raise LearnerRefused(
                "the errors have grown beyond what can be computed with.", "The law diverges here."
            )

    def _pointer(self, values: F64) -> Any:
        return self._ffi.cast("double *", self._ffi.from_buffer(values))
