"""What the board remembers between trials, by the C code the board runs (firmware/ilc/memory.h and
past.h), bit for bit: dry run, replay and predictions learn with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.law import LAST, Averaging, Law, LawReport, refused, update_counts
from tailbeat.core.native import ffi, lib
from tailbeat.core.records import fill_peaks

_MASK = "uint8_t[]"


@dataclass(frozen=True)
class Memory:
    """The content of a board's memory. Amplitudes in rad, shape (beats,)."""

    iteration: int
    amplitude_rad: F32
    best_iteration: int  # 0 = no best yet
    best_rad: F32
    best_max_abs_error_m_s: float
    worse_streak: int
    visits: NDArray[np.uint8] | None = None  # None: none
    peaks: F32 | None = None  # Fish.peaks; None: not known


@dataclass(frozen=True)
class PastTrial:
    """A trial that was learned from, or the mean of ``trials`` of them, as the board keeps it."""

    amplitude_rad: F32  # as executed
    error_m_s: F32  # NaN = not measured
    trials: int = 1


class LawMemory:
    """A board's memory, and the earlier trials that an averaging law includes. ``rolled_back``:
    the last trial was worse often enough, the best amplitudes are back."""

    def __init__(self, beats: int) -> None:
        self.beats = beats
        self.rolled_back = False
        self._whole: Any = ffi.new("law_memory_t *")
        self._memory: Any = ffi.addressof(self._whole, "memory")
        self._past: Any = ffi.addressof(self._whole, "past")
        self._report: Any = ffi.new("memory_report_t *")
        self._scratch: Any = ffi.new("float[]", beats)
        self._input = np.frombuffer(ffi.buffer(self._memory.amplitude_rad), np.float32)[:beats]
        lib.memory_begin(self._memory, 1, beats)
        lib.learn_past_begin(self._past, LAST, 2)

    @classmethod
    def of(
        cls, held: Memory, averaging: Averaging | None = None, earlier: Sequence[PastTrial] = ()
    ) -> LawMemory:
        """The memory with this content. ``earlier``: with a moving average the trials it includes,
        newest first; with a mean that of all of them. Raises InputError."""
        made = cls(len(held.amplitude_rad))
        native, beats = made._memory, made.beats
        for name in ("iteration", "best_iteration", "worse_streak"):
            setattr(native, name, getattr(held, name))
        native.best_max_abs_error_m_s = held.best_max_abs_error_m_s
        native.amplitude_rad[0:beats] = held.amplitude_rad.tolist()
        native.visits[0:beats] = update_counts(held.visits, beats)
        if held.best_iteration:
            native.best_rad[0:beats] = held.best_rad.tolist()
        if held.peaks is not None:
            fill_peaks(native.peaks, held.peaks)
        made.average(averaging or Averaging())
        made._past.trials = sum(one.trials for one in earlier)
        for slot, one in enumerate(reversed(earlier)):
            measured = np.isfinite(one.error_m_s)
            kept = made._past.trial[slot]
            kept.amplitude_rad[0:beats] = one.amplitude_rad.tolist()
            kept.error_m_s[0:beats] = np.where(measured, one.error_m_s, 0).tolist()
            kept.measured[0:beats] = measured.astype(int).tolist()
        return made

    def copy(self) -> LawMemory:
        """Another one with the same content."""
        other = LawMemory(self.beats)
        ffi.memmove(other._whole, self._whole, ffi.sizeof("law_memory_t"))
        return other

    @property
    def amplitude_rad(self) -> F32:
        """The input of the next trial, unsaturated, shape (beats,)."""
        return self._input.copy()

    def first(self, law: Law, reference_m_s: ArrayLike) -> None:
        """Begins anew: the law applied to the zero input, whose error is the reference. Without the
        step limit, as on the board. Raises InputError."""
        lib.memory_begin(self._memory, 1, self.beats)
        self.forget()
        values = ffi.from_buffer("float[]", np.ascontiguousarray(reference_m_s, dtype=np.float32))
        refused(lib.memory_first(self._memory, law.native(ffi), values, self._scratch))

    @property
    def report(self) -> LawReport:
        """Of the last trial that was learned from."""
        found = self._report.law
        return LawReport(*(getattr(found, field.name) for field in fields(LawReport)))

    def set_input(self, amplitude_rad: ArrayLike, iteration: int) -> None:
        """Amplitudes that came in another way than from the law."""
        values = np.asarray(amplitude_rad, dtype=np.float32)
        self._memory.amplitude_rad[0 : self.beats] = values.tolist()
        self._memory.iteration = iteration

    def restore_best(self) -> None:
        """The best amplitudes are the next ones."""
        lib.memory_restore_best(self._memory)

    def average(self, averaging: Averaging) -> None:
        """What is learned from; earlier trials are forgotten when that changes. Raises
        InputError."""
        if (self._past.kind, self._past.window) == (averaging.kind, averaging.window):
            return
        if not lib.learn_past_begin(self._past, averaging.kind, averaging.window):
            raise InputError(
                f"there is no law that learns from kind {averaging.kind}, window "
                f"{averaging.window}.",
                "Kinds are 0, 1 and 2, windows 2 to 8.",
            )

    def forget(self) -> None:
        """Drops the earlier trials."""
        lib.learn_past_begin(self._past, self._past.kind, self._past.window)

    def learn(
        self,
        law: Law,
        error_m_s: ArrayLike,
        measured: ArrayLike,
        complete: bool,
        rollback_ratio: float = 0.0,
        extrapolation: int = 0,
    ) -> None:
        """Learns from a trial. ``complete``: it may become the best. ``extrapolation``: ILC_EXTRAP.
        Raises InputError when the law refuses it; nothing has been learned then."""
        errors = np.ascontiguousarray(error_m_s, dtype=np.float32)
        mask = np.ascontiguousarray(measured, dtype=np.uint8)
        if len(errors) != self.beats or len(mask) != self.beats:
            raise InputError(
                f"{len(errors)} errors are no trial of {self.beats} beats.", "Give one per beat."
            )
        rows = ffi.from_buffer("float[]", errors), ffi.from_buffer(_MASK, mask)
        rules = complete, rollback_ratio, extrapolation
        refused(lib.law_memory_learn(self._whole, law.native(ffi), *rows, *rules, self._report))
        self.rolled_back = bool(self._report.rolled_back)


