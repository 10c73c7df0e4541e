"""When exactly the swim began, by all the edges of the LED's code.

Between two pictures nothing is seen; a picture in whose exposure the LED went on or off is half
bright. At 25 or 60 pictures a second and 20 ms a tick, all edges may fall into one or two places
between pictures, so that a stretch of begins explains the film equally well: the answer is the mean
over all begins and exposures, by their likelihood, and its sigma holds that stretch.

When the swim began, by the LED: reads the code, then fits its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.lazy import lazy
from tailbeat.sensors.camera.sync.led_search import (
    BLOCK_SYMBOLS,
    REPEAT_S,
    SYMBOL_S,
    TICK_S,
    Find,
    Waveform,
    codebook,
    find,
    series_of,
)
from tailbeat.sensors.camera.tracking.track import Track

special = lazy("scipy.special")

_EXPOSURE_MIN_S = 0.001
# What part of the exposure is needed to be seen at all (beside something bright), and what part to
# be as bright as can be (saturated).
_RESPONSES: tuple[tuple[float, float], ...] = (
    (0.0, 1.0),
    (0.25, 1.0),
    (0.5, 1.0),
    (0.0, 0.5),
    (0.0, 0.15),
    (0.2, 0.5),
)
_MARGIN_S = 0.08  # of the swim's begin and end, which are not fitted
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
class LedFit:
    """``score``: pictures in which the LED is seen on while it is, less those while it is not."""

    begin_s: float
    sigma_s: float
    score: float


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


@dataclass(frozen=True)
class LedGrid:
    """Begins (from the first guess) and exposures that are tried."""

    reach_s: float
    step_s: float
    exposure_step_s: float


ROUGH, FINE = LedGrid(0.04, 0.004, 0.02), LedGrid(0.025, 0.001, 0.0025)


def fit(
    bright: NDArray[np.uint8], t_s: F64, wave: Waveform, begin_s: float, grid: LedGrid
) -> tuple[LedFit, LedBrightness] | None:
    """The begin near ``begin_s``, which is right within the grid's reach; ``bright``: the LED's
    place, shape (pictures,), at times ``t_s``. None = never both on and off."""
    since_s = t_s - begin_s
    inside = (since_s > _MARGIN_S) & (since_s < wave.length_s - _MARGIN_S)
    bright, since_s = bright[inside], since_s[inside]
    sure = wave.lit(since_s, 2 * TICK_S + 0.02).round(9)
    if not (np.any(sure == 0) and np.any(sure == 1)):
        return None
    looks, score = looks_of(bright, sure)
    shifts = np.arange(-grid.reach_s, grid.reach_s + grid.step_s / 2, grid.step_s)
    period_s = float(np.median(np.diff(t_s)))
    exposures = np.arange(_EXPOSURE_MIN_S, period_s, grid.exposure_step_s)
    fits = np.empty((len(shifts), len(exposures) * len(_RESPONSES)))
    for i, shift in enumerate(shifts):
        lit = [wave.lit(since_s - shift, exposure) for exposure in exposures]
        looking = [_seen_as(part, *response) for part in lit for response in _RESPONSES]
        fits[i] = [float(looks.log_likelihood(bright, part).sum()) for part in looking]
    edges = max(1, int(np.count_nonzero(np.diff(np.round(wave.lit(since_s, TICK_S))))))
    fits *= min(1.0, _EDGES_BELIEVED / edges)
    chance = np.exp(special.logsumexp(fits, axis=1) - special.logsumexp(fits))
    mean = float(chance @ shifts)
    spread = float(np.sqrt(chance @ (shifts - mean) ** 2 + grid.step_s**2 / 12))
    return LedFit(begin_s + mean, max(spread, _SIGMA_MIN_S), score), looks


def _seen_as(lit: F64, from_part: float, to_part: float) -> F64:
    """How bright exposures look that are lit so far: the response rises from one to the other."""
    rise: F64 = (lit - from_part) / (to_part - from_part)
    return np.asarray(np.clip(rise, 0, 1))


_STRENGTH_MIN = 7.0  # noise alone gives 5 to 6
_AHEAD_MIN = 20.0  # of all other numbers, as a log likelihood ratio
_SCORE_MIN = 0.15
_ROUNDS = 4  # begin, number and length each make the others better
_CLEAR_S = 0.02  # pictures so far from an edge show one symbol only


@dataclass(frozen=True)
class LedReading:
    """``begin_s``: the track's time at which frame 0 of the swim began. ``ahead``: log likelihood
    ratio of ``number`` to the next."""

    begin_s: float
    sigma_s: float
    number: int
    score: float
    ahead: float


def read_led(track: Track, length_s: float | None = None, beat_s: float = 1.0) -> LedReading:
    """What the LED says. ``length_s`` of the swim, None = not known. Raises InputError when there
    is none to be seen, or its number cannot be read."""
    if track.glow is None:
        raise InputError(
            f"{track.name}: nobody looked for the LED in this track",
            "Track the film again, with the LED.",
        )
    seen = track.seen()
    t_s = track.t_s[seen]
    series = series_of(track.glow[seen])
    found = find(series, t_s, length_s, beat_s) if len(t_s) > 1 else None
    if found is None or found.strength < _STRENGTH_MIN:
        raise _no_led(track)
    reading = _reading(series[found.series], t_s, found, length_s)
    if reading is None or reading.score < _SCORE_MIN:
        raise _no_led(track)
    if reading.ahead < _AHEAD_MIN:
        raise InputError(
            f"{track.name}: if an LED blinks, too little of it is seen to read its number",
            "Film the whole swim with the LED in view, or say --start.",
        )
    return reading


def _reading(
    bright: NDArray[np.uint8], t_s: F64, found: Find, length_s: float | None
) -> LedReading | None:
    number, begin_s = found.number, found.begin_s
    known_s = length_s or max(REPEAT_S, float(t_s[-1]) - found.begin_s)
    for _ in range(_ROUNDS):
        result = fit(bright, t_s, Waveform.of(number, known_s), begin_s, ROUGH)
        if result is None:
            return None
        begin_s, looks = result[0].begin_s, result[1]
        best, ahead = _read_number(bright, t_s - begin_s, known_s, looks)
        before, number = (number, known_s), best
        if length_s is None:
            known_s = _length_s(bright, t_s - begin_s, number, looks)
        if before == (number, known_s):
            break
    result = fit(bright, t_s, Waveform.of(number, known_s), begin_s, FINE)
    if result is None:
        return None
    fitted = result[0]
    return LedReading(fitted.begin_s, fitted.sigma_s, number, fitted.score, ahead)


def _read_number(
    bright: NDArray[np.uint8], since_s: F64, length_s: float, looks: LedBrightness
) -> tuple[int, float]:
    """The number that the symbols say, and its log likelihood ratio to the next; the numbers of
    swims that began whole blocks earlier or later count as others."""
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
        f"{track.name}: no LED blinks the code of a swim",
        "Is it in view, and was the fish swimming? Otherwise say --start.",
    )
