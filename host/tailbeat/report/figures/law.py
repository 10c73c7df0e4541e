"""The picture of a designed law: how fast errors shrink over frequency, and the series to expect.
Made to survive a black-and-white printer."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.core.files import replace_file
from tailbeat.learning.design import Design
from tailbeat.report.style import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_WIDTH_PX, _HEIGHT_PX, _DPI = 1600, 800, 100
_INK, _FAINT, _ACCENT = "0.15", "0.45", "#0b5394"  # the accent prints as dark grey
_DASHES: Any = (0, (5, 2.5))


def render_law(found: Design, thesis: Design, path: Path | None = None) -> bytes:
    """Draws the law beside the thesis's (gain 4, no lead) on the same fish, 1600 x 800 px; writes
    it to ``path`` if given. Returns the PNG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        size = (_WIDTH_PX / _DPI, _HEIGHT_PX / _DPI)
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        grid = figure.add_gridspec(
            1, 2, left=0.05, right=0.965, bottom=0.105, top=0.775, wspace=0.16
        )
        figure.text(0.02, 0.94, "The designed law", fontsize=25, fontweight="bold", va="center")
        figure.text(0.02, 0.885, _subtitle(found), fontsize=14.5, color="0.35", va="center")
        _draw_ratio(figure.add_subplot(grid[0, 0]), found, thesis)
        _draw_series(figure.add_subplot(grid[0, 1]), found, thesis)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=_DPI)
    png = out.getvalue()
    if path is not None:
        replace_file(path, png)
    return png


def _subtitle(found: Design) -> str:
    low, high = (speed * 1e3 for speed in found.speeds_m_s)
    models = f"{found.models} models" if found.models > 2 else "one model"
    return f"{_name(found)}, for {models} of the fish at {low:.0f} to {high:.0f} mm/s"


def _name(design: Design) -> str:
    law = design.law
    lead = f"lead {law.lead_beats:g}" if law.lead_beats else "no lead"
    return f"gain {law.kp_rad_s_m:g}, {lead}" + (f", filter {law.q_len}" if law.q_len > 1 else "")


def _draw_ratio(axes: Axes, found: Design, thesis: Design) -> None:
    f = found.frequency_cycles
    top = max(1.25, 1.08 * found.ratio_max, 1.08 * thesis.ratio_max)
    axes.axhspan(1.0, top, color="0.93", lw=0, zorder=0)
    axes.axhline(1.0, color=_FAINT, lw=1.2, zorder=1)
    axes.annotate("grows from trial to trial", (0.008, 1.0), (0, 5), textcoords="offset points",
                  fontsize=12.5, color="0.35", va="bottom")  # fmt: skip
    axes.annotate("shrinks", (0.008, 1.0), (0, -6), textcoords="offset points",
                  fontsize=12.5, color="0.35", va="top")  # fmt: skip
    axes.plot(f, thesis.ratio, color=_INK, lw=2.0, ls=_DASHES, zorder=3)
    axes.plot(f, found.ratio, color=_ACCENT, lw=3.0, zorder=4)
    at = int(0.62 * len(f))
    above = thesis.ratio[at] > found.ratio[at]
    _label(axes, (f[at], thesis.ratio[at]), "thesis: gain 4, no lead", _INK, above)
    _label(axes, (f[at], found.ratio[at]), "designed", _ACCENT, not above)
    axes.set_xlim(0, 0.5)
    axes.set_ylim(0, top)
    axes.grid(axis="y", color="0.88", lw=1)
    axes.set_xlabel("frequency of the error, cycles/beat")
    axes.set_title("Error left after one more trial, worst model")


def _label(axes: Axes, point: tuple[float, float], text: str, color: str, above: bool) -> None:
    """Beside a rising line."""
    axes.annotate(
        text, point, (-6, 8) if above else (6, -10), textcoords="offset points", fontsize=13.5,
        color=color, ha="right" if above else "left", va="bottom" if above else "top", zorder=9,
    )  # fmt: skip


def _draw_series(axes: Axes, found: Design, thesis: Design) -> None:
    from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

    series, floor = found.series, found.floor_m_s * 1e3
    median, low, high = (1e3 * a for a in (series.median_m_s, series.low_m_s, series.high_m_s))
    old = 1e3 * thesis.series.median_m_s
    i = np.arange(len(median))
    axes.set_yscale("log")
    axes.fill_between(i, low, high, color=_ACCENT, alpha=0.16, lw=0, zorder=1)
    axes.plot(i, old, color=_INK, lw=2.0, ls=_DASHES, zorder=3)
    axes.plot(i, median, "o-", color=_ACCENT, lw=3.0, ms=9, zorder=4)
    axes.axhline(floor, color=_INK, lw=1.6, ls=(0, (1.5, 2.5)), zorder=2)
    axes.annotate(f"floor (least squares) {floor:.1f} mm/s", (0.0, floor), (2, -7),
                  textcoords="offset points", va="top", fontsize=12.5, color=_INK)  # fmt: skip
    place = min(3, len(i) - 1)
    axes.annotate("thesis", (place, old[place]), (9, 5), textcoords="offset points", fontsize=13.5,
                  color=_INK)  # fmt: skip
    axes.annotate("designed:\nmedian and\n90 % of swims", (0.0, 1.45 * floor), (2, 0),
                  textcoords="offset points", fontsize=13.5, color=_ACCENT)  # fmt: skip
    bottom, top = min(floor, float(low.min())) / 1.5, float(max(high.max(), old.max())) * 1.2
    ticks = [t * 10.0**p for p in range(-3, 4) for t in (1, 2, 5) if bottom < t * 10.0**p < top]
    axes.set_ylim(bottom, top)
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=12))
    axes.set_xlim(-0.25, len(i) - 0.75)
    axes.grid(axis="y", color="0.92", lw=1)
    axes.set_xlabel("iteration (0: zero input, not swum)")
    axes.set_title("Largest error over the beats to expect, mm/s")
