"""The thesis's figures as data, and how they look: greys and line styles, made to survive a
printer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.extras import lazy
from tailbeat.core.files import write_whole
from tailbeat.report.style import ACCENT, SCREEN, Axes, mpl_figure, written
from tailbeat.report.style import drawing as figure_settings
from tailbeat.report.style import level as named_level

mpl: Any = lazy("matplotlib")
mpl_image: Any = lazy("matplotlib.image")

LINES: tuple[dict[str, Any], ...] = (
    {"color": ACCENT, "lw": 2.6, "ls": "-"},
    {"color": "0.15", "lw": 2.0, "ls": (0, (6, 2.5))},
    {"color": "0.35", "lw": 2.0, "ls": (0, (1.5, 1.8))},
    {"color": "0.5", "lw": 2.2, "ls": (0, (8, 2, 1.5, 2))},
    {"color": "0.62", "lw": 2.4, "ls": "-"},
    {"color": "0.25", "lw": 1.4, "ls": (0, (3, 1.5))},
)
REFERENCE: dict[str, Any] = {"color": "0.8", "lw": 6.0, "ls": "-", "zorder": 1}
THIN: dict[str, Any] = {"color": "0.4", "lw": 1.0}


@dataclass(frozen=True)
class Curve:
    """``style``: as ``Axes.plot`` takes it. ``fill``: shade up to these values instead."""

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    style: Mapping[str, Any] = field(default_factory=LINES[0].copy)
    fill: ArrayLike | None = None

    def plot(self, axes: Axes) -> None:
        """Draws it."""
        if self.fill is None:
            axes.plot(self.x, self.y, label=self.label or "_", **self.style)
        else:
            axes.fill_between(self.x, self.y, self.fill, color="0.88", lw=0, zorder=0)


@dataclass(frozen=True)
class Panel:
    """Axes. ``levels``: values that the text states, drawn across. ``more``: what else there is to
    draw. ``axes``: settings of ``Axes.set``, the labels among them. ``contradicts``: what the
    text's own numbers say against it."""

    curves: Sequence[Curve]
    axes: Mapping[str, Any]
    levels: Sequence[float] = ()
    columns: int = 2  # of the legend
    more: Callable[[Axes], None] | None = None
    contradicts: str = ""

    def plot(self, axes: Axes) -> None:
        """Draws all of it."""
        for curve in self.curves:
            curve.plot(axes)
        for value in self.levels:
            level(axes, value, f"{value:.4g}, of the text")
        if self.more is not None:
            self.more(axes)
        axes.set(**self.axes)
        if any(curve.label for curve in self.curves):
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=self.columns)


@dataclass(frozen=True)
class Panels:
    """Panels side by side or, not ``across``, on top of each other."""

    panels: Sequence[Panel]
    across: bool = True

    @property
    def contradicts(self) -> str:
        """What the text's own numbers say against them."""
        return "".join(panel.contradicts for panel in self.panels)


FORMATS = ("pdf", "svg", "png")
_SCREEN_DPI = 100


def with_ending(stem: Path, ending: str) -> Path:
    """Numbers of figures have a point in them: it is no ending."""
    return stem.with_name(f"{stem.name}.{ending}")


def draw(stem: Path, drawing: Panel | Panels) -> None:
    """Writes it as PDF, SVG and PNG. Labels are mathtext."""
    count, across = len(_all(drawing)), drawing.across if isinstance(drawing, Panels) else True
    size = (8.0 * count, 6.0) if across else (10.0, 4.2 * count)
    with sheets():
        sheet = mpl_figure.Figure(size, _SCREEN_DPI, facecolor="white", layout="constrained")
        compose(sheet, drawing)
        for kind in FORMATS:
            write_whole(with_ending(stem, kind), written(sheet, kind, _SCREEN_DPI))


@contextmanager
def sheets(text_pt: float = SCREEN.text_pt) -> Iterator[None]:
    """The settings these figures are made with."""
    style = replace(SCREEN, text_pt=text_pt)
    with figure_settings(style), mpl.rc_context({"text.parse_math": True}):
        yield


