"""Chapter 2: the iteration average (2.10) on linear plants whose trials end at random."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.studies.thesis import options as lengths
from tailbeat.studies.thesis.chapter2 import claims, figures
from tailbeat.studies.thesis.chapter2.plants import (
    EXAMPLE1,
    EXAMPLE1_N30,
    EXAMPLE2,
    SUBSTITUTE,
    Average,
)
from tailbeat.studies.thesis.cut import run_series
from tailbeat.studies.thesis.example import (
    Claim,
    Example,
    ExampleOptions,
    ExampleRun,
    Figure,
    Study,
)
from tailbeat.studies.thesis.options import last_iteration

ITERATIONS = 80
_KNOWS = frozenset({"lengths", "seed", "iterations"})
_KEPT = (0, 5, 20, 40)


def _run(setting: Average, options: ExampleOptions) -> ExampleRun:
    task = setting.task()
    length = task.length(options.lengths, options.seed)
    last = last_iteration(options.iterations, ITERATIONS)
    return run_series(task, [length], last, options.precision, keep=_KEPT).run()


def _settings(options: ExampleOptions) -> dict[str, Any]:
    return {
        "iterations": last_iteration(options.iterations, ITERATIONS),
        **lengths.settings(options, "uniform"),
    }


def _example(
    id: str,
    title: str,
    setting: Average,
    judge: Callable[[Study], list[Claim]],
    draw: Callable[[Study, Path], list[Figure]],
    weight: float,
) -> Example:
    return Example(
        id=id, chapter=2, title=title, law="iteration average, (2.10)", knows=_KNOWS,
        run=partial(_run, setting), claims=judge, figures=draw, weight=weight,
        settings=_settings,
    )  # fmt: skip


EXAMPLES: tuple[Example, ...] = (
    _example(
        "ch2-ex1", "Linear plant, trials of 45 to 55 samples (2.4, example 1)", EXAMPLE1,
        claims.example1, figures.example1, 8.0,
    ),
    _example(
        "ch2-ex1-n30", "The same, trials of 20 to 80 samples", EXAMPLE1_N30,
        claims.example1_n30, figures.example1_n30, 3.0,
    ),
    _example(
        "ch2-ex2", "Time-varying plant (2.37) as printed: diverges", EXAMPLE2,
        claims.example2, figures.example2, 0.5,
    ),
    _example(
        "ch2-ex2-substitute", "(2.37) with its third state as the output", SUBSTITUTE,
        claims.substitute, figures.substitute, 1.0,
    ),
)  # fmt: skip
