"""Chapter 5: robust laws, (5.5)-(5.19), against uncertainty that is known only by its norm."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from tailbeat.thesis.chapter5 import claims, figures
from tailbeat.thesis.chapter5.claims import CASE1_SIGN, CASE1_SMOOTH, CASE2, ITERATIONS
from tailbeat.thesis.example import Claim, Example, Figure, Run, Study
from tailbeat.thesis.feedback import Chapter5, run_example, settings
from tailbeat.thesis.options import Options


def _run(setting: Chapter5, options: Options) -> Run:
    return run_example(setting, options, ITERATIONS)


def _example(
    id: str,
    title: str,
    law: str,
    setting: Chapter5,
    judge: Callable[[Study], list[Claim]],
    draw: Callable[[Study, Path], list[Figure]],
    weight: float,
) -> Example:
    return Example(
        id=id, chapter=5, title=title, law=law, knows=frozenset({"step", "iterations"}),
        run=partial(_run, setting), claims=judge, figures=draw, weight=weight,
        settings=partial(settings, setting, ITERATIONS),
    )  # fmt: skip


EXAMPLES: tuple[Example, ...] = (
    _example(
        "ch5-case1-sign", "Input gain known, sign law (case 1)", "robust with sgn, (5.5)-(5.6)",
        CASE1_SIGN, claims.case1_sign, figures.case1_sign, 6.0,
    ),
    _example(
        "ch5-case1-smooth", "Input gain known, smooth law (case 1)",
        "robust with tanh, (5.8)-(5.9)", CASE1_SMOOTH, claims.case1_smooth, figures.case1_smooth,
        5.0,
    ),
    _example(
        "ch5-case2", "Input gain and disturbance uncertain (case 2)",
        "robust with tanh, (5.17)-(5.19)", CASE2, claims.case2, figures.case2, 2.0,
    ),
)  # fmt: skip
