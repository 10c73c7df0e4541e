"""Figures 4.1 to 4.13."""

from __future__ import annotations

from collections.abc import Callable

from tailbeat.studies.thesis.chapter4 import EX1, LAST, SIGN, SMOOTH
from tailbeat.studies.thesis.example import Example, figure
from tailbeat.studies.thesis.picture import Panel, Panels
from tailbeat.studies.thesis.plants import feedback as loop
from tailbeat.studies.thesis.study import Study

_OF = {EX1.id: "constant parameters", SIGN.id: "sign law", SMOOTH.id: "smooth law"}


def _errors(study: Study) -> Panels:
    return loop.errors({"": study.traces})


def _first_state(study: Study) -> Panels:
    return loop.states(study.traces, 0)


def _second_state(study: Study) -> Panels:
    return loop.states(study.traces, 1)


def _first_input(study: Study) -> Panel:
    return loop.input_of(study.traces, LAST, 0)


def _second_input(study: Study) -> Panel:
    return loop.input_of(study.traces, LAST, 1)


def _series(example: Example, first: int, with_inputs: bool) -> None:
    """Errors, both states and, if asked for, both inputs of an example, from number 4.``first``."""
    law = _OF[example.id]
    ends = f"at iterations 1 and {LAST}, with their references, {law}."
    rows: list[tuple[Callable[[Study], Panel | Panels], str]] = [
        (_errors, f"largest error of both states over the iterations, {law}."),
        (_first_state, f"x_1 {ends}"),
        (_second_state, f"x_2 {ends}"),
    ]
    inputs: list[tuple[Callable[[Study], Panel | Panels], str]] = [
        (_first_input, f"u_1 at iteration {LAST}, {law}."),
        (_second_input, f"u_2 at iteration {LAST}, {law}."),
    ]
    for number, (compose, caption) in enumerate(rows + (inputs if with_inputs else []), first):
        figure(example, f"4.{number}", caption)(compose)


_series(EX1, 1, with_inputs=False)
_series(SIGN, 4, with_inputs=True)
_series(SMOOTH, 9, with_inputs=True)
