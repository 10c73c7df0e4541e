"""Which trials are judged and which is the best, by the board's own code (firmware/ilc/judge.h).

Whether the fish swam straight.

Which beats of a series no trial has corrected yet: the board's counts, in words.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F32, F64
from tailbeat.core.native import ffi, lib
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_file import SLOT_S, Trial


def counts(error_m_s: F32, complete: bool) -> bool:
    """Whether a trial is judged.

    Parameters
    ----------
    error_m_s : shape (beats,), NaN = not measured.
    complete : whether it was executed to its end.
    """
    return bool(lib.judge_counts(_Native(error_m_s).trial, complete))


def best_at(errors: Iterable[F32]) -> int | None:
    """Index of the best of trials that are judged, in the order they were executed; None = there
    are none. Their errors as for ``counts``."""
    best: int | None = None
    best_m_s = 0.0
    peaks = ffi.new("judge_peaks_t *")
    for at, error_m_s in enumerate(errors):
        native = _Native(error_m_s)
        if best is None or lib.judge_is_better(peaks, best_m_s, native.trial):
            best, best_m_s = at, max_abs(error_m_s)
            lib.judge_keep(peaks, native.trial)
    return best


def on_common_beats(one_m_s: F32, other_m_s: F32) -> tuple[float, float]:
    """max|e| of two trials on the beats that both measured; NaN when there are none."""
    common = np.isfinite(one_m_s) & np.isfinite(other_m_s)
    return max_abs(one_m_s[common]), max_abs(other_m_s[common])


def max_abs(error_m_s: F32) -> float:
    """Over the measured beats; NaN when there are none."""
    known = np.abs(error_m_s[np.isfinite(error_m_s)])
    return float(known.max()) if known.size else float("nan")


class _Native:
    """A trial as the C code takes it. Its arrays live as long as this."""

    def __init__(self, error_m_s: F32) -> None:
        self._error = np.ascontiguousarray(error_m_s, dtype=np.float32)
        self._measured = np.isfinite(self._error).view(np.uint8)
        self.trial: Any = ffi.new("law_trial_t *")
        self.trial.beats = self._error.size
        self._held = (
            ffi.from_buffer("float[]", self._error),
            ffi.from_buffer("uint8_t[]", self._measured),
        )
        self.trial.error_m_s, self.trial.measured = self._held


CROOKED_RAD = math.radians(15.0)

_LACKING_MAX = 0.1  # of the slots
# The board takes what its gyro says in the rest before the trial for the gyro's zero, and calls a
# fish at rest that turns by up to a degree (firmware/speed/rest.h): over a trial five times as long
# as that rest this comes to 5 degrees.
_REST_TURN_RAD = math.radians(1.0)
_RESTED_MIN = 0.2  # of the trial
_FRAMES_MIN = 6  # in a beat
_COVERED_MIN = 0.6  # of a beat, from its first to its last frame
_WAY_MIN_M = 0.2  # less tells no curvature
_SIGMA_MIN_RAD = 1e-3  # of a beat's mean heading


@dataclass(frozen=True)
class HeadingDrift:
    """Headings are means over whole beats, against the direction in which the trial began, positive
    clockwise from above. ``mean_yaw_rad``: over the trial; ``worst_yaw_rad``: the farthest off,
    with its sign; ``curvature_1_m``: turn per metre swum, NaN when it hardly moved. ``source``:
    ``imu`` or ``camera``."""

    mean_yaw_rad: float
    worst_yaw_rad: float
    curvature_1_m: float
    source: str

    @property
    def crooked(self) -> bool:
        """Beyond 15 degrees: its speed along the way is no longer the one that was wanted."""
        return abs(self.worst_yaw_rad) > CROOKED_RAD

    def text(self) -> str:
        """One line: ``straight within 4 degrees (imu)``, or what is wrong and what to do."""
        worst_deg = math.degrees(self.worst_yaw_rad)
        side = "right" if worst_deg > 0 else "left"
        if not self.crooked:
            return f"straight within {abs(worst_deg):.0f} degrees ({self.source})"
        return (
            f"NOT STRAIGHT: it turned {abs(worst_deg):.0f} degrees to the {side} "
            f"({self.source}), which lowers its speed along the tank; tailbeat session trim"
        )


@dataclass(frozen=True)
class HeadingTrace:
    """Mean heading of each beat against the first known one, NaN = not known; ``way_m``: how far it
    had come by the middle of each beat, NaN = not known."""

    heading_rad: F64
    way_m: F64

    @property
    def known(self) -> bool:
        """Whether at least half of the beats are."""
        seen = int(np.count_nonzero(np.isfinite(self.heading_rad)))
        return seen > 0 and 2 * seen >= len(self.heading_rad)

    def turn_rad_m(self) -> tuple[float, float]:
        """Turn per metre by a line through all beats, and its standard deviation by how far they
        lie off it; NaN when the fish hardly moved or too few beats are known."""
        seen = np.isfinite(self.heading_rad) & np.isfinite(self.way_m)
        way, heading = self.way_m[seen], self.heading_rad[seen]
        if len(way) < 4 or float(np.ptp(way)) < _WAY_MIN_M:
            return math.nan, math.nan
        off, turned = way - _mean(way), heading - _mean(heading)
        squares = math.fsum(off * off)
        slope = math.fsum(off * turned) / squares
        left = turned - slope * off
        scatter = math.sqrt(math.fsum(left * left) / (len(way) - 2))
        return slope, max(scatter, _SIGMA_MIN_RAD) / math.sqrt(squares)

    def straightness(self, source: str) -> HeadingDrift | None:
        """None when too little is known."""
        if not self.known:
            return None
        headings = self.heading_rad[np.isfinite(self.heading_rad)]
        return HeadingDrift(
            mean_yaw_rad=_mean(headings),
            worst_yaw_rad=float(headings[np.argmax(np.abs(headings))]),
            curvature_1_m=self.turn_rad_m()[0],
            source=source,
        )


def _mean(values: F64) -> float:
    """By an exact sum: what a fish turned is written down, and is the same on any processor."""
    return math.fsum(values) / len(values)


def heading_drift(trial: Trial) -> HeadingDrift | None:
    """By the turns its IMU felt; None when they are not in the file, or mean nothing because the
    fish had hardly rested before."""
    course = heading_trace(trial)
    return None if course is None else course.straightness("imu")


def heading_drift_of_frames(
    frames: Sequence[Frame], begin_s: float, beats: int, beat_s: float
) -> HeadingDrift | None:
    """By what a camera saw from ``begin_s`` on (the clock of the frames); None when it saw too
    little (fewer than half of the beats)."""
    return heading_trace_of_frames(frames, begin_s, beats, beat_s).straightness("camera")


def heading_trace(trial: Trial) -> HeadingTrace | None:
    """By the IMU; the way by the beats' speeds. None as for ``straightness``."""
    swim_s = trial.executed_beats * trial.beat_s
    drift_rad = imu_drift_rad_s(trial) * swim_s
    heading = _headings(trial) if drift_rad <= _REST_TURN_RAD / _RESTED_MIN else None
    if heading is None:
        return None
    speed = trial.beats.speed_m_s[: len(heading)].astype(np.float64)
    return HeadingTrace(heading - heading[0], _way(speed, trial.beat_s))


