"""The figures of chapter 7."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tailbeat.studies.thesis.chapter6.figures import field_map
from tailbeat.studies.thesis.chapter7.plants import (
    BY_TIME,
    DELTAS,
    ITERATIONS,
    RHO,
    STEADY,
    AdvectionPlant,
    theta,
)
from tailbeat.studies.thesis.example import ExampleRun, Figure, Study
from tailbeat.studies.thesis.heat import CHAPTER7, HORIZON, heat_plant
from tailbeat.studies.thesis.picture import LINES, WANTED, legend, picture

_SHOWN_DELTA = 0.02  # of figures 7.5 to 7.7


def printed_figures(study: Study, folder: Path) -> list[Figure]:
    """The Theta function, and what the plant as printed makes of both laws."""
    return [*_theta(folder), _deltas(study, folder, "printed"), _other_law(folder),
            *_fifth(study, folder, "printed")]  # fmt: skip


def heat_figures(study: Study, folder: Path) -> list[Figure]:
    """Figures 7.5 to 7.7 on the plant where the text's numbers come out."""
    return [_deltas(study, folder, "heat"), *_fifth(study, folder, "heat")]


def _theta(folder: Path) -> list[Figure]:
    return [_theta_cut(folder), _theta_early(folder), _theta_sup(folder)]


def _theta_cut(folder: Path) -> Figure:
    path = folder / "fig7-1.png"
    time = np.linspace(0.002, HORIZON, 4000)
    with picture(path) as (axes,):
        for images, line in zip((8, 0, 1, 2), LINES, strict=False):
            axes.plot(time, theta(1.0, time, images), label=f"N = {images}", **line)
        axes.set_xlabel("t, min")
        axes.set_ylabel("theta(1, t), summed over |m| <= N")
        legend(axes, ncols=4)
    return Figure(path, "Fig. 7.1", "theta(1, t) of (7.5), and its sum cut short.")


def _theta_early(folder: Path) -> Figure:
    path = folder / "fig7-2.png"
    time = np.linspace(0.001, 0.6, 2000)
    with picture(path) as (axes,):
        axes.plot(time, theta(1.0, time), **LINES[0])
        leads = np.array(DELTAS)
        axes.plot(leads, theta(1.0, leads), "o", ms=9, mfc="white", mec="0.1", mew=1.8)
        for lead in DELTAS:
            rho = -1 / (2 * float(theta(1.0, lead)))
            axes.annotate(
                f"delta = {lead:g}: rho = {rho:.5g}", (lead, float(theta(1.0, lead))),
                (12, -20 if lead == min(DELTAS) else -5),
                textcoords="offset points", fontsize=12,
            )  # fmt: skip
        axes.set_ylim(bottom=-0.05)
        axes.set_xlabel("t, min")
        axes.set_ylabel("theta(1, t)")
    caption = "theta(1, t) at first, with the five delta and the gains -1/(2 theta) they ask for."
    return Figure(path, "Fig. 7.2", caption)


def _theta_sup(folder: Path) -> Figure:
    path = folder / "fig7-3.png"
    time = np.linspace(0.001, HORIZON, 100_001)
    images = np.arange(9)
    missing = [0.5 - float(np.max(theta(1.0, time, int(n)))) for n in images]
    with picture(path) as (axes,):
        axes.semilogy(images, np.maximum(missing, 1e-13), marker="o", ms=8, **LINES[0])
        axes.set_xlabel("N")
        axes.set_ylabel("1/2 - sup theta_N(1, t)")
    return Figure(path, "Fig. 7.3", "How the sum's largest value gets to 1/2 with its terms.")


def _error_axes(path: Path, runs: dict[str, ExampleRun], log: bool, columns: int = 3) -> None:
    with picture(path) as (axes,):
        for (name, run), line in zip(runs.items(), LINES, strict=False):
            axes.plot(run.iterations, run.max_abs_error, label=name, marker="o", ms=6, **line)
        if log:
            axes.set_yscale("log")
        axes.set_xlabel("iteration i")
        axes.set_ylabel("max|e_i(t)|")
        legend(axes, ncols=columns)


def _deltas(study: Study, folder: Path, plant: str) -> Figure:
    path = folder / f"ch7-{plant}-error.png"
    runs = {f"delta = {delta:g}": study.run(delta=delta) for delta in DELTAS}
    _error_axes(path, runs, log=plant == "heat")
    left = max(float(run.max_abs_error[-1]) for run in runs.values())
    contradicts = (
        f"The text has it below 1 after {ITERATIONS}; by this plant {left:.1f} are left."
        if left >= 1
        else ""
    )
    words = {"printed": "the plant as printed, (7.31)", "heat": "the heat equation"}[plant]
    return Figure(path, f"Ch. 7, {words}, max|e|", "The D-law with lead.", contradicts)


def _other_law(folder: Path) -> Figure:
    path = folder / "ch7-printed-learned.png"
    runs = {"-4 e(t + 0.10), N0 = 20": STEADY.learn(13),
            "-0.5 (2t + 3) e(t + 0.10), N0 = 10": BY_TIME.learn(13)}  # fmt: skip
    _error_axes(path, runs, log=True, columns=1)
    caption = "The plant as printed, learned by a P-law with lead and Q."
    return Figure(path, "Ch. 7, the plant as printed with another law, max|e|", caption)


def _fifth(study: Study, folder: Path, plant: str) -> list[Figure]:
    run = study.run(delta=_SHOWN_DELTA)
    time, values = run.traces["time"], run.traces["input"]
    rod = AdvectionPlant() if plant == "printed" else heat_plant(CHAPTER7)
    ending = "-printed" if plant == "printed" else ""
    by = " by the plant as printed" if plant == "printed" else ""
    left = float(run.max_abs_error[-1])
    against = f"The text's y^5 is within 1 of y^d; here {left:.1f} are left." if left >= 1 else ""
    output, given, field = (folder / f"fig7-{n}{ending}.png" for n in (5, 6, 7))
    with picture(output) as (axes,):
        axes.plot(time, run.traces["reference"], label="wanted", **WANTED)
        axes.plot(time, run.traces["output"], label="y of iteration 5", **LINES[0])
        axes.set_xlabel("t, min")
        axes.set_ylabel("y = v(1, t)")
        legend(axes)
    with picture(given) as (axes,):
        axes.plot(time, values, **LINES[0])
        axes.set_xlabel("t, min")
        axes.set_ylabel("u = v_x(0, t)")
    field_map(field, time, rod.field(values), "v")
    law = f"delta = {_SHOWN_DELTA:g}, rho = {RHO:g}"
    return [
        Figure(output, f"Fig. 7.5{by}", f"Output of iteration 5 and reference, {law}.", against),
        Figure(given, f"Fig. 7.6{by}", f"Input of iteration 5, {law}.", against),
        Figure(field, f"Fig. 7.7{by}", f"v(x, t) of iteration 5 as a map, {law}.", against),
    ]