class LawMemories:
    """The memories of several fish that learn along the same reference, each by its own law."""

    def __init__(
        self, laws: Sequence[Law], reference_m_s: ArrayLike, averaging: Averaging | None = None
    ) -> None:
        """Each begins as ``LawMemory.first`` does. Raises InputError."""
        beats = len(np.asarray(reference_m_s))
        begun = LawMemory(beats)
        begun.average(averaging or Averaging())
        self._memories: Any = ffi.new("law_memory_t[]", len(laws))
        self._laws: Any = ffi.new("law_t[]", [vars(law) for law in laws])
        self._rolled_back: Any = ffi.new(_MASK, len(laws))
        size = ffi.sizeof("law_memory_t")
        for index, law in enumerate(laws):
            begun.first(law, reference_m_s)
            ffi.memmove(self._memories + index, begun._whole, size)
        self._input = np.ndarray(
            (len(laws), beats), np.float32, ffi.buffer(self._memories),
            ffi.offsetof("law_memory_t", "memory", "amplitude_rad"), (size, 4),
        )  # fmt: skip

    @property
    def amplitude_rad(self) -> F32:
        """The inputs of the next trials, unsaturated, shape (fish, beats)."""
        return self._input.copy()

    def learn(
        self, error_m_s: F32, measured: NDArray[np.bool_], complete: NDArray[np.bool_],
        rollback_ratio: float = 0.0,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Learns from a trial of each, shapes (fish, beats), (fish, beats) and (fish,), as
        ``LawMemory.learn``; a fish of which nothing was measured learns nothing. Returns which of
        them had the best amplitudes brought back, shape (fish,). Raises InputError."""
        shape = self._input.shape
        if (error_m_s.shape, measured.shape, complete.shape) != (shape, shape, shape[:1]):
            raise InputError(
                f"errors of shape {error_m_s.shape} are no trials of {len(self._laws)} fish.",
                "Give one per fish and beat.",
            )
        errors = np.ascontiguousarray(error_m_s, dtype=np.float32)
        masks = [np.ascontiguousarray(one, dtype=np.uint8) for one in (measured, complete)]
        rows = [ffi.from_buffer("float[]", errors), *(ffi.from_buffer(_MASK, one) for one in masks)]
        laws, back = self._laws, self._rolled_back
        learn = lib.law_memory_learn_all
        refused(learn(self._memories, laws, len(laws), *rows, rollback_ratio, back))
        return np.frombuffer(ffi.buffer(back), np.bool_).copy()


def first_amplitudes(law: Law, reference_m_s: ArrayLike) -> F32:
    """The amplitudes of iteration 1, shape (beats,), rad. Raises InputError."""
    return LawMemories([law], reference_m_s).amplitude_rad.ravel()
