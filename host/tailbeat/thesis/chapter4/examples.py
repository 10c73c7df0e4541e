"""Chapter 4: adaptive laws with time scaling, (4.5)-(4.20), on references that change from trial to
trial."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from tailbeat.thesis.chapter4 import claims, figures
from tailbeat.thesis.chapter4.claims import EXAMPLE1, EXAMPLE2_SIGN, EXAMPLE2_SMOOTH, ITERATIONS
from tailbeat.thesis.example import Claim, Example, Figure, Run, Study
from tailbeat.thesis.feedback import Chapter4, run_example, settings
from tailbeat.thesis.options import Options


def _run(setting: Chapter4, options: Options) -> Run:
    return run_example(setting, options, ITERATIONS)


def _example(
    id: str,
    title: str,
    law: str,
    setting: Chapter4,
    judge: Callable[[Study], list[Claim]],
    draw: Callable[[Study, Path], list[Figure]],
    weight: float,
) -> Example:
    return Example(
        id=id, chapter=4, title=title, law=law, knows=frozenset({"step", "iterations"}),
        run=partial(_run, setting), claims=judge, figures=draw, weight=weight,
        settings=partial(settings, setting, ITERATIONS),
    )  # fmt: skip


EXAMPLES: tuple[Example, ...] = (
    _example(
        "ch4-ex1", "Constant parameters, a reference that changes (example 1)",
        "adaptive, (4.5)-(4.6)", EXAMPLE1, claims.example1, figures.example1, 10.0,
    ),
    _example(
        "ch4-ex2-sign", "Time-varying parameters, sign law (example 2)",
        "adaptive with sgn, (4.15)-(4.17)", EXAMPLE2_SIGN, claims.sign, figures.sign, 8.0,
    ),
    _example(
        "ch4-ex2-smooth", "Time-varying parameters, smooth law (example 2)",
        "adaptive with tanh and leakage, (4.18)-(4.20)", EXAMPLE2_SMOOTH, claims.smooth,
        figures.smooth, 8.0,
    ),
)  # fmt: skip
