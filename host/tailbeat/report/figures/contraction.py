"""How much each iteration shrank the error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tailbeat.report.figures import swims
from tailbeat.report.figures.style import (
    BAND,
    INK,
    LOOKS,
    Style,
    blank,
    drawing,
    head_legend,
    iteration_axis,
    labels,
    log_axis,
    nothing,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tailbeat.experiment.analysis import Analysis, TrialRow

_SIGMAS = 1.96 * math.sqrt(2)  # 95 % of the difference of two swims of one input
_LEAST = 0.05
_SHOWN = (0.5, 2.0)  # ratios; a band of noise is shown as far as that, swims always
_ROLLED: dict[str, Any] = {
    "marker": "X",
    "ms": 6.5,
    "mfc": "#d55e00",
    "mec": "white",
    "mew": 0.6,
    "ls": "",
}


def noise_of(analysis: Analysis, row: TrialRow) -> tuple[float, float]:
    """Ratios between which 95 % lie when nothing but noise differs, around 1 at the error that
    ``row`` is compared with; NaN without repeats."""
    before_m_s = row.max_abs_error_m_s / row.contraction
    half = _SIGMAS * analysis.noise_m_s / before_m_s
    return max(_LEAST, 1 - half), 1 + half


def draw(analyses: Sequence[Analysis], style: Style) -> Figure:
    """max|e| of every swim over that of the iteration before, with what noise alone does."""
    with drawing(style):
        figure = blank(analyses, style, 0.062 if style.wide else 0.058)
        axes = figure.subplots()
        shown = [1.0]
        for at, analysis in enumerate(analyses):
            shown += _swims(axes, analysis, at, len(analyses))
        iteration_axis(axes, [row.iteration for analysis in analyses for row in analysis.rows])
        axes.set_ylabel("max|e| over that of\nthe iteration before")
        if len(shown) == 1:
            nothing(axes, "one iteration has nothing to be compared with", style)
        log_axis(axes, [min(*shown, 0.6), max(*shown, 1.4)], (1.12, 1.12))
        axes.axhline(1.0, color=INK, lw=0.8, zorder=1, gid="no change")
        _legend(figure, analyses, style)
    return figure


def _swims(axes: Axes, analysis: Analysis, at: int, of: int) -> list[float]:
    """The ratios drawn."""
    where = swims.places(analysis.rows, at, of)
    middle, width = swims.lane(at, of)
    shown = []
    bands: dict[int, tuple[float, float]] = {}
    for x, row in zip(where, analysis.rows, strict=True):
        if not math.isfinite(row.contraction) or row.contraction <= 0 or not row.counts:
            continue
        style = swims.marker(swims.kind_of(row), LOOKS[at])
        axes.plot([x], [row.contraction], gid=f"contraction {row.trial}", **style)
        shown.append(row.contraction)
        if row.rolled_back:
            axes.plot([x], [row.contraction], zorder=6, gid=f"rolled {row.trial}", **_ROLLED)
        if math.isfinite(analysis.noise_m_s):
            bands[row.iteration] = noise_of(analysis, row)
    colour: Any = BAND if of == 1 else (LOOKS[at].colour, 0.16)
    for iteration, (low, high) in bands.items():
        axes.bar(
            iteration + middle, high - low, 0.56 * width, bottom=low, color=colour, lw=0,
            zorder=0.5, gid=f"noise {iteration}",
        )  # fmt: skip
    edges = [edge for band in bands.values() for edge in band]
    return shown + [min(max(edge, _SHOWN[0]), _SHOWN[1]) for edge in edges]


def _legend(figure: Figure, analyses: Sequence[Analysis], style: Style) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    counted = [row for analysis in analyses for row in analysis.rows if row.counts]
    kinds = [one for one in swims.legend_of_kinds(analyses) if one.get_label() != "discarded"]
    entries: list[Any] = [*swims.legend_of_conditions(labels(analyses)), *kinds]
    if any(math.isfinite(analysis.noise_m_s) for analysis in analyses):
        entries.append(Patch(color=BAND, lw=0, label="noise alone, 95 %"))
    if any(row.rolled_back for row in counted):
        entries.append(Line2D([], [], label="rolled back to the best", **_ROLLED))
    head_legend(figure, entries, 6 if style.wide else 2)


def caption(analyses: Sequence[Analysis]) -> str:
    """What the figure shows and where a ratio means nothing."""
    text = (
        "Contraction: max|e| of a swim over that of the last kept swim of the iteration before; "
        "below 1 the error shrank. "
    )
    known = [a for a in analyses if math.isfinite(a.noise_m_s)]
    if not known:
        return text + "No input was repeated, so it is not known what noise alone does."
    sigma = ", ".join(f"{a.noise_m_s * 1e3:.1f}" for a in known)
    return text + (
        "Grey: where 95 % of the ratios of two swims of one input lie, 1 ± 1.96·√2·σ over the "
        f"error before, with σ = {sigma} mm/s between repeats; a ratio in there proves nothing."
    )
