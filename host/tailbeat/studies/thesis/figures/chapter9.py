"""Figures of the studies of section 9.2; the thesis has none."""

from __future__ import annotations

from tailbeat.studies.thesis.chapter9 import (
    CUT_ROD,
    ESTIMATE_MAX,
    HIGH,
    LIMITED,
    LIPSCHITZ,
    LOW,
    TIGHT,
    adaptive,
    contraction,
    cut_rod,
    limited,
    rod_chapter6,
    rod_chapter7,
)
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import LINES, Curve, Panel, Panels, errors
from tailbeat.studies.thesis.study import Study


@figure(
    LIPSCHITZ,
    "9-lipschitz",
    "largest error of the executed part, 20 series; left: P-type, 0.3; right: adaptive, 1.",
)
def _lipschitz(study: Study) -> Panels:
    low = contraction(LOW).executed
    return Panels(
        [
            errors({}, band=("P-type at 0.3, median and 80 %", low)),
            errors({}, band=("adaptive at 1, median and 80 %", adaptive(HIGH))),
        ]
    )


@figure(LIMITED, "9-limits", "estimate of theta and largest error of x_2, input limited to 1.")
def _limits(study: Study) -> Panels:
    cases = {"estimate free": limited(TIGHT), "held below 5": limited(TIGHT, ESTIMATE_MAX)}
    panels = []
    for name in ("max_estimate", "max_abs_error"):
        curves = []
        for (label, trials), style in zip(cases.items(), LINES, strict=False):
            values = getattr(trials, name)[:, -1]
            curves.append(Curve(range(1, len(values) + 1), values, label, style))
        what = r"estimate of $\theta$" if name == "max_estimate" else r"$\max_t\,|e_{i,2}(t)|$"
        panels.append(Panel(curves, {"xlabel": "iteration $i$", "ylabel": what}))
    return Panels(panels)


@figure(CUT_ROD, "9-rod", "largest error over the iterations, rods of chapters 6 and 7.")
def _rods(study: Study) -> Panels:
    return Panels(
        [
            errors({"full trials": one().uncut(60)},
                   band=("random lengths, executed part", cut_rod(one).executed[:, :61]))
            for one in (rod_chapter6, rod_chapter7)
        ]
    )  # fmt: skip
