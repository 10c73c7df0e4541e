"""Which beats of a series no trial has corrected yet: the board's counts, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def spans(beats: ArrayLike) -> str:
    """Beats in words: ``beat 5``, ``beats 5, 36-39``. ``beats``: rising, at least one."""
    numbers = np.asarray(beats, dtype=np.int64)
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs]
    return f"beat{'' if len(numbers) == 1 else 's'} {', '.join(words)}"


def never_corrected(visits: ArrayLike | None) -> str:
    """One line on the beats without visits; "" when all have some, none has (nothing was learned
    yet), or the board does not count them (None)."""
    counts = np.asarray(() if visits is None else visits)
    missing = np.flatnonzero(counts == 0)
    if len(missing) in (0, len(counts)):
        return ""
    line = f"{spans(missing)} {_have(missing)} never been corrected"
    at_the_end = counts[-1] == 0
    return line + (": LAW_BEYOND decides what the last ones do" if at_the_end else "")


def never_measured(visits: ArrayLike) -> str:
    """The same of trials: one line on the beats that none of them swam and measured, or ""."""
    counts = np.asarray(visits)
    missing = np.flatnonzero(counts == 0)
    if not len(missing):
        return ""
    return f"{spans(missing)} {_have(missing)} never been measured: no trial teaches anything there"


def not_reached(executed: int, measured: ArrayLike) -> str:
    """One line on what a trial that was cut short, or lost its fish, says nothing of, or "".
    ``measured``: per beat, whether it has a speed."""
    known = np.asarray(measured, dtype=bool)
    lost = np.flatnonzero(~known[:executed])
    parts = []
    if executed < len(known):
        parts.append(f"not swum: {spans(np.arange(executed, len(known)))}")
    if len(lost):
        parts.append(f"without a speed: {spans(lost)}")
    return "; ".join(parts)


def _have(beats: ArrayLike) -> str:
    return "has" if np.size(beats) == 1 else "have"
