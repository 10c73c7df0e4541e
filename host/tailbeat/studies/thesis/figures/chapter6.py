"""Figures 6.1 to 6.3."""

from __future__ import annotations

from tailbeat.report.style import Axes
from tailbeat.studies.thesis.chapter6 import FIRST_OF_TEXT, HEAT, LAST_OF_TEXT
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import REFERENCE, Curve, Panel, errors, field_map, level
from tailbeat.studies.thesis.plants import heat, rod
from tailbeat.studies.thesis.plants.rod import ITERATIONS, LONG
from tailbeat.studies.thesis.study import Study


@figure(HEAT, "6.1", "largest error over the iterations. The text: 13.20 to 0.0371.")
def _errors(study: Study) -> Panel:
    found = study.run().max_abs_error

    def of_the_text(axes: Axes) -> None:
        level(axes, FIRST_OF_TEXT, f"{FIRST_OF_TEXT:.2f}, of the text")
        level(axes, LAST_OF_TEXT, f"{LAST_OF_TEXT}, of the text", place=0.0)

    starts = f"it starts at {FIRST_OF_TEXT:.2f}; the heat that f brings in makes it {found[0]:.2f}."
    contradicts = "" if abs(found[0] - FIRST_OF_TEXT) < 0.05 else starts
    return errors({"": found}, marker=8, more=of_the_text, contradicts=contradicts)


@figure(HEAT, "6.2", "output of iteration 7 and the reference.")
def _output(study: Study) -> Panel:
    found = study.traces
    time = found.problem.times
    curves = [
        Curve(time, found.problem.reference, "reference", REFERENCE),
        Curve(time, found.trial()[1], f"iteration {ITERATIONS}"),
    ]
    return Panel(curves, {"xlabel": "$t$ (min)", "ylabel": "$y(t) = w(0, t)$"})


@figure(HEAT, "6.3", "w(x, t) of iteration 7, as a map.")
def _surface(study: Study) -> Panel:
    found = study.traces
    field = heat.heat_plant(heat.CHAPTER6).field(found.trial()[0])
    return field_map(found.problem.times, field, "w")


@figure(HEAT, "6-filter", f"where the filter acts, {LONG} trials on the exact rod.")
def _filter(study: Study) -> Panel:
    runs = {
        "Q on input and correction, (6.31)": rod.with_filter(),
        "Q on the correction alone": rod.with_filter_on_the_correction(),
        "no Q": rod.without_filter(),
    }
    return errors(runs)
