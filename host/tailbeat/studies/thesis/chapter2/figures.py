"""The figures of chapter 2."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.studies.thesis.chapter2.plants import (
    EXAMPLE1,
    EXAMPLE1_N30,
    SUBSTITUTE,
    TIMES,
    WANTED,
    Average,
    reached_probability,
)
from tailbeat.studies.thesis.example import ExampleRun, Figure, Study
from tailbeat.studies.thesis.picture import ACCENT, LINES, legend, picture
from tailbeat.studies.thesis.picture import WANTED as WANTED_LINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SEEDS = range(1, 101)
_LAST = 80


def _error_axes(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.set_xlabel("iteration i")
    axes.set_ylabel("max|e_i(t)|")


def _band(axes: Axes, setting: Average, name: str, line: int) -> None:
    errors = setting.series(_SEEDS, _LAST).max_abs_error
    low, median, high = np.quantile(errors, (0.1, 0.5, 0.9), axis=0)
    at = np.arange(_LAST + 1)
    axes.fill_between(at, low, high, color="0.88", lw=0, zorder=0)
    axes.plot(at, median, label=name, **LINES[line])


def _bound(axes: Axes, value: float) -> None:
    axes.axhline(value, color="0.4", lw=1.0)
    axes.annotate(
        f"{value:g}, of the text", (1.0, value), (0, 4), xycoords=("axes fraction", "data"),
        textcoords="offset points", ha="right", fontsize=12,
    )  # fmt: skip


def example1(study: Study, folder: Path) -> list[Figure]:
    full, random = study.run(lengths="full", iterations=_LAST), study.run(iterations=_LAST)
    assert random.executed is not None
    path = folder / "ch2-ex1-error.png"
    with picture(path) as (axes,):
        _band(axes, EXAMPLE1, "median, 80 % of 100 seeds (grey)", 0)
        axes.plot(full.iterations, full.max_abs_error, label="uncut trials", **LINES[1])
        axes.plot(random.iterations, random.executed, label="executed part, seed 1", **LINES[2])
        _bound(axes, 0.0098)
        _error_axes(axes)
        legend(axes)
    first = float(full.max_abs_error[0])
    starts = f"The text starts at 1.801; from u_0 = 0 and x_0 = 0 it is max|y_d| = {first:.4f}."
    contradicts = "" if abs(first - 1.801) < 5e-4 else starts
    return [
        _reached(folder),
        Figure(path, "Ch. 2, example 1, max|e|", "Error per iteration, N = 5.", contradicts),
        _outputs(random, folder / "ch2-ex1-output.png", "Ch. 2, example 1, outputs"),
    ]


def _reached(folder: Path) -> Figure:
    path = folder / "fig2-2.png"
    times = np.arange(13)
    with picture(path) as (axes,):
        likely = reached_probability(times, 10, 3, 2, (1 / 6,) * 6)
        axes.vlines(times, 0.0, likely, color=ACCENT, lw=2.4)
        axes.plot(times, likely, "o", ms=9, color=ACCENT)
        axes.set_xlabel("sample t")
        axes.set_ylabel("probability p(t) that a trial gets there")
        axes.set_ylim(0.0, 1.08)
    caption = "p(t), (2.5), for T_d = 10, N_1 = 3, N_2 = 2 and equally likely lengths."
    return Figure(path, "Fig. 2.2", caption)


def _outputs(run: ExampleRun, path: Path, name: str) -> Figure:
    kept = {i: trial for i, trial in run.traces["kept"].items() if i < len(run.iterations)}
    assert run.lengths is not None
    with picture(path, panels=len(kept), across=False) as axes:
        for one, (i, (_, outputs)) in zip(axes, kept.items(), strict=True):
            until = min(float(run.lengths[i]), float(TIMES[-1]))
            one.plot(TIMES, WANTED, label="wanted y_d", **WANTED_LINE)
            one.plot(TIMES, outputs[0], **LINES[2])
            reached = until >= TIMES
            one.plot(TIMES[reached], outputs[0][reached], label=f"y, iteration {i}", **LINES[0])
            if until < TIMES[-1]:
                one.axvline(until, color="0.4", lw=1.0)
            one.set_ylabel("y")
            legend(one, ncols=2)
        axes[-1].set_xlabel("sample t")
    caption = "Output of some iterations; dotted: beyond the trial's end, which is not measured."
    return Figure(path, name, caption)


def example1_n30(study: Study, folder: Path) -> list[Figure]:
    path = folder / "ch2-ex1-n30-error.png"
    with picture(path) as (axes,):
        _band(axes, EXAMPLE1_N30, "N = 30: median, 80 % of 100 seeds (grey)", 0)
        errors = np.median(EXAMPLE1.series(_SEEDS, _LAST).max_abs_error, axis=0)
        axes.plot(np.arange(_LAST + 1), errors, label="N = 5: median", **LINES[1])
        _bound(axes, 0.0097)
        _error_axes(axes)
        legend(axes)
    return [Figure(path, "Ch. 2, example 1, N = 30, max|e|", "Error per iteration, N = 30.")]


def example2(study: Study, folder: Path) -> list[Figure]:
    run = study.run()
    path = folder / "ch2-ex2-error.png"
    with picture(path) as (axes,):
        axes.plot(run.iterations, run.max_abs_error, **LINES[0])
        _bound(axes, 0.0058)
        _error_axes(axes)
        axes.set_ylim(bottom=1e-4)
    grew = run.max_abs_error[-1] > run.max_abs_error[0]
    contradicts = "The text ends at 0.0058; the plant it prints diverges." if grew else ""
    caption = "Error per iteration on (2.37) as printed."
    return [Figure(path, "Ch. 2, example 2, max|e|", caption, contradicts)]


def substitute(study: Study, folder: Path) -> list[Figure]:
    full = study.run(lengths="full", iterations=_LAST)
    path = folder / "ch2-ex2-substitute-error.png"
    with picture(path) as (axes,):
        _band(axes, SUBSTITUTE, "median, 80 % of 100 seeds (grey)", 0)
        axes.plot(full.iterations, full.max_abs_error, label="uncut trials", **LINES[1])
        _bound(axes, 0.0058)
        _error_axes(axes)
        legend(axes)
    return [
        Figure(
            path, "Ch. 2, example 2, substitute, max|e|",
            "Error per iteration on (2.37) with the output x_3.",
        ),
        _outputs(
            study.run(), folder / "ch2-ex2-substitute-output.png",
            "Ch. 2, example 2, substitute, outputs",
        ),
    ]  # fmt: skip
