"""Why beats of a swim have no speed, as far as its log tells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tailbeat.results import SPEED_SOURCES

if TYPE_CHECKING:
    from tailbeat.trial_log import Trial

NO_SPEED = "beats have no speed"


def unmeasured(trial: Trial) -> str:
    """In words; empty when every beat that was swum has a speed."""
    known = np.isfinite(trial.beats.speed_m_s[: trial.executed_beats])
    missing = np.flatnonzero(~known)
    if not missing.size:
        return ""
    words = f"{missing.size} of {trial.executed_beats} {NO_SPEED}"
    hole_s = _longest_hole_s(trial, missing)
    if not hole_s:
        return words
    return (
        f"{words}: none came from the camera for {hole_s:.1f} s; it lost sight of the fish, or this"
        " computer is too slow for it (end other programs, take smaller pictures)"
    )


def _longest_hole_s(trial: Trial, missing: np.ndarray[tuple[int], np.dtype[np.intp]]) -> float:
    """Between speeds of the camera that came in time, next to beats without one; 0: no hole is
    longer than SPD_GAP_S, or speeds did not come from a camera as it swam."""
    allowed_s = trial.params.get("SPD_GAP_S", 0.0)
    source = SPEED_SOURCES[round(trial.params.get("SPD_SOURCE", 0.0))]
    if source != "vision" or trial.uploaded or not allowed_s:
        return 0.0
    table = trial.slots.table()
    end_s = trial.executed_beats * trial.beat_s
    times = np.concatenate([[0.0], np.sort(table["t_s"][table["samples"] > 0]), [end_s]])
    begins, ends = times[:-1], times[1:]
    at_s = missing[:, None] * trial.beat_s
    touched = ((begins < at_s + trial.beat_s) & (ends > at_s)).any(axis=0)
    holes = (ends - begins)[touched]
    longest = float(holes.max()) if holes.size else 0.0
    return longest if longest > allowed_s else 0.0
