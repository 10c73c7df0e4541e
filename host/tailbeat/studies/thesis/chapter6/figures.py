"""The figures of chapter 6."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter6.plants import (
    LONG,
    with_filter,
    with_filter_on_the_correction,
    without_filter,
)
from tailbeat.studies.thesis.example import Figure, Study
from tailbeat.studies.thesis.heat import CHAPTER6, heat_plant
from tailbeat.studies.thesis.picture import LINES, WANTED, legend, picture

_FIRST_OF_TEXT, _LAST_OF_TEXT = 13.20, 0.0371


def figures(study: Study, folder: Path) -> list[Figure]:
    """Figures 6.1 to 6.3 and one of the filter's place."""
    return [_errors(study, folder), _output(study, folder), _surface(study, folder),
            _filter(study, folder)]  # fmt: skip


def _errors(study: Study, folder: Path) -> Figure:
    run = study.run()
    path = folder / "fig6-1.png"
    with picture(path) as (axes,):
        axes.plot(run.iterations, run.max_abs_error, marker="o", ms=8, **LINES[0])
        axes.set_yscale("log")
        for text, place in ((f"{_FIRST_OF_TEXT:.2f}", 1.0), (f"{_LAST_OF_TEXT}", 0.0)):
            axes.axhline(float(text), color="0.4", lw=1.0)
            axes.annotate(
                f"{text}, of the text", (place, float(text)), (5 - 10 * place, 4),
                xycoords=("axes fraction", "data"), textcoords="offset points",
                ha="right" if place else "left", fontsize=12,
            )  # fmt: skip
        axes.set_xlabel("iteration i")
        axes.set_ylabel("max|e_i(t)|")
    first = float(run.max_abs_error[0])
    contradicts = (
        "" if abs(first - _FIRST_OF_TEXT) < 0.05 else
        f"The text starts at {_FIRST_OF_TEXT:.2f}; the heat that f brings in makes it {first:.2f}."
    )  # fmt: skip
    return Figure(path, "Fig. 6.1", "Largest error per iteration.", contradicts)


def _output(study: Study, folder: Path) -> Figure:
    run = study.run()
    path = folder / "fig6-2.png"
    with picture(path) as (axes,):
        axes.plot(run.traces["time"], run.traces["reference"], label="wanted", **WANTED)
        axes.plot(run.traces["time"], run.traces["output"], label="y of iteration 7", **LINES[0])
        axes.set_xlabel("t, min")
        axes.set_ylabel("y = w(0, t)")
        legend(axes)
    return Figure(path, "Fig. 6.2", "Output of iteration 7 and the reference.")


def _surface(study: Study, folder: Path) -> Figure:
    run = study.run()
    path = folder / "fig6-3.png"
    field_map(path, run.traces["time"], heat_plant(CHAPTER6).field(run.traces["input"]), "w")
    return Figure(path, "Fig. 6.3", "w(x, t) of iteration 7, as a map.")


def field_map(path: Path, time: F64, field: F64, name: str) -> None:
    """A field over place and time as a map with lines of equal height."""
    with picture(path) as (axes,):
        where = np.linspace(0.0, 1.0, field.shape[1])
        low, high = float(field.min()), float(field.max())
        light = high + 0.9 * (high - low)  # or lines and labels drown in black
        shades = axes.contourf(time, where, field.T, levels=24, cmap="Greys", vmin=low, vmax=light)
        lines = axes.contour(
            time, where, field.T, levels=8, colors="0.1", linewidths=1.0, negative_linestyles="--"
        )
        bar = axes.figure.colorbar(shades, ax=axes, ticks=lines.levels)
        bar.add_lines(lines)
        axes.grid(False)
        axes.set_xlabel("t, min")
        axes.set_ylabel("x")
        axes.set_title(f"{name}(x, t)", fontsize=14, fontweight="normal")


def _filter(study: Study, folder: Path) -> Figure:
    del study
    path = folder / "ch6-filter.png"
    runs = {
        "Q on input and correction, (6.31)": with_filter(LONG),
        "Q on the correction alone": with_filter_on_the_correction(LONG),
        "no Q": without_filter(LONG),
    }
    with picture(path) as (axes,):
        for (name, run), line in zip(runs.items(), LINES, strict=False):
            axes.plot(run.iterations, run.max_abs_error, label=name, **line)
        axes.set_yscale("log")
        axes.set_xlabel("iteration i")
        axes.set_ylabel("max|e_i(t)|")
        legend(axes)
    return Figure(path, "Ch. 6, where the filter acts", f"{LONG} trials on the exact rod.")
