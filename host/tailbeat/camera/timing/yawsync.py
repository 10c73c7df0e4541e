"""When the swim began, by the fish's wobble: finds the best begin and judges whether film and file
belong together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tailbeat.camera.timing.wobble import Wobble
from tailbeat.camera.timing.yawfit import Headings, YawFit, look, refine, scan
from tailbeat.camera.tracking.track import Track
from tailbeat.errors import InputError
from tailbeat.trial_log import Trial

Floats = NDArray[np.float64]

SCALE_MIN, SCALE_MAX = 0.85, 1.2  # both are angles of the same fish
# Of right pairs (100 simulated swims of a learning fish each at 25 and 60 pictures/s, 10 % lost):
# clean, and with glare (another 0.02 rad of noise, 5 % of the headings 0.3 rad off; 25/s is worst).
#   excess                         clean <= 0.0024   glare <= 0.025   (95 %: 0.011)
#   ahead                          clean >= 34       glare >= 3       (median 31: 20 % are refused)
#   (uneven - 1) * sqrt(beats)     clean <= 1.9      glare <= 7.6     (95 %: 1.6)
#   seen / noise                   clean >= 3.5      glare >= 1.5
# So each limit is a factor of three or more from clean films. Wrong pairs show in uneven: with 3
# sigmas instead of 6, 43 instead of 80 of 800 would be taken, but right ones come near to 3.
EXCESS_MAX = 0.03
AHEAD_MIN = 10.0
_UNEVEN_SIGMAS = 6.0  # over sqrt(beats); a mean of chi^2 scatters by sqrt(2) of that
_OFF_MIN_RAD, _OFF_SIGMAS = 0.1, 6.0
_STILL_RAD = 1e-6  # headings that do not even scatter: frozen pictures, a fish held
_SEEN_MIN = 0.45  # wobble per noise
AMBIGUOUS = "it fits at another beat as well"


class Misfit(Exception):
    """Film and file are not of one swim; the text says why."""


def read_yaw(track: Track, trial: Trial) -> YawFit:
    """The best begin. Raises InputError when the file holds no turns or the film no wobble, Misfit
    when the two do not belong together or it cannot be said which beat is the first."""
    wobble = Wobble(trial)
    seen = track.seen() & np.isfinite(track.heading_rad)
    seen[seen] = _believed(track.heading_rad[seen])
    if np.count_nonzero(seen) < 2:
        raise _no_wobble(track)
    headings = Headings(track.t_s[seen], track.heading_rad[seen], trial.beat_s)
    if float(np.sqrt(np.mean(headings.rest**2))) < _STILL_RAD:
        raise _no_wobble(track)
    begins, power = scan(headings, wobble)
    if len(begins) == 0:
        raise _no_wobble(track)
    top = refine(headings, wobble, float(begins[np.argmax(power)]))
    found = look(headings, wobble, begins, power, top)
    if not found.seen_rad >= _SEEN_MIN * found.noise_rad:
        raise _no_wobble(track)
    if reason := _misfit(found):
        raise Misfit(reason)
    return found


def _believed(heading_rad: Floats) -> NDArray[np.bool_]:
    """Not those far from the median of their five neighbours: a marker seen askew."""
    off = np.abs(heading_rad - median_filter(heading_rad, 5, mode="nearest"))
    return np.asarray(off <= max(_OFF_MIN_RAD, _OFF_SIGMAS * 1.4826 * float(np.median(off))))


def _misfit(found: YawFit) -> str:
    """Why the two do not belong together; "" = they do."""
    if found.excess > EXCESS_MAX:
        return f"only {found.explained:.0%} of the wobble in the film is in the file"
    if not SCALE_MIN <= found.scale <= SCALE_MAX:
        return f"the fish in the film turns {found.scale:.2f} times as far as in the file"
    if found.uneven > 1 + _UNEVEN_SIGMAS / np.sqrt(max(found.beats, 1)):
        return "the beats of the film are not as large as those of the file"
    if found.ahead < AHEAD_MIN:
        return AMBIGUOUS
    return ""


def _no_wobble(track: Track) -> InputError:
    return InputError(
        f"{track.name}: the fish's heading shows no wobble to find the swim by",
        "Film the LED, or say --start.",
    )
