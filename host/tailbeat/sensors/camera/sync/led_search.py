"""The LED's code as a waveform in time, from the firmware's own blink.h.

Finds the blinking LED: where around the fish, since when, and which trial's number it shows.

A matched filter for the code, at every place, begin (in 20 ms steps) and number at once. The codes
of all 256 numbers are combinations of 13 waveforms, so that 13 correlations do for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.core.lazy import lazy
from tailbeat.core.native import lib
from tailbeat.sensors.camera.tracking.tracker import Glow

fft = lazy("scipy.fft")
ndimage = lazy("scipy.ndimage")

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

    lit_s: F64
    length_s: float

    @classmethod
    def of(cls, number: int, length_s: float) -> Waveform:
        """Of a swim of that trial and length."""
        on = codebook(max(1, int(np.ceil(length_s / SYMBOL_S - 1e-9))))[number]
        return cls(np.concatenate([[0.0], np.cumsum(on) * SYMBOL_S]), length_s)

    def lit(self, t_s: F64, exposure_s: float) -> F64:
        """Part (0..1) of exposures of that length in which it was on; ``t_s``: their middles, from
        the begin of the swim and well inside it."""
        edges_s = np.arange(len(self.lit_s)) * SYMBOL_S
        after = np.interp(t_s + exposure_s / 2, edges_s, self.lit_s)
        before = np.interp(t_s - exposure_s / 2, edges_s, self.lit_s)
        return np.asarray((after - before) / exposure_s)


_USUAL = 32
_SLOW_S = 2.0  # what changes slower than this is no code: the sun, a wandering glare
_CLIP = 2.5  # of a series' standard deviation
_STEPS_PER_SERIES = 8  # candidates for the begin that are looked at with all numbers
_COMB_BEATS = 4
_CHUNK = 16
_PICTURES_MIN = 50  # of the swim in the film


@dataclass(frozen=True)
class Find:
    """``series``: which row of ``series_of``. ``begin_s`` of the swim, within 20 ms. ``strength``:
    of the matched filter, in standard deviations of what it gives for noise."""

    series: int
    begin_s: float
    number: int
    strength: float


def series_of(glow: Glow) -> NDArray[np.uint8]:
    """Brightness over time at every place, shape (places, pictures), against what is usual for each
    cell (_USUAL); the brightest of 2 x 2 cells, because an LED at the edge of a cell is now in one
    and now in the next."""
    cells = glow.astype(np.int16)
    cells -= np.median(cells, axis=0).astype(np.int16) - _USUAL
    bright = np.clip(cells, 0, 255).astype(np.uint8)
    pooled = ndimage.maximum_filter(bright, size=(1, 2, 2))[:, 1:, 1:]
    return np.ascontiguousarray(pooled.reshape(len(glow), -1).T)


def find(series: NDArray[np.uint8], t_s: F64, length_s: float | None, beat_s: float) -> Find | None:
    """The code in one of ``series``, shape (places, pictures) at times ``t_s``; None = nothing
    there that changes. ``length_s`` of the swim: None = not known."""
    begin_s = float(t_s[0])
    span_s = float(t_s[-1]) - begin_s
    length_s = max(REPEAT_S, span_s) if length_s is None else length_s
    bank, codes = _bank(max(1, round(length_s / SYMBOL_S)))
    at = np.round((t_s - begin_s) / TICK_S).astype(int)
    size = fft.next_fast_len(int(at[-1]) + 1 + bank.shape[1], real=True)
    spectra = np.conj(fft.rfft(bank, size))
    overlap = _overlap(at, bank.shape[1], size)
    alive = np.flatnonzero(np.ptp(series, axis=1) > 0)
    found: list[tuple[float, int, int, int]] = []
    for first in range(0, len(alive), _CHUNK):
        chosen = alive[first : first + _CHUNK]
        ticks = _on_ticks(_flat(series[chosen].astype(np.float32), t_s), at, size)
        ticks = _without_beat(ticks, at, beat_s)
        found += _best(ticks, spectra, codes, overlap, chosen)
    return _decide(found, size, bank.shape[1], begin_s) if found else None


@cache
def _bank(count: int) -> tuple[F32, F32]:
    """Orthonormal waveforms over ticks, shape (13, ticks), and what each number's code has of them,
    shape (NUMBERS, 13)."""
    signs = codebook(count).astype(np.float32) * 2 - 1
    signs -= signs.mean()
    weights, sizes, shapes = np.linalg.svd(signs, full_matrices=False)
    rank = int(np.count_nonzero(sizes > 1e-4 * sizes[0]))
    bank = np.repeat(shapes[:rank], SYMBOL_TICKS, axis=1)
    return bank.astype(np.float32), (weights[:, :rank] * sizes[:rank]).astype(np.float32)


def _flat(series: F32, t_s: F64) -> F32:
    """Without what is slow, of variance one, and without outliers."""
    half = max(1, round(_SLOW_S / 2 / float(np.median(np.diff(t_s)))))
    total = np.cumsum(np.pad(series, ((0, 0), (1, 0))), axis=1, dtype=np.float64)
    count = series.shape[1]
    low = np.maximum(np.arange(count) - half, 0)
    high = np.minimum(np.arange(count) + half + 1, count)
    rest = series - (total[:, high] - total[:, low]) / (high - low)
    rest /= np.maximum(rest.std(axis=1, keepdims=True), 1e-6)
    rest = np.clip(rest, -_CLIP, _CLIP)
    rest /= np.maximum(rest.std(axis=1, keepdims=True), 1e-6)
    return np.asarray(rest, dtype=np.float32)


def _on_ticks(rest: F32, at: NDArray[np.int_], size: int) -> F32:
    ticks = np.zeros((len(rest), size), dtype=np.float32)
    for row, values in zip(ticks, rest, strict=True):
        np.add.at(row, at, values)
    return ticks


def _without_beat(ticks: F32, at: NDArray[np.int_], beat_s: float) -> F32:
    """Less what is the same from beat to beat: the tail's shade is brighter than many an LED."""
    size = ticks.shape[1]
    present = np.bincount(at, minlength=size).astype(np.float32)
    comb = np.zeros(size, dtype=np.float32)
    steps = np.arange(-_COMB_BEATS, _COMB_BEATS + 1) * beat_s / TICK_S
    np.add.at(comb, np.round(steps).astype(int) % size, 1)
    shape = fft.rfft(comb)
    sums = fft.irfft(fft.rfft(ticks) * shape, size)
    counts = np.maximum(fft.irfft(fft.rfft(present) * shape, size).round(), 1)
    return np.asarray(ticks - present * sums / counts, dtype=np.float32)