def with_way(course: HeadingTrace, speed_m_s: F64, beat_s: float) -> HeadingTrace:
    """The same with the way by other speeds: of a trial whose own are not known yet."""
    return HeadingTrace(course.heading_rad, _way(speed_m_s[: len(course.heading_rad)], beat_s))


def imu_drift_rad_s(trial: Trial) -> float:
    """How fast the heading by the IMU may run away, at most; infinite without a rest before."""
    rest = trial.rest_before
    return _REST_TURN_RAD / rest.still_s if rest is not None and rest.still_s > 0 else math.inf


def _way(speed_m_s: F64, beat_s: float) -> F64:
    """Up to the middle of each beat; beats without a speed are as fast as those around them."""
    known = np.flatnonzero(np.isfinite(speed_m_s))
    if 2 * len(known) < max(len(speed_m_s), 1):
        return np.full(len(speed_m_s), np.nan)
    speed = np.interp(np.arange(len(speed_m_s)), known, speed_m_s[known])
    way: F64 = (np.cumsum(speed) - speed / 2) * beat_s
    return way


def _headings(trial: Trial) -> F64 | None:
    """Mean heading over each whole beat that was executed, against that at the begin, which the
    sway of the body leaves alone; None when too many turns are not known."""

    beats = trial.executed_beats
    count = math.ceil(beats * trial.beat_s / SLOT_S - 1e-6)
    if beats < 1:
        return None
    table = trial.slots.table()
    turn = np.full(count, np.nan)
    inside = trial.slots.index < count
    turn[trial.slots.index[inside]] = table["turn_rad"][inside]
    if np.count_nonzero(np.isnan(turn)) > _LACKING_MAX * count:
        return None
    heading = np.concatenate([[0.0], np.cumsum(_whole(turn, trial.beat_s / SLOT_S))])
    # The integral of a heading that is straight between the ends of slots, at the ends of beats.
    area = np.concatenate([[0.0], np.cumsum((heading[1:] + heading[:-1]) / 2)])
    ends = np.arange(beats + 1) * trial.beat_s / SLOT_S
    slot = np.minimum(ends.astype(int), count - 1)
    part = ends - slot
    at = heading[slot] + (heading[slot + 1] - heading[slot]) * part
    upto = area[slot] + (heading[slot] + at) / 2 * part
    mean: F64 = np.diff(upto) / np.diff(ends)
    return mean


