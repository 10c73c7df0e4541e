"""Finds the board's blinking LED in a film: the trial's number, and when the trial began.

First a matched filter for the code, at every place, begin (in 20 ms steps) and number at once. The
codes of all 256 numbers are combinations of 13 waveforms, so that 13 correlations do for all.

Then the begin is fitted to all edges of the code. Between two pictures nothing is seen; a picture
in whose exposure the LED went on or off is half bright. At 25 or 60 pictures a second and 20 ms a
tick, all edges may fall into one or two places between pictures, so that a stretch of begins
explains the film equally well: the answer is the mean over all begins and exposures, by their
likelihood, and its sigma holds that stretch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.core.native import lib
from tailbeat.sensors.camera.tracking.track import Track
from tailbeat.sensors.camera.tracking.tracker import LedPatch

fft = lazy("scipy.fft")
ndimage = lazy("scipy.ndimage")
special = lazy("scipy.special")

Bools = NDArray[np.bool_]

TICK_S = float(lib.NATIVE_FRAME_US) * 1e-6
SYMBOL_TICKS = int(lib.NATIVE_BLINK_SYMBOL_FRAMES)
BLOCK_SYMBOLS = int(lib.NATIVE_BLINK_BLOCK_FRAMES) // SYMBOL_TICKS
SYMBOL_S = SYMBOL_TICKS * TICK_S
NUMBERS = 256  # the code counts trials modulo this
REPEAT_S = 80.0  # and blocks modulo 16


@cache
def codebook(count: int) -> Bools:
    """Those of all trials, shape (NUMBERS, count)."""
    whole = round(REPEAT_S / SYMBOL_S)
    one = np.array(
        [
            [lib.blink_on(SYMBOL_TICKS * i, number) for i in range(whole)]
            for number in range(NUMBERS)
        ],
        dtype=bool,
    )
    return np.tile(one, (1, -(-count // whole)))[:, :count]


@dataclass(frozen=True)
class Waveform:
    """The LED during a trial; ``lit_s`` is how long it has been on at each symbol's begin."""

    lit_s: F64
    length_s: float

    @classmethod
    def of(cls, number: int, length_s: float) -> Waveform:
        """Of a trial of that trial and length."""
        on = codebook(max(1, int(np.ceil(length_s / SYMBOL_S - 1e-9))))[number]
        return cls(np.concatenate([[0.0], np.cumsum(on) * SYMBOL_S]), length_s)

    def lit(self, t_s: F64, exposure_s: float) -> F64:
        """Part (0..1) of exposures of that length in which it was on; ``t_s``: their middles, from
        the begin of the trial and well inside it."""
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
    """``series``: which row of ``series_of``. ``begin_s`` of the trial, within 20 ms. ``strength``:
    of the matched filter, in standard deviations of what it gives for noise."""

    series: int
    begin_s: float
    number: int
    strength: float


def series_of(patch: LedPatch) -> NDArray[np.uint8]:
    """Brightness over time at every place, shape (places, pictures), against what is usual for each
    cell (_USUAL); the brightest of 2 x 2 cells, because an LED at the edge of a cell is now in one
    and now in the next."""
    cells = patch.astype(np.int16)
    cells -= np.median(cells, axis=0).astype(np.int16) - _USUAL
    bright = np.clip(cells, 0, 255).astype(np.uint8)
    pooled = ndimage.maximum_filter(bright, size=(1, 2, 2))[:, 1:, 1:]
    return np.ascontiguousarray(pooled.reshape(len(patch), -1).T)


def find(series: NDArray[np.uint8], t_s: F64, length_s: float | None, beat_s: float) -> Find | None:
    """The code in one of ``series``, shape (places, pictures) at times ``t_s``; None = nothing
    there that changes. ``length_s`` of the trial: None = not known."""
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
    if not found:
        return None
    strength, row, begin, number = max(found)
    after = begin - size if begin > size - bank.shape[1] else begin  # before the first picture
    return Find(row, begin_s + after * TICK_S, number % NUMBERS, strength)


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
    """How many pictures fall into the trial, for every begin."""
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
        for begin in np.argpartition(energy[row], -_STEPS_PER_SERIES)[-_STEPS_PER_SERIES:]:
            strength = codes @ parts[:, row, begin] * scale[begin]
            number = int(np.argmax(strength))
            found.append((float(strength[number]), int(series), int(begin), number))
    return found


_EXPOSURE_MIN_S = 0.001
# What part of the exposure is needed to be seen at all (beside something bright), and what part to
# be as bright as can be (saturated).
_RESPONSES = ((0.0, 1.0), (0.25, 1.0), (0.5, 1.0), (0.0, 0.5), (0.0, 0.15), (0.2, 0.5))
_MARGIN_S = 0.08  # of the trial's begin and end, which are not fitted
_STRAY = 0.05  # pictures that show anything
_LEVELS = 256
_NOISE_MIN = 3.0
_SIGMA_MIN_S = 0.0005
_PHOTOMETRY = 0.08  # how well half a brightness is known, of the whole
# All edges fall into few places between the pictures, so that they err together (a response that is
# not straight): so many count as independent.
_EDGES_BELIEVED = 12.0


