"""The picture: error per iteration, speed and amplitude per trial. Made to survive a
black-and-white printer: greys, line styles and labels at the lines instead of colours."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.core.files import replace_file
from tailbeat.report.demo_data import Series, Swim

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_PX, _HEIGHT_PX, _DPI = 1600, 1000, 100
_INK = "0.15"
_FAINT = "0.55"
_REFERENCE = "0.86"
_ACCENT = "#0b5394"  # prints as dark grey
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 14,
    "axes.edgecolor": _FAINT,
    "axes.labelcolor": _INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 15,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 12,
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "xtick.labelsize": 13,
    "ytick.labelsize": 13,
}


def render_png(series: Series, path: Path | None = None) -> bytes:
    """Draws the series at 1600 x 1000 px; writes it to ``path`` if given. Returns the PNG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH_PX / _DPI, _HEIGHT_PX / _DPI), dpi=_DPI, facecolor="white")
        grid = figure.add_gridspec(
            2, 2, left=0.07, right=0.955, bottom=0.085, top=0.80,
            wspace=0.20, hspace=0.36, width_ratios=[0.82, 1.0],
        )  # fmt: skip
        _heading(figure, series)
        _draw_error(figure.add_subplot(grid[:, 0]), series)
        speed = figure.add_subplot(grid[0, 1])
        _draw_speed(speed, series)
        _draw_amplitude(figure.add_subplot(grid[1, 1], sharex=speed), series)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=_DPI)
    png = out.getvalue()
    if path is not None:
        replace_file(path, png)
    return png


def _heading(figure: Figure, series: Series) -> None:
    figure.text(0.02, 0.945, series.title, fontsize=25, fontweight="bold", va="center")
    figure.text(0.02, 0.895, series.subtitle, fontsize=14.5, color="0.35", va="center")
    if series.simulated:
        figure.text(
            0.955, 0.945, "SIMULATED", fontsize=15, fontweight="bold", ha="right", va="center",
            color="white", bbox={"boxstyle": "round,pad=0.45", "facecolor": "0.25", "lw": 0},
        )  # fmt: skip


def _draw_error(axes: Axes, series: Series) -> None:
    iteration = [0, *(swim.iteration for swim in series.swims)]
    error = np.array([series.start_error_m_s, *(s.max_abs_error_m_s for s in series.swims)]) * 1e3
    good = np.isfinite(error)
    axes.set_yscale("log")
    axes.plot(np.array(iteration)[good], error[good], color=_ACCENT, lw=2.4, zorder=3)
    axes.plot(iteration[:1], error[:1], "o", ms=11, mfc="white", mec=_ACCENT, mew=2.4, zorder=4)
    axes.plot(iteration[1:], error[1:], "o", ms=11, color=_ACCENT, zorder=4)
    if len(iteration) <= 13:
        for n, (i, value) in enumerate(zip(iteration, error, strict=True)):
            if np.isfinite(value):
                rises = n + 1 < len(error) and error[n + 1] > value
                axes.annotate(
                    _mm(value), (i, value), (0 if rises else 8, -22 if rises else 9),
                    textcoords="offset points", fontsize=13, ha="center" if rises else "left",
                    bbox={"boxstyle": "square,pad=0.05", "facecolor": "white", "lw": 0},
                )  # fmt: skip
    axes.annotate(
        "zero input, not swum", (0, error[0]), (40, 9), textcoords="offset points",
        fontsize=11.5, color="0.4",
    )  # fmt: skip
    _floor_line(axes, series)
    _error_axes(axes, series, error[good])


def _floor_line(axes: Axes, series: Series) -> None:
    if series.floor_m_s is None:
        return
    floor = series.floor_m_s * 1e3
    axes.axhline(floor, color=_INK, lw=1.6, ls=(0, (6, 4)), zorder=1)
    text = f"– –  floor {_mm(floor)} mm/s: no input can do better without noise"
    axes.annotate(  # at the bottom, clear of the numbers at points near the line
        text, (0.02, 0.025), xycoords="axes fraction", fontsize=12.5, color=_INK,
    )  # fmt: skip


def _error_axes(axes: Axes, series: Series, error: Any) -> None:
    from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator

    floor = (series.floor_m_s or np.inf) * 1e3
    low, high = min(float(error.min()), floor) / 1.55, float(error.max()) * 1.35
    axes.set_ylim(low, high)
    ticks = [t * 10.0**p for p in range(-3, 4) for t in (1, 2, 5) if low <= t * 10.0**p <= high]
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y", color="0.92", lw=1)
    last = series.swims[-1].iteration if series.swims else 1
    axes.set_xlim(-0.25, last + 0.55)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=12))
    axes.set_xlabel("iteration")
    axes.set_title("Largest error over the beats, mm/s")