def _overlap(at: NDArray[np.int_], length: int, size: int) -> F64:
    """How many pictures fall into the swim, for every begin."""
    present = np.bincount(at, minlength=size).astype(float)
    window = np.zeros(size)
    window[:length] = 1
    return np.asarray(fft.irfft(fft.rfft(present) * np.conj(fft.rfft(window)), size).round())


def _best(
    ticks: F32,
    spectra: NDArray[np.complex64],
    codes: F32,
    overlap: F64,
    chosen: NDArray[np.int_],
) -> list[tuple[float, int, int, int]]:
    """(strength, series, begin in ticks, number): the best begins of each series, each with its
    best number. A code's mean square is about 1."""
    transformed = fft.rfft(ticks)
    size = ticks.shape[1]
    parts = np.stack([fft.irfft(transformed * shape, size) for shape in spectra])
    scale = np.where(overlap >= _PICTURES_MIN, 1 / np.sqrt(np.maximum(overlap, 1)), 0)
    scale = scale.astype(np.float32)
    energy = np.einsum("kst,kst->st", parts, parts) * scale**2
    found = []
    for row, series in enumerate(chosen):
        for begin in _peaks(energy[row]):
            strength = codes @ parts[:, row, begin] * scale[begin]
            number = int(np.argmax(strength))
            found.append((float(strength[number]), int(series), int(begin), number))
    return found


def _peaks(energy: F64) -> NDArray[np.int_]:
    return np.argpartition(energy, -_STEPS_PER_SERIES)[-_STEPS_PER_SERIES:]


def _decide(
    found: list[tuple[float, int, int, int]], size: int, length: int, film_begin_s: float
) -> Find:
    strength, series, begin, number = max(found)
    ticks = begin - size if begin > size - length else begin  # before the film's first picture
    return Find(series, film_begin_s + ticks * TICK_S, number % NUMBERS, strength)
