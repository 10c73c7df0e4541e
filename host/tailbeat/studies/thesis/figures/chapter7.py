"""Figures 7.1 to 7.7, with the heat equation beside the printed plant, which does not learn."""

from __future__ import annotations

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter7 import HEAT, PRINTED
from tailbeat.studies.thesis.example import ExampleOptions, figure
from tailbeat.studies.thesis.picture import (
    LINES,
    REFERENCE,
    Curve,
    Panel,
    Panels,
    errors,
    field_map,
)
from tailbeat.studies.thesis.plants import advection, heat
from tailbeat.studies.thesis.study import Study

_SHOWN_DELTA = 0.02  # of figures 7.5 to 7.7
_IMAGES_MAX = 200
_BOTH = "left: the plant as printed, right: the reading F = 0."


@figure(PRINTED, "7.1", "theta(x, t) in space and time, as a map.")
def _theta(study: Study) -> Panel:
    time, place = np.linspace(0.01, 1.0, 200), np.linspace(0.0, 1.0, 101)
    field = np.stack([advection.theta(float(x), time) for x in place], axis=1)
    return field_map(time, np.minimum(field, 1.5), r"\theta", cut=1.5)


@figure(PRINTED, "7.2", "theta(1, t) over time.")
def _theta_at_1(study: Study) -> Panel:
    time = np.linspace(0.001, 1.0, 2000)
    labels = {"xlabel": "$t$ (min)", "ylabel": r"$\theta(1, t)$"}
    return Panel([Curve(time, advection.theta(1.0, time))], labels)


@figure(PRINTED, "7.3", "sup over t in (0, 10] of theta_N(1, t) over N.")
def _theta_sup(study: Study) -> Panel:
    time = np.linspace(0.001, heat.HORIZON, 20_001)
    numbers = (0, 1, 2, 3, 5, 10, 20, 50, 100, _IMAGES_MAX)
    found = [float(advection.theta(1.0, time, n).max()) for n in numbers]
    labels = {"xlabel": "$N$", "ylabel": r"$\sup_t\,|\theta_N(1, t)|$"}
    return Panel([Curve(numbers, found, style=LINES[0] | {"marker": "o"})], labels, [0.5])


@figure(PRINTED, "7.4", f"largest error over the iterations for the five delta; {_BOTH}")
def _deltas(study: Study) -> Panels:
    panels = []
    for one in (study, study.beside(HEAT)):
        runs = {
            rf"$\delta = {delta:g}$": one.run(delta=delta).max_abs_error
            for delta in advection.DELTAS
        }
        against = _left(max(found[-1] for found in runs.values()))
        panels.append(errors(runs, marker=6, columns=3, levels=[1.0], contradicts=against))
    return Panels(panels)


def _left(error: float) -> str:
    """What an error of 1 or more contradicts."""
    return f"it is below 1 after 5; the printed plant leaves {error:.1f}. " if error >= 1 else ""


def _fifth(study: Study) -> tuple[F64, F64, F64, str]:
    """Time, input and output of iteration 5, and what the text says against them."""
    run = study.run(delta=_SHOWN_DELTA)
    return run.traces.problem.times, *run.traces.trial(), _left(float(run.max_abs_error[-1]))


def _beside(study: Study) -> tuple[Study, Study]:
    return study, study.beside(HEAT)


@figure(PRINTED, "7.5", f"output of iteration 5 and reference, delta = {_SHOWN_DELTA:g}; {_BOTH}")
def _output(study: Study) -> Panels:
    panels = []
    for one in _beside(study):
        time, _, output, against = _fifth(one)
        curves = [
            Curve(time, heat.reference(time), "reference", REFERENCE),
            Curve(time, output, "iteration 5"),
        ]
        labels = {"xlabel": "$t$ (min)", "ylabel": "$y(t) = v(1, t)$"}
        panels.append(Panel(curves, labels, contradicts=against))
    return Panels(panels)


@figure(PRINTED, "7.6", f"input of iteration 5, delta = {_SHOWN_DELTA:g}; {_BOTH}")
def _input(study: Study) -> Panels:
    labels = {"xlabel": "$t$ (min)", "ylabel": "$u(t) = v_x(0, t)$"}
    found = [_fifth(one) for one in _beside(study)]
    return Panels(
        [Panel([Curve(time, values)], labels, contradicts=why) for time, values, _, why in found]
    )


@figure(PRINTED, "7.7", f"v(x, t) of iteration 5 as a map, delta = {_SHOWN_DELTA:g}; {_BOTH}")
def _field(study: Study) -> Panels:
    panels = []
    for one in _beside(study):
        time, values, _, against = _fifth(one)
        plant = one.setting(heat.STEP, ExampleOptions())
        panels.append(field_map(time, plant.field(values), "v", against))
    return Panels(panels)


@figure(PRINTED, "7-other-law", "the plant as printed, learned by a P-law with lead and Q.")
def _other_law(study: Study) -> Panel:
    runs = {
        r"$-4\,e(t + 0.10)$, $N_0 = 20$": advection.STEADY,
        r"$-0.5\,(2t + 3)\,e(t + 0.10)$, $N_0 = 10$": advection.BY_TIME,
    }
    found = {name: one.problem().uncut(13) for name, one in runs.items()}
    return errors(found, marker=6, columns=1)
