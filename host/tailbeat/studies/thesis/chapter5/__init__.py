"""Chapter 5: robust laws, (5.5)-(5.19), against uncertainty that is known only by its norm."""

from __future__ import annotations

from functools import partial

from tailbeat.studies.thesis.chapter5 import claims, figures
from tailbeat.studies.thesis.chapter5.claims import CASE1_SIGN, CASE1_SMOOTH, CASE2, ITERATIONS
from tailbeat.studies.thesis.example import Example
from tailbeat.studies.thesis.feedback import example

_example = partial(example, 5, ITERATIONS)

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
