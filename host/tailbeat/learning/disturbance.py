"""Whether something other than its tail moved the fish in a swim: a hand, the wall, a wave.

The swim is its own measure: a fish in four numbers (model.fishmodel) is fitted to it without the
beats that do not fit, and what it misses must not jump from one beat to the next. Nothing need be
known of the fish. On the simulated tank, seeds 1 to 20, trials 1 to 10 from a first input near
the dead zone, the largest jump of 200 swims was 2.6 mm/s; of 200 that were pushed by 50 mm/s at
any beat, 22.9 to 39.6, all flagged. Of 78 swims of 13 other fish, references and cameras none was
flagged (noise 5 mm, every third picture lost: 15.9 mm/s, of 34 allowed). A push whose trace is
gone within the beat is not found: at kappa 30 / m and 90 mm/s one of 50 mm/s leaves 8 mm/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.trial_checks import spans
from tailbeat.learning.fish_model import Swim
from tailbeat.learning.fit import fit

_JUMP_M_S = 0.012  # what people do to a fish is more
_SCATTERS = 5.0  # of the jumps in this swim; 4.9 is the most that chance made of 200
_SIGMAS = 6.0  # of a beat's measurement
_BEATS_MIN = 6  # fewer follow any model
_FITS = 4
_FITS_M_S, _FITS_MADS = 0.004, 4.0  # a beat farther off does not take part in the next fit
_FADED = 0.25  # of the jump: what is left of it does not count as its beats
_MAD = 1.4826  # standard deviations of normal noise


@dataclass(frozen=True)
class Bump:
    """``beats`` from where the speed left what the tail does until it is back there; ``by_m_s``:
    the jump, forward positive."""

    beats: range
    by_m_s: float

    def words(self) -> str:
        """For the person who is asked whether the swim counts."""
        verb = "jumps" if len(self.beats) == 1 else "jump"
        return f"{spans(self.beats)} {verb} by {self.by_m_s * 1e3:+.0f} mm/s: a bump or a wave?"


def bump_of(swim: Swim) -> Bump | None:
    """The largest one; None: there is none, or too little was measured to tell."""
    known = np.flatnonzero(swim.measured)
    if len(known) < _BEATS_MIN:
        return None
    try:
        off = _missed(swim)[known]
    except InputError:
        return None  # no fish swims like that; what else is wrong with it is said elsewhere
    jumps = np.diff(off)
    scatter = _MAD * float(np.median(np.abs(jumps)))
    sigma = float(np.median(swim.sigma_m_s[known]))
    at = int(np.argmax(np.abs(jumps)))
    if abs(jumps[at]) <= max(_JUMP_M_S, _SCATTERS * scatter, _SIGMAS * sigma):
        return None
    first, last = _extent(off, at)
    by_m_s = float(jumps[at]) if first == at + 1 else -float(jumps[at])
    return Bump(range(int(known[first]), int(known[last]) + 1), by_m_s)


def _missed(swim: Swim) -> F64:
    """Speed less the model's, per beat."""
    known, used = swim.measured, swim.measured
    for _ in range(_FITS):
        found = fit([replace(swim, speed_m_s=np.where(used, swim.speed_m_s, np.nan))])
        told = found.model.beats(swim.amplitude_rad, swim.beat_s, found.conditions[0])
        off: F64 = swim.speed_m_s - told
        usual = _MAD * float(np.median(np.abs(off[known])))
        fits = known & (np.abs(off) < max(_FITS_M_S, _FITS_MADS * usual))
        if np.array_equal(fits, used) or 2 * fits.sum() < known.sum():
            break
        used = fits
    return off


def _extent(off: F64, at: int) -> tuple[int, int]:
    """First and last of the beats on that side of the jump after ``at`` that is farther off."""
    after = abs(off[at + 1]) >= abs(off[at])
    begin, step = (at + 1, 1) if after else (at, -1)
    least = _FADED * abs(off[begin])
    end = begin
    while 0 <= end + step < len(off) and off[end + step] * np.sign(off[begin]) > least:
        end += step
    return min(begin, end), max(begin, end)
