"""What the figures of chapters 4 and 5 have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import Figure
from tailbeat.studies.thesis.feedback import Trials
from tailbeat.studies.thesis.picture import LINES, WANTED, legend, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 1250  # of states, which move slowly


def errors(path: Path, name: str, series: dict[str, Trials], caption: str) -> Figure:
    """max|e| of both states over the trials; one panel per state."""
    with picture(path, panels=2) as panels:
        for state, axes in enumerate(panels):
            for line, (label, trials) in enumerate(series.items()):
                values = trials.max_abs_error[:, state]
                axes.plot(range(1, len(values) + 1), values, label=label, **LINES[line])
            axes.set_yscale("log")
            axes.set_xlabel("iteration i")
            axes.set_ylabel(f"max|e_{state + 1}(t)|")
            legend(axes)
    return Figure(path, name, caption)


def states(path: Path, name: str, trials: Trials, caption: str) -> Figure:
    """Both states and their references in the trials that were kept; one panel per state."""
    with picture(path, panels=2 * len(trials.traces), across=False) as panels:
        rows = iter(panels)
        for trial, trace in sorted(trials.traces.items()):
            for state in range(2):
                _state(next(rows), thinned(trace), trial, state)
    return Figure(path, name, caption)


def _state(axes: Axes, trace: F64, trial: int, state: int) -> None:
    axes.plot(trace[:, 0], trace[:, 3 + state], label="reference", **WANTED)
    axes.plot(trace[:, 0], trace[:, 1 + state], label=f"trial {trial}", **LINES[0])
    axes.set_ylabel(f"x_{state + 1}")
    _time(axes, trace)
    legend(axes)


def inputs(path: Path, name: str, series: dict[str, F64], caption: str) -> Figure:
    """Both inputs of several traces, one panel per trace and input."""
    with picture(path, panels=2 * len(series), across=False) as panels:
        rows = iter(panels)
        for channel in range(2):
            for label, trace in series.items():
                axes = next(rows)
                axes.plot(trace[:, 0], trace[:, 5 + channel], label=label, color="0.15", lw=0.8)
                axes.set_ylabel(f"u_{channel + 1}")
                _time(axes, trace)
                legend(axes)
    return Figure(path, name, caption)


def _time(axes: Axes, trace: F64) -> None:
    axes.set_xlabel("t")
    axes.set_xlim(0.0, trace[-1, 0])


def thinned(trace: F64) -> F64:
    """Every so many rows, few enough to draw; the last one is among them."""
    return trace[:: -max(1, len(trace) // _POINTS)][::-1]
