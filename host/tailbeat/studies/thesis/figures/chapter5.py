"""Figures 5.1 to 5.6."""

from __future__ import annotations

from tailbeat.studies.thesis.chapter5 import (
    CASE1_SIGN,
    DEAD_ZONE,
    LAST,
    SAMPLED,
    SIGN,
    SMOOTH,
    UNCERTAIN,
)
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import Panels
from tailbeat.studies.thesis.plants import feedback as loop
from tailbeat.studies.thesis.study import Study


@figure(SIGN, "5.1", "largest error of both states over the iterations, law I_1.")
@figure(SMOOTH, "5.3", "largest error of both states over the iterations, law I_2.")
@figure(UNCERTAIN, "5.5", "largest error of both states over the iterations, (5.19)-(5.21).")
def _errors(study: Study) -> Panels:
    return loop.errors({"": study.traces})


@figure(SIGN, "5.2", f"inputs at iteration {LAST}, law I_1.")
@figure(SMOOTH, "5.4", f"inputs at iteration {LAST}, law I_2.")
@figure(UNCERTAIN, "5.6", f"inputs at iteration {LAST}, (5.19)-(5.21), continuous time.")
def _inputs(study: Study) -> Panels:
    return Panels([loop.input_of(study.traces, LAST, one) for one in range(2)], across=False)


@figure(SIGN, "5-sampled", "largest error of I_1 for several control periods: it grows again.")
def _sampled(study: Study) -> Panels:
    found, _ = loop.sampled(CASE1_SIGN, SAMPLED)
    steps = max(SAMPLED)
    series = {f"{500.0 / n:g} ms": trials for n, trials in found.items()}
    cured = loop.run_trials(loop.on(CASE1_SIGN, steps, dead_zone=DEAD_ZONE), SAMPLED[steps])
    return loop.errors({**series, f"{500.0 / steps:g} ms, dead zone": cured})
