"""Two laws on the same fish: the error of every trial, and the best trial of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.files import write_whole
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.style import (
    DASHED,
    GREY,
    INK,
    PAGE,
    Axes,
    Look,
    blank,
    drawing,
    entry,
    head_legend,
    level,
    log_axis,
    mm,
    mpl_patches,
    mpl_ticker,
    written,
)

_LOOKS = (Look("#d55e00", "s", (0, (5, 1.6))), Look("#00507d", "o", "-"))
_REFERENCE = "0.86"
_HEIGHT_M = 0.082


@dataclass(frozen=True)
class LawRun:
    """``measuring_runs``: executed before the first trial."""

    name: str
    measuring_runs: int
    analysis: Analysis

    @property
    def best(self) -> TrialRow:
        """The trial with the smallest max|e|."""
        return min(self.analysis.rows, key=lambda row: row.max_abs_error_m_s)

    def run_of(self, row: TrialRow) -> int:
        """The how-manieth run in the water it was, from 1."""
        return self.measuring_runs + self.analysis.rows.index(row) + 1


def draw_two_laws(runs: Sequence[LawRun], bound_m_s: float | None, path: Path) -> None:
    """Left max|e| of every run, logarithmic, with the error bound; right the speed of both best
    trials with the reference. A PNG. Raises InputError when it cannot be written."""
    with drawing(PAGE):
        figure = blank([one.analysis for one in runs], PAGE, _HEIGHT_M)
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.1])
        _errors(left, runs, bound_m_s)
        _speeds(right, runs)
        entries = [
            entry(_name(one), color=look.colour, ls=look.dash, marker=look.marker, ms=4)
            for one, look in zip(runs, _LOOKS, strict=True)
        ]
        patch = mpl_patches.Patch(facecolor=_REFERENCE, edgecolor=GREY, lw=0.5, label="reference")
        head_legend(figure, [*entries, patch], 2)
        write_whole(path, written(figure, "png"))


def _name(one: LawRun) -> str:
    best = one.best
    return f"{one.name}: best {mm(best.max_abs_error_m_s)} mm/s, trial {one.run_of(best)}"


def _errors(axes: Axes, runs: Sequence[LawRun], bound_m_s: float | None) -> None:
    shown: list[float] = []
    for one, look in zip(runs, _LOOKS, strict=True):
        rows = [row for row in one.analysis.rows if math.isfinite(row.max_abs_error_m_s)]
        x, y = [one.run_of(row) for row in rows], [row.max_abs_error_m_s * 1e3 for row in rows]
        how: dict[str, Any] = {"color": look.colour, "lw": 1.1, "ms": 4, "zorder": 4}
        axes.plot(x, y, ls=look.dash, marker=look.marker, gid=one.name, **how)
        best, size = one.run_of(one.best), one.best.max_abs_error_m_s * 1e3
        axes.plot(best, size, "o", ms=10, mfc="none", mec=look.colour, mew=1.0, zorder=5)
        shown += y
    if bound_m_s is not None:
        words = f"error bound {mm(bound_m_s)}\nwithout noise"
        how = {"fontsize": PAGE.small_pt, "ls": DASHED, "color": INK, "lw": 0.8}
        level(axes, bound_m_s * 1e3, words, left=True, above=False, **how)
        shown.append(bound_m_s * 1e3)
    log_axis(axes, shown, (2.2, 1.25))
    _measuring(axes, max(one.measuring_runs for one in runs))
    last = max(one.measuring_runs + len(one.analysis.rows) for one in runs)
    axes.set_xlim(0.4, last + 0.6)
    axes.xaxis.set_major_locator(mpl_ticker.MaxNLocator(integer=True))
    axes.set_xlabel("trial, with those for identification")
    axes.set_ylabel("largest error of any beat (mm/s)")


def _measuring(axes: Axes, count: int) -> None:
    if not count:
        return
    axes.axvspan(0.4, count + 0.5, color=_REFERENCE, alpha=0.5, lw=0, zorder=0.2)
    axes.annotate(
        f"{count} identification\ntrials", (0.02, 0.03),
        xycoords="axes fraction", fontsize=PAGE.small_pt, color=INK, va="bottom", zorder=6,
    )  # fmt: skip


def _speeds(axes: Axes, runs: Sequence[LawRun]) -> None:
    analysis = runs[0].analysis
    reference = np.asarray(analysis.reference_m_s, np.float64) * 1e3
    edges = np.arange(len(reference) + 1) * analysis.beat_s
    axes.stairs(reference, edges, fill=True, color=_REFERENCE, lw=0, zorder=0.5)
    axes.stairs(reference, edges, color=GREY, lw=0.5, zorder=0.6, baseline=None)
    for one, look in zip(runs, _LOOKS, strict=True):
        speed = one.analysis.trials[one.analysis.rows.index(one.best)].beats.speed_m_s
        middle = edges[:-1] + analysis.beat_s / 2
        axes.plot(middle, speed.astype(np.float64) * 1e3, ls=look.dash, color=look.colour, zorder=4)
    axes.set_xlim(0, edges[-1])
    axes.set_ylim(0, 1.12 * float(reference.max()))
    axes.set_xlabel("time in the best trial (s)")
    axes.set_ylabel("speed (mm/s)")
