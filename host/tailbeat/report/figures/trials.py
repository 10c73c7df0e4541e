"""Speed and amplitude, beat by beat, of a few chosen trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.style import (
    GREY,
    INK,
    Axes,
    Figure,
    Look,
    Style,
    blank,
    drawing,
    entry,
    head_legend,
    marked,
    mm,
    mpl_patches,
    nothing,
)

_REFERENCE = "0.86"
_LIMIT_DASH = (0, (2, 2.5))
_LIMIT_SHOWN = 0.7  # a limit that nothing comes near is left out
# Early ones light and broken, the best dark and whole: the order shows without colour.
_ROLES = {
    "first": Look("#e69f00", "s", (0, (1.2, 1.3))),
    "middle": Look("#56b4e9", "^", (0, (4, 1.6))),
    "last": Look("#a04000", "D", (0, (6, 1.4, 1.2, 1.4))),
    "best": Look("#00507d", "o", "-"),
}


def chosen(analysis: Analysis) -> list[tuple[str, TrialRow, Trial]]:
    """(role, row, trial) of the first, a middle, the last and the best trial that count since the
    board began anew, each once, in the order they were executed. The middle one is halfway, by
    iterations, from the first to the best. The best is complete; without a complete one there is
    none."""
    both = [
        (row, trial)
        for row, trial in zip(analysis.rows, analysis.trials, strict=True)
        if row.counts and row.epoch == analysis.epoch and np.isfinite(trial.beats.speed_m_s).any()
    ]
    if not both:
        return []
    roles = {0: "first", len(both) - 1: "last"}
    whole = [n for n, (row, _) in enumerate(both) if row.complete]
    if whole:
        best = next(n for n in whole if both[n][0] is analysis.best_row)
        wanted = (both[0][0].iteration + both[best][0].iteration) / 2
        between = [n for n in whole if n not in roles and n < best]
        if between:
            roles[min(between, key=lambda n: abs(both[n][0].iteration - wanted))] = "middle"
        roles[best] = "best"
    return [(role, *both[n]) for n, role in sorted(roles.items())]


def draw(analyses: Sequence[Analysis], style: Style) -> Figure:
    """Above the speeds of the first experiment's chosen trials with the reference, below their
    amplitudes with the limit; beats that wanted more than the limit are marked."""
    analysis = analyses[0]
    picked = chosen(analysis)
    with drawing(style):
        figure = blank(analyses[:1], style, 0.115 if style.wide else 0.092)
        speed, amplitude = figure.subplots(2, 1, sharex=True, height_ratios=[1.25, 1])
        lines = _speeds(speed, analysis, picked, style)
        marks = _amplitudes(amplitude, analysis, picked, style)
        speed.set_xlim(0, len(analysis.reference_m_s) * analysis.beat_s)
        amplitude.set_xlabel("time (s)")
        head_legend(figure, [*lines, *marks], 3 if style.wide else 2)
    return figure


def _speeds(
    axes: Axes, analysis: Analysis, picked: list[tuple[str, TrialRow, Trial]], style: Style
) -> list[Any]:
    reference = np.asarray(analysis.reference_m_s, np.float64) * 1e3
    edges = np.arange(len(reference) + 1) * analysis.beat_s
    axes.stairs(reference, edges, fill=True, color=_REFERENCE, lw=0, zorder=0.5)
    axes.stairs(reference, edges, color=GREY, lw=0.5, zorder=0.6, baseline=None)
    lines = [mpl_patches.Patch(facecolor=_REFERENCE, edgecolor=GREY, lw=0.5, label="reference")]
    top, low = float(np.max(reference, initial=1.0)), float(np.min(reference, initial=0.0))
    for role, row, trial in picked:
        values = trial.beats.speed_m_s.astype(np.float64) * 1e3
        lines.append(_curve(axes, values, analysis.beat_s, _ROLES[role], _name(role, row)))
        top, low = max(top, float(np.nanmax(values))), min(low, float(np.nanmin(values)))
    if not picked:
        nothing(axes, "no trial that counts was measured", style)
    axes.set_ylim(1.3 * low, 1.08 * top)
    axes.set_ylabel("speed (mm/s)")
    return lines


def _amplitudes(
    axes: Axes, analysis: Analysis, picked: list[tuple[str, TrialRow, Trial]], style: Style
) -> list[Any]:
    limit = math.degrees(analysis.amplitude_max_rad)
    top = 1.0
    any_saturated = False
    for role, _, trial in picked:
        applied = np.degrees(_executed_rad(trial))
        _curve(axes, applied, analysis.beat_s, _ROLES[role], "")
        at = np.flatnonzero(saturated(trial))
        axes.plot(
            (at + 0.5) * analysis.beat_s, applied[at], ls="", zorder=6, gid=f"saturated {role}",
            **_SATURATED,
        )  # fmt: skip
        any_saturated = any_saturated or bool(at.size)
        top = max(top, float(np.max(applied, where=np.isfinite(applied), initial=0.0)))
    if any_saturated or top > _LIMIT_SHOWN * limit:
        axes.axhline(limit, color=GREY, lw=0.8, ls=_LIMIT_DASH, zorder=1, gid="limit")
        axes.annotate(
            f"limit {limit:.0f}°", (0.995, limit), (0, 1.5), xycoords=("axes fraction", "data"),
            textcoords="offset points", ha="right", va="bottom", fontsize=style.small_pt,
        )  # fmt: skip
        top = max(top, limit)
    axes.set_ylim(0, 1.18 * top)
    axes.set_ylabel("amplitude (°)")
    return [entry("at the limit", ls="", **_SATURATED)] if any_saturated else []


_SATURATED: dict[str, Any] = {"marker": "o", "ms": 2.6, "mfc": "white", "mec": INK, "mew": 0.7}


def _curve(axes: Axes, values: F64, beat_s: float, look: Look, name: str) -> Any:
    """A line with gaps where nothing was measured; a beat between two gaps is a dot."""
    time = (np.arange(len(values)) + 0.5) * beat_s
    how: dict[str, Any] = {
        "color": look.colour,
        "lw": 1.5 if look.dash == "-" else 1.1,
        "zorder": 4,
    }
    (line,) = axes.plot(time, values, ls=look.dash, label=name, gid=f"beats {name}", **how)
    there = np.isfinite(values)
    padded = np.r_[False, there, False]
    alone = there & ~padded[:-2] & ~padded[2:]
    axes.plot(time[alone], values[alone], ".", ms=2.5, color=look.colour, zorder=4)
    return line


def saturated(trial: Trial) -> NDArray[np.bool_]:
    """Per beat: executed at the limit of that trial, where the law asked for more."""
    limit = trial.params.get("AMP_MAX_RAD", math.inf)
    return np.isfinite(_executed_rad(trial)) & (trial.beats.amplitude_rad > np.float32(limit))


def _executed_rad(trial: Trial) -> F64:
    """Amplitudes as executed; NaN from where the trial ended."""
    applied = trial.beats.applied_rad.astype(np.float64)
    return np.where(np.arange(len(applied)) < trial.executed_beats, applied, np.nan)


def _name(role: str, row: TrialRow) -> str:
    named = "" if role == "middle" else f", {role}"
    end = "" if row.end == "complete" else ", cut"
    return f"trial {row.trial}{named}{end}: {mm(row.max_abs_error_m_s)} mm/s"


def alternative(analyses: Sequence[Analysis]) -> str:
    """Text for who does not see the figure."""
    return marked(
        "Speed and tail amplitude per beat of chosen trials against the reference", analyses
    )


def caption(analyses: Sequence[Analysis]) -> str:
    """What the figure shows, and which trials these are."""
    analysis = analyses[0]
    picked = chosen(analysis)
    which = ", ".join(f"{row.trial} (iteration {row.iteration})" for _, row, _ in picked)
    text = (
        f"{'Trial' if len(picked) == 1 else 'Trials'} {which or 'none'} of "
        f"{len(analysis.last_rows)}. Top: mean speed of every beat and the "
        "reference; the numbers are max|e|. Bottom: tail amplitude as executed; circles: "
        f"saturated beats, at the limit of {math.degrees(analysis.amplitude_max_rad):.0f}°. "
        "Beats without a measured speed are gaps"
    )
    cut = [str(row.trial) for _, row, _ in picked if row.end != "complete"]
    return text + (f"; trial {', '.join(cut)} was cut short where its lines end." if cut else ".")
