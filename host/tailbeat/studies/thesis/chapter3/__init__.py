"""Chapter 3: the moving average (3.12), (3.43) on continuous plants whose trials end at random."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from tailbeat.studies.thesis import options as lengths
from tailbeat.studies.thesis.chapter3 import claims, figures
from tailbeat.studies.thesis.chapter3.plants import EXAMPLE1, FISH, Moving, share
from tailbeat.studies.thesis.cut import run_series
from tailbeat.studies.thesis.example import Example, ExampleOptions, ExampleRun
from tailbeat.studies.thesis.options import last_iteration

_KNOWS = frozenset({"lengths", "seed", "iterations", "step", "m", "beta"})


def _asked(setting: Moving, iterations: int, options: ExampleOptions) -> tuple[Moving, int]:
    """Setting and last iteration of the options. Another m shares the same total gain out among
    its trials, as 1/5 and 1/3 do in the two examples, unless beta says otherwise."""
    m = setting.m if options.m is None else options.m
    asked = replace(
        setting,
        step=setting.step if options.step is None else options.step,
        m=m,
        beta=share(m) if options.beta is None else options.beta,
    )
    last = last_iteration(options.iterations, iterations)
    asked.trial.afford(asked.trial.steps(asked.step), last)
    return asked, last


def _run(
    setting: Moving, iterations: int, keep: tuple[int, ...], options: ExampleOptions
) -> ExampleRun:
    asked, last = _asked(setting, iterations, options)
    task = asked.task()
    length = task.length(options.lengths, options.seed)
    found = run_series(task, [length], last, options.precision, keep)
    return found.run(times=task.times, wanted=task.wanted)


def _settings(setting: Moving, iterations: int, options: ExampleOptions) -> dict[str, Any]:
    asked, last = _asked(setting, iterations, options)
    return {
        "beta": asked.beta,
        "iterations": last,
        "m": asked.m,
        "step": asked.step,
        **lengths.settings(options, "uniform"),
    }


EXAMPLES: tuple[Example, ...] = (
    Example(
        id="ch3-ex1", chapter=3, title="Nonlinear plant, trials of about 2 s (3.4, example 1)",
        law="moving average D, (3.12)", knows=_KNOWS,
        run=partial(_run, EXAMPLE1, 40, (0, 5, 10, 20)), settings=partial(_settings, EXAMPLE1, 40),
        claims=claims.example1, figures=figures.example1, weight=5.0,
    ),
    Example(
        id="ch3-fish", chapter=3, title="Robotic fish, trials of 44 to 58 s (3.4, example 2)",
        law="moving average PD, (3.43)", knows=_KNOWS,
        run=partial(_run, FISH, 30, (0, 1, 5, 30)), settings=partial(_settings, FISH, 30),
        claims=claims.fish, figures=figures.fish, weight=12.0,
    ),
)  # fmt: skip