@dataclass(frozen=True)
class LedBrightness:
    """How bright the place is: dark and lit, with standard deviations; ``hidden`` is the part of
    the pictures in which a lit LED cannot be seen, ``otherwise`` how likely each level is then."""

    dark: float
    dark_sigma: float
    lit: float
    lit_sigma: float
    hidden: float
    otherwise: F64

    def log_likelihood(self, bright: NDArray[np.uint8], lit: F64) -> F64:
        """Of levels, when the LED was on for these parts of the exposures."""
        mean = self.dark + (self.lit - self.dark) * lit
        bend = _PHOTOMETRY * (self.lit - self.dark)
        sigma = np.sqrt(
            self.dark_sigma**2 + (self.lit_sigma * lit) ** 2 + bend**2 * 4 * lit * (1 - lit)
        )
        seen = np.exp(-0.5 * ((bright - mean) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        return np.asarray(
            np.log((1 - self.hidden) * seen + self.hidden * self.otherwise[bright] + 1e-12)
        )


@dataclass(frozen=True)
class LedReading:
    """``begin_s``: the track's time at which frame 0 of the trial began. ``score``: pictures in
    which the LED is seen on while it is, less those while it is not. ``ahead``: log likelihood
    ratio of ``number`` to the next."""

    begin_s: float
    sigma_s: float
    score: float
    number: int = 0
    ahead: float = 0.0


def looks_of(bright: NDArray[np.uint8], lit: F64) -> tuple[LedBrightness, float]:
    """From pictures whose state is known, with the score."""
    off = bright[lit == 0].astype(float)
    on = bright[lit == 1].astype(float)
    dark = float(np.median(off))
    dark_sigma = max(_NOISE_MIN, 1.4826 * float(np.median(np.abs(off - dark))))
    middle = (dark + float(np.quantile(on, 0.9))) / 2
    clear = on[on > middle] if np.any(on > middle) else on
    level = float(np.median(clear))
    lit_sigma = max(_NOISE_MIN, 1.4826 * float(np.median(np.abs(clear - level))))
    counts = np.bincount(bright[lit == 0], minlength=_LEVELS) / len(off)
    otherwise = (1 - _STRAY) * np.convolve(counts, np.ones(7) / 7, "same") + _STRAY / _LEVELS
    score = float(np.mean(on > middle) - np.mean(off > middle))
    hidden = float(np.clip(np.mean(on <= middle), _STRAY, 0.98))
    return LedBrightness(dark, dark_sigma, level, lit_sigma, hidden, otherwise), score


# What is tried: begins up to so far from the first guess, their step, and that of exposures, s.
_Grid = tuple[float, float, float]
_ROUGH: _Grid = (0.04, 0.004, 0.02)
_FINE: _Grid = (0.025, 0.001, 0.0025)


def fit(
    bright: NDArray[np.uint8], t_s: F64, wave: Waveform, begin_s: float, grid: _Grid
) -> tuple[LedReading, LedBrightness] | None:
    """The begin near ``begin_s``, which is right within the grid's reach; ``bright``: the LED's
    place, shape (pictures,), at times ``t_s``. None = never both on and off."""
    since_s = t_s - begin_s
    inside = (since_s > _MARGIN_S) & (since_s < wave.length_s - _MARGIN_S)
    bright, since_s = bright[inside], since_s[inside]
    sure = wave.lit(since_s, 2 * TICK_S + 0.02).round(9)
    if not (np.any(sure == 0) and np.any(sure == 1)):
        return None
    looks, score = looks_of(bright, sure)
    reach_s, step_s, exposure_step_s = grid
    shifts = np.arange(-reach_s, reach_s + step_s / 2, step_s)
    period_s = float(np.median(np.diff(t_s)))
    exposures = np.arange(_EXPOSURE_MIN_S, period_s, exposure_step_s)
    fits = np.empty((len(shifts), len(exposures) * len(_RESPONSES)))
    for i, shift in enumerate(shifts):
        lit = [wave.lit(since_s - shift, exposure) for exposure in exposures]
        looking = [_seen_as(part, *response) for part in lit for response in _RESPONSES]
        fits[i] = [float(looks.log_likelihood(bright, part).sum()) for part in looking]
    edges = max(1, int(np.count_nonzero(np.diff(np.round(wave.lit(since_s, TICK_S))))))
    fits *= min(1.0, _EDGES_BELIEVED / edges)
    chance = np.exp(special.logsumexp(fits, axis=1) - special.logsumexp(fits))
    mean = float(chance @ shifts)
    spread = float(np.sqrt(chance @ (shifts - mean) ** 2 + step_s**2 / 12))
    return LedReading(begin_s + mean, max(spread, _SIGMA_MIN_S), score), looks


def _seen_as(lit: F64, from_part: float, to_part: float) -> F64:
    """How bright exposures look that are lit so far: the response rises from one to the other."""
    rise: F64 = (lit - from_part) / (to_part - from_part)
    return np.asarray(np.clip(rise, 0, 1))


_STRENGTH_MIN = 7.0  # noise alone gives 5 to 6
_AHEAD_MIN = 20.0  # of all other numbers, as a log likelihood ratio
_SCORE_MIN = 0.15
_ROUNDS = 4  # begin, number and length each make the others better
_CLEAR_S = 0.02  # pictures so far from an edge show one symbol only


def read_led(track: Track, length_s: float | None = None, beat_s: float = 1.0) -> LedReading:
    """What the LED says. ``length_s`` of the trial, None = not known. Raises InputError when there
    is none to be seen, or its number cannot be read."""
    if track.patch is None:
        raise InputError(
            f"{track.name}: nobody looked for the LED in this track",
            "Track the film again, with the LED.",
        )
    seen = track.seen()
    t_s = track.t_s[seen]
    series = series_of(track.patch[seen])
    found = find(series, t_s, length_s, beat_s) if len(t_s) > 1 else None
    if found is None or found.strength < _STRENGTH_MIN:
        raise _no_led(track)
    reading = _reading(series[found.series], t_s, found, length_s)
    if reading is None or reading.score < _SCORE_MIN:
        raise _no_led(track)
    if reading.ahead < _AHEAD_MIN:
        raise InputError(
            f"{track.name}: if an LED blinks, too little of it is seen to read its number",
            "Film the whole trial with the LED in view, or say --start.",
        )
    return reading


def _reading(
    bright: NDArray[np.uint8], t_s: F64, found: Find, length_s: float | None
) -> LedReading | None:
    number, begin_s = found.number, found.begin_s
    known_s = length_s or max(REPEAT_S, float(t_s[-1]) - found.begin_s)
    for _ in range(_ROUNDS):
        result = fit(bright, t_s, Waveform.of(number, known_s), begin_s, _ROUGH)
        if result is None:
            return None
        begin_s, looks = result[0].begin_s, result[1]
        best, ahead = _read_number(bright, t_s - begin_s, known_s, looks)
        before, number = (number, known_s), best
        if length_s is None:
            known_s = _length_s(bright, t_s - begin_s, number, looks)
        if before == (number, known_s):
            break
    result = fit(bright, t_s, Waveform.of(number, known_s), begin_s, _FINE)
    if result is None:
        return None
    return replace(result[0], number=number, ahead=ahead)


def _read_number(
    bright: NDArray[np.uint8], since_s: F64, length_s: float, looks: LedBrightness
) -> tuple[int, float]:
    """The number that the symbols say, and its log likelihood ratio to the next; the numbers of
    trials that began whole blocks earlier or later count as others."""
    phase = since_s % SYMBOL_S
    clear = (since_s > 0) & (since_s < length_s)
    clear &= (phase > _CLEAR_S) & (phase < SYMBOL_S - _CLEAR_S)
    ones = np.ones(np.count_nonzero(clear))
    by_lit = looks.log_likelihood(bright[clear], ones)
    by_dark = looks.log_likelihood(bright[clear], 0 * ones)
    whole = round(REPEAT_S / SYMBOL_S)
    evidence = np.zeros(whole)
    np.add.at(evidence, (since_s[clear] / SYMBOL_S).astype(int) % whole, by_lit - by_dark)
    likely = np.array(
        [codebook(whole) @ np.roll(evidence, shift) for shift in range(0, whole, BLOCK_SYMBOLS)]
    )
    number = int(np.argmax(likely[0]))
    others = likely.copy()
    others[0, number] = -np.inf
    return number, float(likely[0, number] - others.max())


def _length_s(bright: NDArray[np.uint8], since_s: F64, number: int, looks: LedBrightness) -> float:
    """How long the code explains the pictures better than a lamp that is on now and then."""
    inside = since_s > 0
    since_s, bright = since_s[inside], bright[inside]
    whole = Waveform.of(number, max(REPEAT_S, float(since_s[-1]) + SYMBOL_S))
    lit = np.round(whole.lit(since_s, SYMBOL_S / 4))
    part = float(lit.mean())
    by_code = looks.log_likelihood(bright, lit)
    ones = np.ones_like(lit)
    by_chance = np.logaddexp(
        np.log(part) + looks.log_likelihood(bright, ones),
        np.log(1 - part) + looks.log_likelihood(bright, 0 * ones),
    )
    last = int(np.argmax(np.cumsum(by_code - by_chance)))
    return float(np.ceil(since_s[last] / SYMBOL_S) * SYMBOL_S)


def _no_led(track: Track) -> InputError:
    return InputError(
        f"{track.name}: no LED blinks the code of a trial",
        "Is it in view, and was the fish swimming? Otherwise say --start.",
    )