def compose(sheet: Any, drawing: Panel | Panels) -> None:
    """Puts the panels on a figure or a part of one."""
    panels = _all(drawing)
    across = drawing.across if isinstance(drawing, Panels) else True
    rows, columns = (1, len(panels)) if across else (len(panels), 1)
    for panel, axes in zip(panels, sheet.subplots(rows, columns, squeeze=False).flat, strict=True):
        axes.grid()
        panel.plot(axes)


def _all(drawing: Panel | Panels) -> Sequence[Panel]:
    return drawing.panels if isinstance(drawing, Panels) else [drawing]


def contact_sheet(pictures: Sequence[tuple[str, Path]], path: Path) -> None:
    """All of them in small, each under its name, on one PNG. ``pictures``: (name, PNG)."""
    columns = 6
    rows = -(-len(pictures) // columns)
    with figure_settings(SCREEN):
        sheet = mpl_figure.Figure((3.2 * columns, 2.6 * rows), _SCREEN_DPI, facecolor="white")
        grid = sheet.subplots(rows, columns, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        for axes, (name, picture) in zip(grid.flat, pictures, strict=False):
            axes.imshow(mpl_image.imread(picture))
            axes.set_title(name, fontsize=9)
        sheet.subplots_adjust(0.01, 0.01, 0.99, 0.97, 0.04, 0.16)
        write_whole(path, written(sheet, "png", _SCREEN_DPI))


def level(axes: Axes, value: float, text: str, place: float = 1.0) -> None:
    """A line across with its name above it, at its right end or, with ``place`` 0, its left."""
    named_level(axes, value, text, left=not place, fontsize=mpl.rcParams["xtick.labelsize"], **THIN)


def errors(
    series: Mapping[str, ArrayLike],
    first: int = 0,
    band: tuple[str, F64] | None = None,
    marker: float = 0.0,
    levels: Sequence[float] = (),
    columns: int = 2,
    more: Callable[[Axes], None] | None = None,
    contradicts: str = "",
    **axes: Any,
) -> Panel:
    """Errors per iteration, by name, on a logarithmic axis. ``band``: of many series (series,
    iterations) the median and the middle 80 %."""
    curves: list[Curve] = []
    if band is not None:
        low, median, high = np.quantile(band[1], (0.1, 0.5, 0.9), axis=0)
        at = np.arange(len(median))
        curves = [Curve(at, low, fill=high), Curve(at, median, band[0])]
    dots = {"marker": "o", "ms": marker} if marker else {}
    styles = LINES[len(curves) // 2 :]
    for (name, values), style in zip(series.items(), styles, strict=False):
        at = np.arange(first, first + len(np.asarray(values)))
        curves.append(Curve(at, values, name, style | dots))
    settings = {"yscale": "log", "xlabel": "iteration $i$", "ylabel": r"$\max_t\,|e_i(t)|$"} | axes
    return Panel(curves, settings, levels, columns, more, contradicts)


def field_map(
    time: F64, field: F64, name: str, contradicts: str = "", cut: float | None = None
) -> Panel:
    """A field (samples, nodes) over place and time as a map with lines of equal height. ``cut``:
    where what is higher was cut off."""
    where = np.linspace(0.0, 1.0, field.shape[1])
    low, high = float(field.min()), float(field.max())
    light = high + 0.9 * (high - low)  # or lines and labels drown in black

    def contours(axes: Axes) -> None:
        shades = axes.contourf(time, where, field.T, levels=24, cmap="Greys", vmin=low, vmax=light)
        lines = axes.contour(
            time, where, field.T, levels=8, colors="0.1", linewidths=1.0, negative_linestyles="--"
        )
        axes.figure.colorbar(shades, ax=axes, ticks=lines.levels).add_lines(lines)
        axes.grid(False)
        title = f"${name}(x, t)$" + (f", cut at {cut:g}" if cut else "")
        axes.set_title(title, fontsize=mpl.rcParams["font.size"], fontweight="normal")

    labels = {"xlabel": "$t$ (min)", "ylabel": "$x$"}
    return Panel([], labels, more=contours, contradicts=contradicts)
