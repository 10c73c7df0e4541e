"""The picture of a series: max|e| per trial with what noise explains. Greys and shapes only."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.core.files import replace_file
from tailbeat.learning.assessment import Progress, Row
from tailbeat.report.style import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_WIDTH_PX, _HEIGHT_PX, _DPI = 1200, 750, 100
_INK, _GREY, _BAND = "0.1", "0.45", "0.88"
_MARKS = {
    "progress": ("o", _INK, "progress, or the first"),
    "first": ("o", _INK, ""),
    "noise": ("o", "white", "within noise"),
    "worse": ("X", _INK, "worse than noise"),
    "rolled_back": ("X", "white", "worse: rolled back"),
    "incomplete": ("|", _GREY, "incomplete"),
}
_LABELS_MAX = 16


def progress_png(found: Progress, path: Path | None = None) -> bytes:
    """Draws the series at 1200 x 750 px; writes it to ``path`` if given. Returns the PNG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH_PX / _DPI, _HEIGHT_PX / _DPI), dpi=_DPI, facecolor="white")
        axes = figure.add_axes((0.08, 0.12, 0.89, 0.70))
        figure.text(0.02, 0.955, _title(found), fontsize=18, fontweight="bold", va="center")
        figure.text(0.02, 0.905, _subtitle(found), fontsize=13, color="0.35", va="center")
        rows = [row for row in found.rows if np.isfinite(row.max_abs_error_m_s)]
        if rows:
            _band(axes, found)
            _trials(axes, found.rows, rows)
            _scale(axes, found, rows)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=_DPI)
    png = out.getvalue()
    if path is not None:
        replace_file(path, png)
    return png


def _title(found: Progress) -> str:
    if found.verdict.stop:
        return f"Stop: {found.verdict.stop_reason}"
    return f"Trial {found.rows[-1].trial}: {found.rows[-1].words.partition(' (')[0]}"


def _subtitle(found: Progress) -> str:
    best = f"dashed: the best, {found.verdict.best_max_abs_error_m_s * 1e3:.1f} mm/s"
    parts = [best, "grey: 95 % of its repeats"] if found.verdict.best_trial else []
    if found.floor_m_s is not None:
        parts.append(f"dotted: the floor (least squares), {found.floor_m_s * 1e3:.1f} mm/s")
    return "; ".join([f"reference {found.reference_crc:#010x}", *parts])


def _band(axes: Axes, found: Progress) -> None:
    verdict = found.verdict
    if verdict.best_trial:
        best = verdict.best_max_abs_error_m_s
        level = verdict.band.level_m_s if np.isfinite(verdict.band.level_m_s) else best
        down, up = (width * 1e3 for width in verdict.band.widths(best))
        axes.axhspan(level * 1e3 - down, level * 1e3 + up, color=_BAND, lw=0, zorder=0)
        axes.axhline(best * 1e3, color=_GREY, lw=1.3, ls=(0, (6, 4)), zorder=1)
    if found.floor_m_s is not None:
        axes.axhline(found.floor_m_s * 1e3, color=_INK, lw=1.5, ls=(0, (1, 2)), zorder=1)


def _trials(axes: Axes, every: list[Row], rows: list[Row]) -> None:
    place = {id(row): at + 1 for at, row in enumerate(every)}
    whole = [row for row in rows if row.verdict != "incomplete"]
    axes.plot(
        [place[id(row)] for row in whole], [row.max_abs_error_m_s * 1e3 for row in whole],
        color=_GREY, lw=1.6, zorder=2,
    )  # fmt: skip
    for kind, (mark, face, label) in _MARKS.items():
        mine = [row for row in rows if row.verdict == kind]
        if mine:
            axes.plot(
                [place[id(row)] for row in mine], [r.max_abs_error_m_s * 1e3 for r in mine],
                mark, ms=11, mfc=face, mec=_INK, mew=1.8, ls="", label=label or None, zorder=4,
            )  # fmt: skip
    for row in rows if len(rows) <= _LABELS_MAX else ():
        axes.annotate(
            f"{row.max_abs_error_m_s * 1e3:.1f}", (place[id(row)], row.max_abs_error_m_s * 1e3),
            (7, 8), textcoords="offset points", fontsize=12, zorder=5,
        )  # fmt: skip
    axes.set_xticks(range(1, len(every) + 1), [_tick(row) for row in every])
    if len(axes.get_legend_handles_labels()[1]) > 1:  # one shape alone needs no legend
        axes.legend(loc="upper right", frameon=False, fontsize=12)


def _tick(row: Row) -> str:
    return f"{row.trial}\n(= {row.repeat_of})" if row.repeat_of else f"{row.trial}"


def _scale(axes: Axes, found: Progress, rows: list[Row]) -> None:
    from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

    values = [row.max_abs_error_m_s * 1e3 for row in rows]
    if found.floor_m_s is not None:
        values.append(found.floor_m_s * 1e3)
    low, high = min(values) / 1.6, max(values) * 1.4
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    ticks = [t * 10.0**p for p in range(-3, 4) for t in (1, 1.5, 2, 3, 5, 7)]
    axes.yaxis.set_major_locator(FixedLocator([t for t in ticks if low <= t <= high]))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y", color="0.94", lw=1)
    axes.set_axisbelow(True)
    axes.set_xlim(0.4, len(found.rows) + 0.6)
    axes.set_xlabel("trial (= the one it repeats)")
    axes.set_title("Largest error over the beats, mm/s")