def _whole(turn_rad: F64, beat_slots: float) -> F64:
    """A turn that is not known is as those a beat before and after, which the tail made alike."""
    filled = turn_rad.copy()
    for hole in np.flatnonzero(np.isnan(turn_rad)):
        alike = [
            turn_rad[at]
            for beat in (-2, -1, 1, 2)
            for at in [round(hole + beat * beat_slots)]
            if 0 <= at < len(turn_rad) and not math.isnan(turn_rad[at])
        ]
        filled[hole] = math.fsum(alike) / len(alike) if alike else 0.0
    return filled


def heading_trace_of_frames(
    frames: Sequence[Frame], begin_s: float, beats: int, beat_s: float
) -> HeadingTrace:
    """By a camera; a beat that it saw too little of is not known."""
    t = (np.array([f.t_s for f in frames]) - begin_s) / beat_s
    xy = np.array([(f.x_m, f.y_m) for f in frames]).reshape(-1, 2)
    raw = np.array([f.heading_rad for f in frames])
    sound = np.isfinite(t) & np.isfinite(xy).all(axis=1) & np.isfinite(raw)
    t, xy, raw = t[sound], xy[sound], np.unwrap(raw[sound])
    heading = np.full(max(beats, 0), np.nan)
    place = np.full((max(beats, 0), 2), np.nan)
    for beat in range(beats):
        inside = (t >= beat) & (t < beat + 1)
        if inside.sum() >= _FRAMES_MIN and np.ptp(t[inside]) >= _COVERED_MIN:
            heading[beat] = _without_sway(t[inside] - beat - 0.5, raw[inside])
            place[beat] = xy[inside].mean(axis=0)
    known = np.flatnonzero(np.isfinite(heading))
    way = np.full(len(heading), np.nan)
    if known.size:
        heading -= heading[known[0]]
        steps = np.hypot(*np.diff(place[known], axis=0).T) if len(known) > 1 else np.empty(0)
        way[known] = np.concatenate([[0.0], np.cumsum(steps)])
    return HeadingTrace(heading, way)


def _without_sway(t_beats: F64, heading_rad: F64) -> float:
    """The mean over a beat, were all of it seen: of a line beside an oscillation of one period."""
    phase = math.tau * t_beats
    terms = np.stack([np.ones_like(t_beats), t_beats, np.sin(phase), np.cos(phase)], axis=1)
    return float(np.linalg.lstsq(terms, heading_rad, rcond=None)[0][0])


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
    return line + (": ILC_EXTRAP decides what the last ones do" if at_the_end else "")


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
        parts.append(f"not executed: {spans(np.arange(executed, len(known)))}")
    if len(lost):
        parts.append(f"without a speed: {spans(lost)}")
    return "; ".join(parts)


def _have(beats: ArrayLike) -> str:
    return "has" if np.size(beats) == 1 else "have"
