"""Whether a film's time stamps are those of its pictures.

A program that drops pictures and writes the others 1/25 s apart makes a film whose clock runs slow:
all speeds are too high by the part that is missing. The places tell: over each hole the fish goes
twice as far, or three times, as from any other picture to the next.
"""

from __future__ import annotations

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError

HOLES_MIN = 3
_NEIGHBOURS = 11  # steps among which the usual one is looked for
_CLEAR = 5.0  # standard deviations of a step, that one picture's way is longer than
_WHOLE = 0.35  # how far a step may be from a whole number of pictures
_PICTURES_MAX = 8  # that a hole may lack
_FISH_M_S = 0.3  # what is faster is carried
_BACKWARD = 4  # as many times as there are steps that are too short


def check_stamps(t_s: F64, way_m: F64, name: str) -> None:
    """Raises InputError when pictures are missing between time stamps that do not show it.

    Parameters
    ----------
    t_s, way_m
        Times in s and positions along the swim direction in m of the pictures in which the fish was
        seen, shape (pictures,).
    name
        Of the film, for the message.
    """
    holes, lacking, steps = _holes(t_s, way_m)
    if holes < HOLES_MIN:
        return
    period_s = float(np.median(np.diff(t_s)))
    raise InputError(
        f"{name} lacks pictures that its time stamps do not show: at {holes} of {steps} steps the "
        f"fish jumps by {lacking / holes:.1f} more pictures' way, and the stamps stay "
        f"{period_s * 1e3:.0f} ms apart; speeds would be {lacking / steps:.0%} too high",
        "Record with the camera's own time stamps, for example: tailbeat trial run --video, or "
        "ffmpeg with -use_wallclock_as_timestamps 1 and -fps_mode passthrough.",
    )


def _holes(t_s: F64, way_m: F64) -> tuple[int, int, int]:
    """Steps that are too long by whole pictures, these pictures, and how many steps tell; no holes
    when steps are too short about as often: then places or times are merely noisy."""
    if len(t_s) < 3 * _NEIGHBOURS:
        return 0, 0, 0
    dt_s, step_m = np.diff(t_s), np.diff(way_m)
    edge = _NEIGHBOURS // 2
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(step_m / dt_s, edge, mode="edge"), _NEIGHBOURS
    )
    usual_m_s = np.median(around, axis=1)
    excess_m, picture_m = step_m - usual_m_s * dt_s, usual_m_s * np.median(dt_s)
    sigma_m = 1.4826 * float(np.median(np.abs(excess_m)))
    swims = np.abs(usual_m_s) < _FISH_M_S
    clear = swims & (np.abs(picture_m) > max(_CLEAR * sigma_m, 1e-9))
    pictures = excess_m[clear] / picture_m[clear]
    whole = np.rint(pictures)
    exact = (np.abs(pictures - whole) < _WHOLE) & (np.abs(whole) <= _PICTURES_MAX)
    forward, backward = exact & (whole >= 1), exact & (whole <= -1)
    if np.count_nonzero(forward) <= _BACKWARD * np.count_nonzero(backward):
        return 0, 0, int(clear.sum())
    return int(forward.sum()), int(whole[forward].sum()), int(clear.sum())
