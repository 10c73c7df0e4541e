"""The figures of chapter 3."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.studies.thesis.chapter3.plants import EXAMPLE1, FISH, Moving, fish_wanted_input
from tailbeat.studies.thesis.cut import run_series
from tailbeat.studies.thesis.example import ExampleRun, Figure, Study
from tailbeat.studies.thesis.picture import LINES, legend, picture
from tailbeat.studies.thesis.picture import WANTED as WANTED_LINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SEEDS = range(1, 61)
_LAST1, _LAST2 = 40, 30


def _uncut(axes: Axes, setting: Moving, last: int, name: str, line: int) -> None:
    task = setting.task()
    errors = run_series(task, [task.length("full", 1)], last).max_abs_error[0]
    axes.plot(np.arange(last + 1), errors, label=name, **LINES[line])


def _band(axes: Axes, setting: Moving, last: int, name: str) -> None:
    errors = setting.series(_SEEDS, last).max_abs_error
    low, median, high = np.quantile(errors, (0.1, 0.5, 0.9), axis=0)
    at = np.arange(last + 1)
    axes.fill_between(at, low, high, color="0.88", lw=0, zorder=0)
    axes.plot(at, median, label=name, **LINES[0])


def _error_axes(axes: Axes, unit: str = "") -> None:
    axes.set_yscale("log")
    axes.set_xlabel("iteration i")
    axes.set_ylabel(f"max|e_i(t)|{unit}")
    legend(axes)


def example1(study: Study, folder: Path) -> list[Figure]:
    error, sweep = folder / "ch3-ex1-error.png", folder / "ch3-ex1-m.png"
    with picture(error) as (axes,):
        _band(axes, EXAMPLE1, _LAST1, f"m = 4: median, 80 % of {len(_SEEDS)} seeds (grey)")
        _uncut(axes, EXAMPLE1, _LAST1, "uncut trials", 1)
        _error_axes(axes)
    with picture(sweep, panels=2) as panels:
        for axes, total in zip(panels, (False, True), strict=True):
            for line, m in enumerate((0, 1, 2, 3, 4, 5)):
                beta = 1.0 / (m + 1) if total else EXAMPLE1.beta
                setting = replace(EXAMPLE1, m=m, beta=beta)
                _uncut(axes, setting, _LAST1, f"m = {m}", line)
            _error_axes(axes)
            legend(axes, ncols=3)
            axes.set_ylim(1e-9, 8.0)
            axes.annotate(
                "β_j = 1/(m+1)" if total else "β_j = 1/5", (0.03, 0.04), xycoords="axes fraction"
            )
    return [
        Figure(error, "Ch. 3, example 1, max|e|", "Error per iteration, m = 4."),
        Figure(
            sweep, "Ch. 3, example 1, influence of m",
            "Uncut trials; left: the gain of each trial is kept, right: their sum.",
        ),
        _outputs(study.run(), folder / "ch3-ex1-output.png", "Ch. 3, example 1, outputs", "y"),
    ]  # fmt: skip


def _outputs(run: ExampleRun, path: Path, name: str, quantity: str, scale: float = 1.0) -> Figure:
    assert run.lengths is not None
    times, wanted = run.traces["times"], scale * run.traces["wanted"]
    kept = {i: trial for i, trial in run.traces["kept"].items() if i < len(run.iterations)}
    with picture(path, panels=len(kept), across=False) as axes:
        for one, (i, (_, outputs)) in zip(axes, kept.items(), strict=True):
            until = min(float(run.lengths[i]), float(times[-1]))
            reached = times <= until
            output = scale * outputs[0]
            one.plot(times, wanted, label="wanted", **WANTED_LINE)
            one.plot(times, output, **LINES[2])
            one.plot(times[reached], output[reached], label=f"iteration {i}", **LINES[0])
            if until < times[-1]:
                one.axvline(until, color="0.4", lw=1.0)
            one.set_ylabel(quantity)
            legend(one)
        axes[-1].set_xlabel("t, s")
    caption = "Output of some iterations; dotted: beyond the trial's end, which is not measured."
    return Figure(path, name, caption)


def fish(study: Study, folder: Path) -> list[Figure]:
    path = folder / "ch3-fish-error.png"
    with picture(path) as (axes,):
        _band(axes, FISH, _LAST2, f"median, 80 % of {len(_SEEDS)} seeds (grey)")
        _uncut(axes, replace(FISH, history="first"), _LAST2, "history u_0, uncut", 1)
        _uncut(axes, replace(FISH, low=0.0), _LAST2, "u ≥ 0, uncut", 2)
        _error_axes(axes, ", m/s")
    run = study.run()
    return [
        Figure(path, "Ch. 3, example 2, max|e|", "Error per iteration, drag v|v|."),
        _outputs(
            run, folder / "ch3-fish-speed.png", "Ch. 3, example 2, speed", "v, mm/s", 1000.0
        ),
        _thrust(run, folder / "ch3-fish-thrust.png"),
    ]  # fmt: skip


def _thrust(run: ExampleRun, path: Path) -> Figure:
    times = run.traces["times"]
    last = max(i for i in run.traces["kept"] if i < len(run.iterations))
    learned = run.traces["kept"][last][0][0]
    with picture(path, panels=2) as (whole, end):
        for axes in (whole, end):
            axes.plot(times, 1e3 * fish_wanted_input(times), label="needed, u_d", **WANTED_LINE)
            axes.plot(times, 1e3 * learned, label=f"learned, iteration {last}", **LINES[0])
            axes.axhline(0.0, color="0.4", lw=1.0)
            axes.set_xlabel("t, s")
            axes.set_ylabel("thrust per mass, mm/s²")
        end.set_xlim(40.0, 50.0)
        end.set_ylim(-8.0, 12.0)
        legend(whole)
    caption = "Thrust that the reference needs and that was learned; right: the end, enlarged."
    return Figure(path, "Ch. 3, example 2, thrust", caption)
