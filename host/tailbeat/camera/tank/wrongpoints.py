"""One point among several that is measured or typed wrong: which one is it?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError

Floats = NDArray[np.float64]

LEAVE_OUT_FROM = 6
OUTLIER_M = 0.02
_LEFT_MIN = 5
# With the camera's intrinsics and 2 mm of tape the second best is 1.5 times as far off as the best
# in all but a few per cent of the cases in which it is not far beyond any limit.
_CLEARLY = 1.5


@dataclass(frozen=True)
class Fit:
    """A way to fit points. ``off_m(flat, places, used)``: how far each point (n,) is off when only
    those at the indices ``used`` are fitted; None = these tell nothing. ``rms_max_m``: of the
    points used. ``rigid``: only the camera's place is free, so that a wrong point cannot be made up
    for by a wrong plane."""

    off_m: Callable[[Floats, Floats, NDArray[np.intp]], Floats | None]
    rms_max_m: float
    rigid: bool

    def rms_m(self, off_m: Floats) -> float:
        """Infinite for points that do not fit each other at all."""
        rms = float(np.sqrt(np.mean(off_m**2)))
        return rms if np.isfinite(rms) else np.inf

    def good(self, off_m: Floats) -> bool:
        """Whether points that are so far off fit each other."""
        return bool(self.rms_m(off_m) <= self.rms_max_m and off_m.max() <= OUTLIER_M)


@dataclass(frozen=True)
class _Without:
    left_out: int
    used: NDArray[np.intp]
    rms_m: float
    good: bool


def used_points(flat: Floats, places: Floats, names: list[str], fit: Fit) -> NDArray[np.intp]:
    """Indices of the points that fit each other, all but at most a third; all when there is no such
    set or there are fewer than six. Raises InputError when it cannot be told which point is wrong.

    Leaves out one after the other the point without which the rest fits best."""
    everything = np.arange(len(flat))
    used = everything
    while max(_LEFT_MIN, len(flat) * 2 / 3) <= len(used) - 1 and len(flat) >= LEAVE_OUT_FROM:
        off = fit.off_m(flat, places, used)
        if off is None or fit.good(off[used]):
            return used
        ways = _ways(flat, places, used, fit)
        if not ways:
            return everything
        _check_unambiguous(ways, names, fit)
        used = ways[0].used
    off = fit.off_m(flat, places, used)
    return used if off is not None and fit.good(off[used]) else everything


def suspects(flat: Floats, places: Floats, fit: Fit) -> list[int]:
    """Points without any one of which the others would fit; with fewer than five none, for four
    tell too little."""
    if len(flat) < _LEFT_MIN:
        return []
    return [way.left_out for way in _ways(flat, places, np.arange(len(flat)), fit) if way.good]


def _ways(flat: Floats, places: Floats, used: NDArray[np.intp], fit: Fit) -> list[_Without]:
    """To leave out one more, the best first."""
    ways = []
    for i in used:
        rest = used[used != i]
        off = fit.off_m(flat, places, rest)
        if off is None:
            continue
        good = fit.good(off[rest]) and bool(off[i] > OUTLIER_M)
        ways.append(_Without(int(i), rest, fit.rms_m(off[rest]), good))
    return sorted(ways, key=lambda way: way.rms_m)


def _check_unambiguous(ways: list[_Without], names: list[str], fit: Fit) -> None:
    near = [way for way in ways if way.good]
    if fit.rigid and near:
        near = [way for way in near if way.rms_m < _CLEARLY * ways[0].rms_m or way is ways[0]]
    if len(near) < 2:
        return
    blamed = " or ".join(names[way.left_out] for way in near)
    board = "; pictures of the board (--board) help to tell, and a lens that bends lines needs them"
    raise InputError(
        f"the tank's points do not fit each other, and it cannot be told which is wrong: {blamed} "
        f"(without either the others fit within {OUTLIER_M * 1e3:.0f} mm)",
        f"Measure these anew, or more points{'' if fit.rigid else board}.",
    )
