"""Speed from a whole film: a smoother that knows what a tail does to the body, forward and back.

Positions along the swim direction are a trend (speed that drifts, a Wiener process through its
derivative) plus the beat's own ripple at once and twice the beat frequency, whose size drifts
slowly, plus white noise; its parameters are those that make the film likeliest. A frame difference
has 35 mm/s of noise, a line over one beat 0.7 mm/s; this uses all of the film.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.track import Track

Floats = NDArray[np.float64]

STEPS_PER_BEAT = 10
COLUMNS = ("t_s", "v_m_s", "sigma_m_s", "window_s", "trial")


@dataclass(frozen=True)
class SpeedCurve:
    """Mean speed along the swim direction over one beat around ``t_s``, arrays of shape (n,); times
    rise in steps of beat_s/STEPS_PER_BEAT from ``start_s`` (so the middle of beat k is start_s +
    (k + 0.5) beat_s, exactly one of them), less those without a speed (LOST pictures within the
    window: more than five in a row, or fewer than 60 % of them there).

    ``sigma_m_s``: one standard deviation, honest: it holds the noise found in this film and what
    the model cannot follow. ``direction_rad``: of the swim, against the tank's x.
    ``noise_m``: white noise of a position, as found. ``start_s``: begin of beat 0.
    """

    t_s: Floats
    v_m_s: Floats
    sigma_m_s: Floats
    beat_s: float
    start_s: float
    direction_rad: float
    noise_m: float

    def beats(self, count: int) -> tuple[Floats, Floats]:
        """Mean speed and sigma of beats 0..count-1, shape (count,); NaN = not measured."""
        raise NotImplementedError


def swim_direction_rad(track: Track) -> float:
    """Where the fish swam, against the tank's x: along its way from first to last when that is
    0.3 m or more, otherwise the tank's x (0)."""
    raise NotImplementedError


def swim_speed(
    track: Track,
    beat_s: float = 1.0,
    start_s: float | None = None,
    direction_rad: float | None = None,
) -> SpeedCurve:
    """Speeds of all of ``track``. ``start_s``: begin of the swim in the track's time (sync.py);
    None = the first row's. ``direction_rad`` None = swim_direction_rad. Raises InputError when fewer
    than two beats were seen."""
    raise NotImplementedError


def write_speeds(curve: SpeedCurve, path: Path, trial: int | None = None) -> None:
    """CSV with COLUMNS, whole or not at all; t_s counts from the begin of the swim, ``trial`` is its
    number, empty when the film is not paired with one (then t_s is the film's own time)."""
    raise NotImplementedError
