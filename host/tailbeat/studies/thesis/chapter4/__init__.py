"""Chapter 4: adaptive laws with time scaling, (4.5)-(4.20), on references that change from trial to
trial."""

from __future__ import annotations

from functools import partial

from tailbeat.studies.thesis.chapter4 import claims, figures
from tailbeat.studies.thesis.chapter4.claims import (
    EXAMPLE1,
    EXAMPLE2_SIGN,
    EXAMPLE2_SMOOTH,
    ITERATIONS,
)
from tailbeat.studies.thesis.example import Example
from tailbeat.studies.thesis.feedback import example

_example = partial(example, 4, ITERATIONS)

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
