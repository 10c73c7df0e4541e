"""The picture of a track: the fish's way in the tank, and its speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.report.style import ACCENT, BAND, DASHED, DOTTED, FAINT, INK, Axes, picture
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.speed import STEPS_PER_BEAT, SpeedCurve
from tailbeat.sensors.camera.tracking.track import LOST, Track

_HOLE, _WATER = "0.94", "0.95"
_MARKS_MAX = 8
_LABEL_GAP_PX = 3
_WALL_M = 0.1


def draw_track(
    track: Track,
    curve: SpeedCurve | None,
    path: Path,
    calibration: Calibration | None = None,
) -> None:
    """Writes a PNG of 1400 x 1100 px, whole or not at all: the way as the camera sees it (x to the
    right, y down), to scale, in the water if ``calibration`` knows its outline; below it the speed
    with two sigma on either side. Holes are shown as such. ``curve`` None = too short for a speed.
    Raises InputError when nothing was seen or the file cannot be written."""
    if not track.seen().any():
        raise InputError(f"{track.name} shows no fish.", "There is nothing to draw.")
    with picture(path, 1400, 1100, track.name, _words(track, curve)) as figure:
        area = None if calibration is None else calibration.area_m
        _draw_way(figure.add_axes((0.075, 0.42, 0.90, 0.44)), track, curve, area)
        _draw_speed(figure.add_axes((0.075, 0.075, 0.90, 0.25)), track, curve)


def _words(track: Track, curve: SpeedCurve | None) -> str:
    seen = 100 * float(np.mean(track.seen()))
    parts = [f"{len(track.t_s)} pictures at {track.fps:.1f}/s, the fish seen in {seen:.1f} %"]
    if curve is not None:
        parts.append(f"positions scatter by {curve.noise_m * 1e3:.2f} mm")
        turned = round(float(np.degrees(curve.direction_rad)), 1) + 0.0  # no "-0.0"
        parts.append(f"direction {turned:+.1f}°")
    return "; ".join(parts)


def _draw_way(axes: Axes, track: Track, curve: SpeedCurve | None, area_m: F64 | None) -> None:
    if area_m is not None:
        outline = np.vstack([area_m, area_m[:1]])
        axes.fill(outline[:, 0], outline[:, 1], color=_WATER, lw=0, zorder=0)
        axes.plot(outline[:, 0], outline[:, 1], color=FAINT, lw=1.4, zorder=1)
    known = np.isfinite(track.x_m)
    axes.plot(track.x_m[known], track.y_m[known], color=ACCENT, lw=1.6, ls=DOTTED, zorder=2)
    shown = track.seen()
    axes.plot(
        np.where(shown, track.x_m, np.nan), np.where(shown, track.y_m, np.nan),
        color=ACCENT, lw=2.2, zorder=3,
    )  # fmt: skip
    rows = np.flatnonzero(shown)
    start_s = track.t_s[rows[0]] if curve is None else curve.start_s
    start = rows[np.argmin(np.abs(track.t_s[rows] - start_s))]
    marks = [(int(start), "start"), *_mark_times(axes, track, rows, int(start))]
    axes.plot(*_at(track, start), "o", ms=12, mfc="white", mec=ACCENT, mew=2.4, zorder=5)
    axes.set_aspect("equal", adjustable="datalim" if area_m is None else "box", anchor="W")
    axes.margins(0.08 if area_m is None else _WALL_M / 2)
    axes.invert_yaxis()
    axes.grid()
    axes.set_title("Path in the tank, m (dotted: not seen)")
    _label(axes, track, marks)


def _mark_times(
    axes: Axes, track: Track, rows: NDArray[np.intp], start: int
) -> list[tuple[int, str]]:
    """Dots along the way, every so many seconds since the start; their rows and labels."""
    after_s = track.t_s[rows] - track.t_s[start]
    step_s = next(
        step for step in (1, 2, 5, 10, 20, 60, 120, 300, 600, 1e9)
        if after_s[-1] / step <= _MARKS_MAX
    )  # fmt: skip
    marks = []
    for due_s in np.arange(step_s, after_s[-1], step_s):
        near = int(np.argmin(np.abs(after_s - due_s)))
        if abs(after_s[near] - due_s) < 0.1 * step_s:
            axes.plot(*_at(track, rows[near]), "o", ms=7, color=ACCENT, zorder=4)
            marks.append((int(rows[near]), f"{due_s:.0f} s"))
    return marks


def _at(track: Track, row: int) -> tuple[list[float], list[float]]:
    return [float(track.x_m[row])], [float(track.y_m[row])]


def _label(axes: Axes, track: Track, marks: list[tuple[int, str]]) -> None:
    """Above their rows, the first ones first; without those that would lie on another. To be called
    when the axes have their limits."""
    axes.apply_aspect()
    taken: list[Any] = []
    for row, text in marks:
        label = axes.annotate(
            text, (float(track.x_m[row]), float(track.y_m[row])), (0, 13),
            textcoords="offset points", ha="center", fontsize=13, color=INK, zorder=6,
        )  # fmt: skip
        box = label.get_window_extent().padded(_LABEL_GAP_PX)
        if any(box.overlaps(other) for other in taken):
            label.remove()
        else:
            taken.append(box)


def _draw_speed(axes: Axes, track: Track, curve: SpeedCurve | None) -> None:
    axes.set_title("Speed along the path, mean over a beat, mm/s (band: two sigma on either side)")
    axes.set_xlabel("time in the film, s")
    axes.set_xlim(float(track.t_s[0]), max(float(track.t_s[-1]), float(track.t_s[0]) + 1e-3))
    axes.grid(axis="y")
    if curve is None or not len(curve.t_s):
        axes.text(0.5, 0.5, "too short for a speed", transform=axes.transAxes, ha="center")
        axes.set_yticks([])
        return
    t_s, speed, sigma = _with_holes(curve)
    speed, sigma = speed * 1e3, sigma * 1e3
    for begin_s, end_s in _lost(track):
        axes.axvspan(begin_s, end_s, color=_HOLE, lw=0, zorder=0)
    axes.fill_between(t_s, speed - 2 * sigma, speed + 2 * sigma, color=BAND, lw=0, zorder=1)
    axes.plot(t_s, speed, color=ACCENT, lw=2.2, zorder=2)
    if curve.start_s > track.t_s[0]:
        axes.axvline(curve.start_s, color=INK, lw=1.4, ls=DASHED, zorder=3)
        axes.annotate(
            "start", (curve.start_s, 1), (5, -4), xycoords=("data", "axes fraction"),
            textcoords="offset points", va="top", fontsize=13,
        )  # fmt: skip
    low, high = float(np.nanmin(speed - 2 * sigma)), float(np.nanmax(speed + 2 * sigma))
    low = min(low, 0.0) if low < 0.5 * high else low  # zero, where it is not far
    room = 0.08 * max(high - low, 0.1)
    axes.set_ylim(low - room, high + room)


def _with_holes(curve: SpeedCurve) -> tuple[F64, F64, F64]:
    """The curve with NaN where samples are missing, so that lines break."""

    step_s = curve.beat_s / STEPS_PER_BEAT
    breaks = np.flatnonzero(np.diff(curve.t_s) > 1.5 * step_s) + 1
    columns = (curve.t_s, curve.v_m_s, curve.sigma_m_s)
    t_s, speed, sigma = (np.insert(column, breaks, np.nan) for column in columns)
    return t_s, speed, sigma


def _lost(track: Track) -> list[tuple[float, float]]:
    """Begin and end of each stretch in which the fish was lost."""

    lost = np.concatenate([[False], track.state == LOST, [False]])
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    last = len(track.t_s) - 1
    return [
        (float(track.t_s[max(begin - 1, 0)]), float(track.t_s[min(end, last)]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]