def _draw_speed(axes: Axes, series: Series) -> None:
    reference = series.reference_m_s * 1e3
    axes.fill_between(series.mid_s, reference, color=_REFERENCE, lw=0, zorder=1)
    axes.plot(series.mid_s, reference, color="0.6", lw=1.2, zorder=1)
    curves = [swim.speed_m_s * 1e3 for swim in series.swims]
    _draw_swims(axes, series, curves)
    top = max([float(reference.max()), *(float(np.nanmax(c, initial=0)) for c in curves)])
    axes.set_ylim(0, top * 1.2)
    axes.set_title("Speed per beat, mm/s, by iteration")
    middle = len(reference) // 2
    axes.annotate(
        "reference", (series.mid_s[middle], 0), (0, 12), textcoords="offset points",
        ha="center", fontsize=12.5, color="0.4",
    )  # fmt: skip
    axes.tick_params(labelbottom=True)


def _draw_amplitude(axes: Axes, series: Series) -> None:
    curves = [np.degrees(swim.amplitude_rad) for swim in series.swims]
    limit = float(np.degrees(series.amplitude_max_rad))
    _draw_swims(axes, series, curves)
    top = max([1.0, *(float(np.nanmax(curve, initial=0)) for curve in curves)])
    if top > 0.75 * limit:
        axes.axhline(limit, color=_FAINT, lw=1.2, ls=(0, (2, 3)))
        axes.annotate(
            f"limit {limit:.0f}°", (1, limit), (-2, 4), xycoords=("axes fraction", "data"),
            textcoords="offset points", ha="right", fontsize=12.5, color="0.4",
        )  # fmt: skip
        top = limit
    axes.set_ylim(0, top * 1.2)
    axes.set_xlim(0, len(series.reference_m_s) * series.beat_s)
    axes.set_title("Tail amplitude per beat, degrees, by iteration")
    axes.set_xlabel("time, s")


def _draw_swims(axes: Axes, series: Series, curves: list[Any]) -> None:
    last = len(curves) - 1
    for i, (swim, curve) in enumerate(zip(series.swims, curves, strict=True)):
        axes.plot(series.mid_s, curve, zorder=3 + i, **_line(i, last, swim))
    named = sorted({0, min(1, last), last}) if curves else []
    for i, beat in zip(named, _label_beats(curves, named), strict=True):
        axes.annotate(
            f"{series.swims[i].iteration}", (series.mid_s[beat], curves[i][beat]),
            ha="center", va="center_baseline", fontsize=13, fontweight="bold",
            color=_ACCENT if i == last else "0.3", zorder=60,
            bbox={"boxstyle": "circle,pad=0.18", "facecolor": "white", "lw": 0},
        )  # fmt: skip


def _line(i: int, last: int, swim: Swim) -> dict[str, Any]:
    """The first three trials by line style, the later ones darker and darker, the last bold."""
    del swim
    if i == last:
        return {"color": _ACCENT, "lw": 3.0, "ls": "-"}
    grey = 0.62 - 0.4 * i / max(last, 1)
    style: Any = [(0, (1.2, 1.6)), (0, (5, 2)), (0, (7, 2, 1.2, 2))][i] if i < 3 else "-"
    return {"color": f"{grey:.2f}", "lw": 1.8 if i < 3 else 1.2, "ls": style}


def _label_beats(curves: list[Any], named: list[int]) -> list[int]:
    """For each named curve the beat where its label, set into the line, is clearest of the other
    curves and of the other labels."""
    beats: list[int] = []
    top = max([float(np.nanmax(curve, initial=0)) for curve in curves], default=0.0) or 1.0
    for i in named:
        mine = np.nan_to_num(curves[i])
        others = [np.nan_to_num(c) for j, c in enumerate(curves) if j != i]
        room = np.min([np.abs(mine - c) for c in others], axis=0) if others else np.ones(len(mine))
        room = np.where(mine > 0.12 * top, np.minimum(room, 0.12 * top), 0.0)
        middle = np.abs(np.arange(len(mine)) - 0.45 * len(mine)) / len(mine)
        room = room - 0.01 * top * middle
        for beat in beats:
            room[max(0, beat - 2) : beat + 3] = -np.inf
        beats.append(int(np.argmax(room)))
    return beats


def _mm(value: float) -> str:
    return f"{value:.0f}" if value >= 20 else f"{value:.1f}" if value >= 2 else f"{value:.2g}"
