"""The pictures of chapter 8. Which curves stand under these numbers in the thesis its text does not
tell; these are what the text around them speaks of."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.core.files import replacing
from tailbeat.core.lazy import lazy
from tailbeat.studies.thesis.chapter8.plants import (
    AMPLITUDE_MAX_RAD,
    TABLE_8_1,
    CruisePlant,
    FishTask,
    trials,
    wanted_beats,
)
from tailbeat.studies.thesis.example import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

mpl: Any = lazy("matplotlib")
mpl_figure: Any = lazy("matplotlib.figure")

_STYLE: dict[Any, Any] = {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False}
_INK, _FAINT = "0.15", "0.55"
_LINES = (("#0b5394", "-"), ("#b45f06", "--"), ("0.35", "-."))
_SHOWN = (1, 2, 3, 6)


def _save(canvas: Any, path: Path) -> None:
    with replacing(path) as file:
        canvas.savefig(file, format="png")


def draw_all(folder: Path) -> list[Figure]:
    """Writes fig8-3.png, fig8-4.png and figA-1.png."""
    return [_speeds(folder), _errors(folder), _thrust(folder)]


def _panels(rows: int) -> tuple[Any, Any]:
    canvas = mpl_figure.Figure(figsize=(7.2, 1.0 + 3.1 * rows), dpi=120, layout="constrained")
    return canvas, canvas.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]


def _speeds(folder: Path) -> Figure:
    with mpl.rc_context(_STYLE):
        canvas, (upper, lower) = _panels(2)
        for trial in trials(FishTask(4.0, max(_SHOWN))):
            if trial.iteration in _SHOWN:
                shade = 0.75 - 0.65 * _SHOWN.index(trial.iteration) / (len(_SHOWN) - 1)
                dash = ((0, (1, 1.2)), "--", "-.", "-")[_SHOWN.index(trial.iteration)]
                style = {"color": f"{shade:.2f}", "ls": dash, "where": "mid", "lw": 1.6}
                label = f"iteration {trial.iteration}"
                upper.step(trial.t_s, 1e3 * trial.speed_m_s, label=label, **style)
                lower.step(trial.t_s, trial.amplitude_rad, label=label, **style)
        upper.plot(trial.t_s, 1e3 * wanted_beats(), color="#b45f06", lw=2.4, alpha=0.6,
                   label="wanted (8.31)", zorder=1)  # fmt: skip
        upper.set_ylabel("speed, mean over a beat, mm/s")
        lower.set_ylabel("amplitude, rad")
        lower.set_xlabel("t, s")
        upper.set_ylim(0, 118)
        upper.legend(frameon=False, fontsize=9, loc="upper center", ncols=3)
        path = folder / "fig8-3.png"
        _save(canvas, path)
    return Figure(path, "Fig. 8.3", "speed and amplitude by beats, gain 4, with the wanted speed")


def _errors(folder: Path) -> Figure:
    with mpl.rc_context(_STYLE):
        canvas, (axes,) = _panels(1)
        for gain, (color, dash) in zip((4.0, 7.0, 10.0), _LINES, strict=True):
            errors = [1e3 * t.max_abs_error_m_s for t in trials(FishTask(gain, 20))]
            axes.plot(errors, dash, marker="o", ms=3.5, color=color, label=f"gain {gain:g}")
        axes.axhline(0.2 * 79.1, color=_FAINT, lw=1)
        axes.annotate("80 % down", (20, 0.2 * 79.1), (0, 3), textcoords="offset points",
                      ha="right", fontsize=9, color="0.35")  # fmt: skip
        _log(axes)
        axes.set_ylabel("max|e| over the beats, mm/s")
        axes.set_xlabel("iteration")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.legend(frameon=False, fontsize=9, loc="upper right")
        path = folder / "fig8-4.png"
        _save(canvas, path)
    return Figure(path, "Fig. 8.4", "largest error over the iterations, gains 4, 7 and 10")


def _thrust(folder: Path) -> Figure:
    angles = np.linspace(0, AMPLITUDE_MAX_RAD, 300)
    fish = CruisePlant(1.0)
    h1, h2 = fish.thrust(angles)
    with mpl.rc_context(_STYLE):
        canvas, (upper, lower) = _panels(2)
        for v, (color, dash) in zip((0.0, 0.1, 0.2), _LINES, strict=True):
            force = h1 - h2 * v**2
            upper.plot(angles, force, dash, color=color, label=f"v = {v:g} m/s")
            lower.plot(angles, np.gradient(force, angles, edge_order=2), dash, color=color)
        upper.set_ylabel("thrust F, N")
        lower.set_ylabel("dF/d(amplitude), N/rad")
        lower.set_xlabel("amplitude, rad")
        drag = fish.config.drag_kg_m
        steady = [(angle, drag * speed**2) for angle, speed in TABLE_8_1]
        upper.plot(*np.array(steady).T, "o", color=_INK, mfc="white", label="drag at Table 8.1")
        upper.legend(frameon=False, fontsize=9, loc="upper left")
        for axes in (upper, lower):
            axes.set_ylim(bottom=0)
            axes.set_xlim(0, 0.8)
        path = folder / "figA-1.png"
        _save(canvas, path)
    return Figure(
        path, "Fig. A.1", "thrust (8.5)-(8.10) and its slope, which Lemma 8.1 needs above 0"
    )


def _log(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(axis="y", color="0.92", lw=0.8)
