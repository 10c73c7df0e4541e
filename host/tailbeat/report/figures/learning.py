"""The error of every trial, iteration by iteration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.experiment.analysis import Analysis, IterationStatistics
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.style import (
    BAND,
    DASHED,
    DOTTED,
    GREY,
    INK,
    KINDS,
    LOOKS,
    Axes,
    Figure,
    Look,
    Style,
    blank,
    drawing,
    earlier_words,
    entry,
    head_legend,
    iteration_axis,
    kind_of,
    labels,
    lane,
    legend_of_conditions,
    legend_of_kinds,
    level,
    log_axis,
    marked,
    marker,
    mm,
    mpl_patches,
    nothing,
    places,
)

BAND_SWIMS_MIN = 3  # fewer have no 5 to 95 % band worth the name
_SHADE = 0.16


def draw(analyses: Sequence[Analysis], style: Style) -> Figure:
    """Two panels, max|e| and RMS, logarithmic: every trial, the median per iteration, the 5 to 95 %
    band where there are three trials or more, and what any input can reach."""
    with drawing(style):
        figure = blank(analyses, style, 0.072 if style.wide else 0.104)
        shape: dict[str, Any] = {"ncols": 2} if style.wide else {"nrows": 2, "sharex": True}
        above, below = figure.subplots(squeeze=True, **shape)
        _panel(above, analyses, "max", style)
        _panel(below, analyses, "rms", style)
        if not style.wide:
            above.set_xlabel("")
        _legend(figure, analyses, style)
    return figure


def _panel(axes: Axes, analyses: Sequence[Analysis], what: str, style: Style) -> None:
    shown: list[float] = []
    for at, (analysis, look) in enumerate(zip(analyses, LOOKS, strict=False)):
        shown += _points(axes, analysis, look, what, (at, len(analyses)))
    axes.set_ylabel("max|e| (mm/s)" if what == "max" else "RMS error (mm/s)")
    iteration_axis(axes, [row.iteration for analysis in analyses for row in analysis.last_rows])
    if not shown:
        nothing(axes, "no trial was measured", style)
        return
    shown += _levels(axes, analyses, what, style)
    log_axis(axes, shown, (1.22, 1.25))


def _points(
    axes: Axes, analysis: Analysis, look: Look, what: str, side: tuple[int, int]
) -> list[float]:
    """The values drawn, mm/s."""
    rows = analysis.last_rows
    values = [1e3 * _value(row, what) for row in rows]
    where = places(rows, *side)
    shown = []
    for kind in KINDS:
        points = [
            (x, y)
            for x, y, row in zip(where, values, rows, strict=True)
            if kind_of(row) == kind and math.isfinite(y) and y > 0
        ]
        if points:
            axes.plot(*zip(*points, strict=True), gid=f"swims {kind}", **marker(kind, look))
            shown += [y for _, y in points]
    _median_and_band(axes, analysis.band, look, what, side)
    return shown


def _value(row: TrialRow, what: str) -> float:
    return row.max_abs_error_m_s if what == "max" else row.rms_error_m_s


def _median_and_band(
    axes: Axes, band: IterationStatistics, look: Look, what: str, side: tuple[int, int]
) -> None:
    median, low, high = (1e3 * one for one in _of_band(band, what))
    middle, width = lane(*side)
    x = band.iteration + middle
    good = np.isfinite(median) & (median > 0)
    line = axes.plot(x[good], median[good], color=look.colour, ls=look.dash, lw=1.1, zorder=2.5)
    line[0].set_gid(f"median {what}")
    broad = good & (band.swims >= BAND_SWIMS_MIN) & (low > 0)
    colour: Any = BAND if side[1] == 1 else (look.colour, _SHADE)
    axes.bar(
        x[broad], (high - low)[broad], 0.56 * width, bottom=low[broad], color=colour, lw=0,
        zorder=0.5, gid=f"band {what}",
    )  # fmt: skip


def _of_band(band: IterationStatistics, what: str) -> tuple[F64, ...]:
    if what == "max":
        return band.max_median_m_s, band.max_low_m_s, band.max_high_m_s
    return band.rms_median_m_s, band.rms_low_m_s, band.rms_high_m_s


def _levels(axes: Axes, analyses: Sequence[Analysis], what: str, style: Style) -> list[float]:
    """Baseline, error bound, L2-optimal input: mm/s of those drawn; the last two of max|e|
    alone. Labels lie where the trials are not: early below, late above."""
    look: dict[str, Any] = {"lw": 0.8, "fontsize": style.small_pt}
    drawn = []
    zero = start_m_s(analyses[0], what) * 1e3
    if math.isfinite(zero) and zero > 0:
        text = f"baseline {zero:.1f}"
        level(axes, zero, text, color=GREY, ls=DOTTED, left=False, above=True, **look)
        drawn.append(zero)
    if what == "max":
        drawn += _floors(axes, analyses, look)
    return drawn


def start_m_s(analysis: Analysis, what: str) -> float:
    """The error of the baseline, u = 0."""
    if what == "max":
        return analysis.start_error_m_s
    squares = [float(speed) ** 2 for speed in analysis.reference_m_s]
    return math.sqrt(math.fsum(squares) / len(squares))


def _floors(axes: Axes, analyses: Sequence[Analysis], look: dict[str, Any]) -> list[float]:
    drawn = []
    known = {mm(a.floor_m_s): a for a in analyses if math.isfinite(a.floor_m_s)}
    names = dict(zip(map(id, analyses), labels(analyses), strict=True))
    for text, analysis in known.items():
        whose = f" ({names[id(analysis)]})" if len(known) > 1 else ""
        line = analysis.floor_m_s * 1e3
        colour = LOOKS[list(analyses).index(analysis)].colour if len(known) > 1 else INK
        words = f"error bound {text}{whose}"
        level(axes, line, words, color=colour, ls=DASHED, left=True, above=False, **look)
        drawn.append(line)
    squares = analyses[0].floor_lsq_m_s
    if len(analyses) == 1 and math.isfinite(squares):
        text = f"L2-optimal {mm(squares)}"
        level(axes, squares * 1e3, text, color=GREY, ls=DOTTED, left=True, above=True, **look)
        drawn.append(squares * 1e3)
    return drawn


def _legend(figure: Figure, analyses: Sequence[Analysis], style: Style) -> None:
    kinds = legend_of_kinds(analyses)
    single = len(analyses) == 1
    median = entry("median", color=INK if single else GREY, lw=1.1)
    entries: list[Any] = [*legend_of_conditions(labels(analyses)), *kinds, median]
    if any((analysis.band.swims >= BAND_SWIMS_MIN).any() for analysis in analyses):
        entries.append(mpl_patches.Patch(color=BAND, lw=0, label="5 to 95 %"))
    head_legend(figure, entries, (6 if single else 3) if style.wide else 2)


def alternative(analyses: Sequence[Analysis]) -> str:
    """Text for who does not see the figure."""
    band = analyses[0].band
    medians = ", ".join(
        f"{int(iteration)}: {mm(value)}"
        for iteration, value in zip(band.iteration, band.max_median_m_s, strict=True)
        if math.isfinite(value)
    )
    words = marked("Error of every trial per iteration, logarithmic", analyses)
    return f"{words} Median max|e| in mm/s by iteration: {medians or 'none'}."


def caption(analyses: Sequence[Analysis]) -> str:
    """What the figure shows, with how many trials and what band and levels are."""
    rows = [row for analysis in analyses for row in analysis.last_rows]
    text = (
        f"Error per iteration over {len(rows)} trial{'s' * (len(rows) != 1)}{_left_out(rows)}. "
        "Top: largest |e| over the beats; bottom: root of the mean square. e is the reference minus"
        " the mean speed of a beat. Every trial is a point. Trials of one iteration lie side by"
        " side in "
        "the order they were executed; the line joins their medians"
    )
    if any((analysis.band.swims >= BAND_SWIMS_MIN).any() for analysis in analyses):
        text += f"; grey, for {BAND_SWIMS_MIN} trials per iteration or more: 5th to 95th percentile"
    if any(kind_of(row) == "incomplete" for row in rows):
        text += (
            ". Bars: trials cut short or with unmeasured beats, by the beats they have, in no "
            "statistic"
        )
    text += ". Baseline: no input (u = 0)."
    return text + _floor_words(analyses) + earlier_words(analyses)


def _left_out(rows: Sequence[TrialRow]) -> str:
    """Which trials are drawn and no more."""
    discarded = sum(not row.counts and not row.undecided for row in rows)
    undecided = sum(row.undecided for row in rows)
    parts = [f"{discarded} discarded"] * bool(discarded)
    parts += [f"{undecided} not decided on"] * bool(undecided)
    return f", of which in no statistic: {', '.join(parts)}" if parts else ""


def _floor_words(analyses: Sequence[Analysis]) -> str:
    known = [analysis for analysis in analyses if math.isfinite(analysis.floor_m_s)]
    if not known:
        return ""
    fish = "simulated" if all(a.floor_by == "simulator" for a in known) else "identified"
    words = (
        f" Error bound: the smallest max|e| of any input on the {fish} fish without noise. A "
        "single trial can be below it"
    )
    if len(analyses) == 1 and math.isfinite(known[0].floor_lsq_m_s):
        words += "; L2-optimal: max|e| of the input with the smallest RMS"
    return words + "."
