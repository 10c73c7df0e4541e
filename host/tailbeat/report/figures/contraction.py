"""How much each iteration shrank the error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tailbeat.experiment.analysis import Analysis
from tailbeat.learning.convergence import student_t
from tailbeat.report.style import (
    BAND,
    INK,
    LOOKS,
    Axes,
    Figure,
    Style,
    blank,
    drawing,
    earlier_words,
    entry,
    freedom_words,
    head_legend,
    iteration_axis,
    labels,
    lane,
    legend_of_conditions,
    log_axis,
    marked,
    marker,
    mpl_patches,
    nothing,
    places,
)

_SHOWN = (0.5, 2.0)  # ratios; a band of noise is shown as far as that, trials always
_ROLLED: dict[str, Any] = {
    "marker": "X",
    "ms": 6.5,
    "mfc": "#d55e00",
    "mec": "white",
    "mew": 0.6,
    "ls": "",
}


def draw(analyses: Sequence[Analysis], style: Style) -> Figure:
    """max|e| of every trial over that of the iteration before, with what noise alone does."""
    with drawing(style):
        figure = blank(analyses, style, 0.062 if style.wide else 0.058)
        axes = figure.subplots()
        shown = [1.0]
        for at, analysis in enumerate(analyses):
            shown += _points(axes, analysis, at, len(analyses))
        iteration_axis(axes, [row.iteration for analysis in analyses for row in analysis.last_rows])
        axes.set_ylabel("max|e| over that of\nthe iteration before")
        if len(shown) == 1:
            nothing(axes, "one iteration has nothing to be compared with", style)
        log_axis(axes, [min(*shown, 0.6), max(*shown, 1.4)], (1.12, 1.12))
        axes.axhline(1.0, color=INK, lw=0.8, zorder=1, gid="no change")
        _legend(figure, analyses, style)
    return figure


def _points(axes: Axes, analysis: Analysis, at: int, of: int) -> list[float]:
    """The ratios drawn."""
    rows = analysis.last_rows
    where = places(rows, at, of)
    middle, width = lane(at, of)
    shown = []
    bands: dict[int, tuple[float, float]] = {}
    for x, row in zip(where, rows, strict=True):
        if not math.isfinite(row.contraction) or row.contraction <= 0 or not row.counts:
            continue
        style = marker("kept", LOOKS[at])
        axes.plot([x], [row.contraction], gid=f"contraction {row.trial}", **style)
        shown.append(row.contraction)
        if row.rolled_back:
            axes.plot([x], [row.contraction], zorder=6, gid=f"rolled {row.trial}", **_ROLLED)
        if math.isfinite(row.noise_low):
            bands[row.iteration] = row.noise_low, row.noise_high
    colour: Any = BAND if of == 1 else (LOOKS[at].colour, 0.16)
    for iteration, (low, high) in bands.items():
        axes.bar(
            iteration + middle, high - low, 0.56 * width, bottom=low, color=colour, lw=0,
            zorder=0.5, gid=f"noise {iteration}",
        )  # fmt: skip
    edges = [edge for band in bands.values() for edge in band]
    return shown + [min(max(edge, _SHOWN[0]), _SHOWN[1]) for edge in edges]


def _legend(figure: Figure, analyses: Sequence[Analysis], style: Style) -> None:
    drawn = [row for one in analyses for row in one.last_rows if math.isfinite(row.contraction)]
    entries: list[Any] = [*legend_of_conditions(labels(analyses))]
    freedoms = [one.noise_freedom for one in analyses if one.noise_freedom]
    if freedoms and any(math.isfinite(row.noise_low) for row in drawn):
        words = f"noise alone, 95 %, {freedom_words(*freedoms)}"
        entries.append(mpl_patches.Patch(color=BAND, lw=0, label=words))
    if any(row.rolled_back for row in drawn):
        entries.append(entry("rolled back to the best", **_ROLLED))
    head_legend(figure, entries, 6 if style.wide else 2)


def alternative(analyses: Sequence[Analysis]) -> str:
    """Text for who does not see the figure."""
    return marked("Ratio of the errors of successive iterations with the band of noise", analyses)


def caption(analyses: Sequence[Analysis]) -> str:
    """What the figure shows and where a ratio means nothing."""
    text = (
        "Contraction: max|e| of a kept trial over that of the last kept trial of the iteration "
        "before. It is shown where the law learned the input from that trial; below 1 the error "
        "decreased. "
    )
    known = [a for a in analyses if a.noise_freedom]
    if not known:
        text += "No input was repeated, so the ratio that disturbances alone cause is unknown."
        return text + earlier_words(analyses)
    sigma = "; ".join(
        f"σ = {a.noise_m_s * 1e3:.1f} mm/s between repeats, t = {student_t(a.noise_freedom):.3g} "
        f"({freedom_words(a.noise_freedom)})"
        for a in known
    )
    return (
        f"{text}Grey: where 95 % of the ratios of two trials of one input lie, 1 ± t·√2·σ over the "
        f"error before, {sigma}. A ratio inside is not significant.{earlier_words(analyses)}"
    )
