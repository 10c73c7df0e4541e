"""Pictures of convergence: what a designed law lets expect, and what a series of trials reached.
Made to survive a black-and-white printer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tailbeat.learning.assessment import Progress, Row
from tailbeat.learning.design import Design
from tailbeat.report.style import (
    ACCENT,
    BAND,
    DASHED,
    DOTTED,
    GREY,
    INK,
    SCREEN,
    Axes,
    level,
    log_axis,
    mpl_ticker,
    picture,
)

_MARKS = {
    "progress": ("o", INK, "progress, or the first"),
    "first": ("o", INK, ""),
    "noise": ("o", "white", "within noise"),
    "worse": ("X", INK, "worse than noise"),
    "rolled_back": ("X", "white", "worse: rolled back"),
    "incomplete": ("|", GREY, "incomplete"),
}
_LABELS_MAX = 16


def draw_law(found: Design, thesis: Design, path: Path) -> None:
    """Draws the law beside the thesis's (gain 4, no lead) on the same fish: how fast errors shrink
    over frequency, and the series to expect. A PNG of 1600 x 800 px."""
    with picture(path, 1600, 800, "The designed law", _law_words(found)) as figure:
        box = {"left": 0.05, "right": 0.965, "bottom": 0.105, "top": 0.775, "wspace": 0.16}
        ratio, series = figure.subplots(1, 2, gridspec_kw=box)
        _draw_ratio(ratio, found, thesis)
        _draw_expected(series, found, thesis)


def _law_words(found: Design) -> str:
    low, high = (speed * 1e3 for speed in found.speeds_m_s)
    models = f"{found.models} models" if found.models > 2 else "one model"
    law = found.law
    lead = f"lead {law.lead_beats:g}" if law.lead_beats else "no lead"
    name = f"gain {law.kp_rad_s_m:g}, {lead}" + (f", filter {law.q_len}" if law.q_len > 1 else "")
    return f"{name}, for {models} of the fish at {low:.0f} to {high:.0f} mm/s"


def _draw_ratio(axes: Axes, found: Design, thesis: Design) -> None:
    f = found.frequency_cycles
    top = max(1.25, 1.08 * found.ratio_max, 1.08 * thesis.ratio_max)
    axes.axhspan(1.0, top, color="0.93", lw=0, zorder=0)
    level(axes, 1.0, "grows from trial to trial", left=True, color=GREY, lw=1.2)
    level(axes, 1.0, "shrinks", left=True, above=False, lw=0)
    axes.plot(f, thesis.ratio, color=INK, lw=2.0, ls=DASHED, zorder=3)
    axes.plot(f, found.ratio, color=ACCENT, lw=3.0, zorder=4)
    at = int(0.62 * len(f))
    above = thesis.ratio[at] > found.ratio[at]
    _label(axes, (f[at], thesis.ratio[at]), "thesis: gain 4, no lead", INK, above)
    _label(axes, (f[at], found.ratio[at]), "designed", ACCENT, not above)
    axes.set(xlim=(0, 0.5), ylim=(0, top), xlabel="frequency of the error, cycles/beat")
    axes.grid(axis="y")
    axes.set_title("Error left after one more trial, worst model")


def _label(axes: Axes, point: tuple[float, float], text: str, color: str, above: bool) -> None:
    """Beside a rising line."""
    axes.annotate(
        text, point, (-6, 8) if above else (6, -10), textcoords="offset points", color=color,
        ha="right" if above else "left", va="bottom" if above else "top", zorder=9,
    )  # fmt: skip


def _draw_expected(axes: Axes, found: Design, thesis: Design) -> None:
    series, bound = found.series, found.floor_m_s * 1e3
    median, low, high = (1e3 * a for a in (series.median_m_s, series.low_m_s, series.high_m_s))
    old = 1e3 * thesis.series.median_m_s
    i = np.arange(len(median))
    axes.fill_between(i, low, high, color=ACCENT, alpha=0.16, lw=0, zorder=1)
    axes.plot(i, old, color=INK, lw=2.0, ls=DASHED, zorder=3)
    axes.plot(i, median, "o-", color=ACCENT, lw=3.0, ms=9, zorder=4)
    text = f"L2-optimal input: {bound:.1f} mm/s"
    level(axes, bound, text, left=True, above=False, color=INK, lw=1.6, ls=DOTTED)
    place = min(3, len(i) - 1)
    for words, point, offset, color in (
        ("thesis", (place, old[place]), (9, 5), INK),
        ("designed:\nmedian and\n90 % of trials", (0.0, 1.45 * bound), (2, 0), ACCENT),
    ):
        axes.annotate(words, point, offset, textcoords="offset points", color=color)
    log_axis(axes, [bound, *low, *high, *old], (1.5, 1.2))
    axes.xaxis.set_major_locator(mpl_ticker.MaxNLocator(integer=True, nbins=12))
    axes.set(xlim=(-0.25, len(i) - 0.75), xlabel="iteration (0: baseline, u = 0)")
    axes.set_title("Largest error over the beats to expect, mm/s")


def draw_progress(found: Progress, path: Path) -> None:
    """Draws max|e| per trial with what noise explains, greys and shapes only. A PNG of
    1200 x 750 px."""
    with picture(path, 1200, 750, _assessment(found), _series_words(found)) as figure:
        axes = figure.add_axes((0.08, 0.12, 0.89, 0.665))
        if any(np.isfinite(row.max_abs_error_m_s) for row in found.rows):
            _draw_best(axes, found)
            _draw_trials(axes, found)
            _scale(axes, found)


def _assessment(found: Progress) -> str:
    if found.verdict.stop:
        return f"Stop: {found.verdict.stop_reason}"
    return f"Trial {found.rows[-1].trial}: {found.rows[-1].words.partition(' (')[0]}"


def _series_words(found: Progress) -> str:
    best = f"dashed: the best, {found.verdict.best_max_abs_error_m_s * 1e3:.1f} mm/s"
    parts = [best, "grey: 95 % of its repeats"] if found.verdict.best_trial else []
    if found.floor_m_s is not None:
        parts.append(f"dotted: the L2-optimal input, {found.floor_m_s * 1e3:.1f} mm/s")
    return "; ".join([f"reference {found.reference_crc:#010x}", *parts])


def _draw_best(axes: Axes, found: Progress) -> None:
    verdict = found.verdict
    if verdict.best_trial:
        best = verdict.best_max_abs_error_m_s
        middle = verdict.band.level_m_s if np.isfinite(verdict.band.level_m_s) else best
        down, up = (width * 1e3 for width in verdict.band.widths(best))
        axes.axhspan(middle * 1e3 - down, middle * 1e3 + up, color=BAND, lw=0, zorder=0)
        axes.axhline(best * 1e3, color=GREY, lw=1.3, ls=DASHED, zorder=1)
    if found.floor_m_s is not None:
        axes.axhline(found.floor_m_s * 1e3, color=INK, lw=1.5, ls=DOTTED, zorder=1)


def _draw_trials(axes: Axes, found: Progress) -> None:
    points = [
        (at, row.max_abs_error_m_s * 1e3, row.verdict)
        for at, row in enumerate(found.rows, 1)
        if np.isfinite(row.max_abs_error_m_s)
    ]
    whole = [(x, y) for x, y, kind in points if kind != "incomplete"]
    axes.plot([x for x, _ in whole], [y for _, y in whole], color=GREY, lw=1.6, zorder=2)
    for kind, (mark, face, label) in _MARKS.items():
        mine = [(x, y) for x, y, one in points if one == kind]
        if mine:
            axes.plot(
                *zip(*mine, strict=True), mark, ms=11, mfc=face, mec=INK, mew=1.8, ls="",
                label=label or None, zorder=4,
            )  # fmt: skip
    for x, y, _ in points if len(points) <= _LABELS_MAX else ():
        axes.annotate(
            f"{y:.1f}", (x, y), (7, 8), textcoords="offset points", fontsize=SCREEN.small_pt,
            zorder=5,
        )  # fmt: skip
    if len(axes.get_legend_handles_labels()[1]) > 1:  # one shape alone needs no legend
        axes.legend(loc="upper right")


def _scale(axes: Axes, found: Progress) -> None:
    values = [row.max_abs_error_m_s for row in found.rows] + [found.floor_m_s or np.nan]
    log_axis(axes, [1e3 * value for value in values if np.isfinite(value)], (1.6, 1.4))
    axes.set_xticks(range(1, len(found.rows) + 1), [_tick(row) for row in found.rows])
    axes.set(xlim=(0.4, len(found.rows) + 0.6), xlabel="trial (= the one it repeats)")
    axes.set_title("Largest error over the beats, mm/s")


def _tick(row: Row) -> str:
    return f"{row.trial}\n(= {row.repeat_of})" if row.repeat_of else f"{row.trial}"
