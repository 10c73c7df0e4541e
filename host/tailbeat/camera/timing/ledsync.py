"""When the swim began, by the LED: reads the code, then fits its edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.timing.ledcode import (
    BLOCK_SYMBOLS,
    REPEAT_S,
    SYMBOL_S,
    Waveform,
    codebook,
)
from tailbeat.camera.timing.ledfit import FINE, ROUGH, Looks, fit
from tailbeat.camera.timing.ledsearch import Find, find, series_of
from tailbeat.camera.tracking.track import Track
from tailbeat.errors import InputError

Floats = NDArray[np.float64]

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
    bright: NDArray[np.uint8], t_s: Floats, found: Find, length_s: float | None
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
    bright: NDArray[np.uint8], since_s: Floats, length_s: float, looks: Looks
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


def _length_s(bright: NDArray[np.uint8], since_s: Floats, number: int, looks: Looks) -> float:
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
