"""The figure of a Monte Carlo study: true max|e| over the iterations, with a 90 % band."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.core.files import replacing
from tailbeat.core.lazy import lazy
from tailbeat.studies.montecarlo.summary import GroupSummary, StudySummary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

mpl: Any = lazy("matplotlib")
mpl_figure: Any = lazy("matplotlib.figure")
mpl_ticker: Any = lazy("matplotlib.ticker")

LineStyle = str | tuple[int, tuple[int, ...]]

_INK, _FAINT = "0.15", "0.55"
_STYLES = (
    ("#0b5394", "-"), ("#b45f06", "--"), ("0.35", ":"), ("#38761d", "-."),
    ("#741b47", (0, (5, 1, 1, 1, 1, 1))),
)  # fmt: skip
_CORNERS_NAMED = 3  # more corners than that are drawn as one bundle
_ACROSS, _ACROSS_MAX = 3, 5  # panels in a row, and as many as that if they are the plants
_LEGENDS_MAX = 6  # panels with a legend each; more of them share one
_BANDS_MAX = 3  # laws in a panel whose bands can be told apart


def render(summary: StudySummary, path: Path) -> None:
    """Writes a PNG, a panel for every plant, noise and reference."""
    panels = _panels(summary.lines)
    plants = len({line.plant for line in summary.lines})
    across = min(len(panels), plants if 1 < plants <= _ACROSS_MAX else _ACROSS)
    down = math.ceil(len(panels) / across)
    style: dict[Any, Any] = {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False}
    with mpl.rc_context(style):
        figure = mpl_figure.Figure(
            figsize=(5.2 * across, 4.2 * down + 0.6), dpi=100, layout="constrained"
        )
        figure.suptitle(summary.title, fontweight="bold", x=0.02, ha="left", fontsize=14)
        grid = figure.subplots(down, across, squeeze=False, sharey=True)
        for axes in grid.flat[len(panels) :]:
            axes.axis("off")
        for i, (title, lines) in enumerate(panels):
            _panel(grid.flat[i], title, lines)
            if i % across == 0:
                grid.flat[i].set_ylabel("true max|e|, mm/s")
        _legends(figure, list(grid.flat[: len(panels)]))
        with replacing(path) as file:
            figure.savefig(file, format="png")


def _panels(lines: list[GroupSummary]) -> list[tuple[str, list[GroupSummary]]]:
    """(title, lines), a row of plants for each reference and noise."""
    order = [
        list(dict.fromkeys(getattr(line, name) for line in lines))
        for name in ("reference", "noise", "plant")
    ]
    found = []
    for key in product(*order):
        there = [line for line in lines if (line.reference, line.noise, line.plant) == key]
        if there:
            reference, noise, plant = key
            words = [plant, *([reference] if len(order[0]) > 1 else [])]
            words += [noise] if len(order[1]) > 1 else []
            found.append((", ".join(words), there))
    return found


def _panel(axes: Axes, title: str, lines: list[GroupSummary]) -> None:
    axes.set_title(title, loc="left", fontsize=11, color=_INK)
    laws = list(dict.fromkeys(line.law for line in lines))
    for law, (color, dash) in zip(laws, _styles(len(laws)), strict=True):
        bundle = [line for line in lines if line.law == law]
        for j, line in enumerate(bundle):
            _curve(axes, line, color, dash, _label(law, bundle, j), len(laws) <= _BANDS_MAX)
    floor = lines[0].floor_lsq_m_s * 1e3
    axes.axhline(floor, color=_FAINT, lw=1, label="floor")
    axes.set_title(f"floor {floor:.1f} mm/s", loc="right", fontsize=9, color=_FAINT)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(
        lambda value, _: f"{value:g}" if str(f"{value:g}")[0] in "25" else ""
    )
    axes.xaxis.set_major_locator(mpl_ticker.MaxNLocator(integer=True))
    axes.set_xlabel("iteration")
    axes.grid(axis="y", color="0.92", lw=0.8)


def _legends(figure: Figure, panels: list[Axes]) -> None:
    """One for all where the panels are many and draw the same laws."""
    entries = [panel.get_legend_handles_labels() for panel in panels]
    same = all(labels == entries[0][1] for _, labels in entries)
    if same and len(panels) > _LEGENDS_MAX:
        handles, labels = entries[0]
        figure.legend(handles, labels, loc="outside lower left", ncols=len(labels), frameon=False)
        return
    for panel in panels:
        panel.legend(frameon=False, fontsize=9, loc="best")


def _styles(count: int) -> list[tuple[str, LineStyle]]:
    return [_STYLES[i % len(_STYLES)] for i in range(count)]


def _label(law: str, bundle: list[GroupSummary], j: int) -> str:
    if len(bundle) <= _CORNERS_NAMED:
        return " ".join(word for word in (law, bundle[j].corner) if word)
    return f"{law}, {len(bundle)} corners" if j == 0 else ""


def _curve(
    axes: Axes, line: GroupSummary, color: str, dash: LineStyle, label: str, band: bool
) -> None:
    first = 1 if line.fixed else 0
    iteration = np.arange(first, len(line.median_m_s))
    median, low, high = (
        values[first:] * 1e3 for values in (line.median_m_s, line.low_m_s, line.high_m_s)
    )
    faint = 0.15 if not line.corner else 0.03
    if band:
        axes.fill_between(iteration, low, high, color=color, alpha=faint, lw=0)
    axes.plot(
        iteration, median, linestyle=dash, color=color, lw=1.6 if not line.corner else 0.9,
        label=label,
    )  # fmt: skip
