"""Chapter 8: the robotic fish learns (8.31) by the law (8.16), gains 4, 7 and 10.

By default as the fish does it: one amplitude per beat, errors of beat means. With a step: sampled
control, the amplitude held for a step and paired with the error at its end.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.studies.thesis import options as lengths
from tailbeat.studies.thesis import study as progress
from tailbeat.studies.thesis.chapter8.claims import claims as judged
from tailbeat.studies.thesis.chapter8.figures import draw_all
from tailbeat.studies.thesis.chapter8.plants import BEATS, TRIAL, FishTask, FishTrial, trials
from tailbeat.studies.thesis.example import Example, ExampleOptions, ExampleRun, Figure, Study
from tailbeat.studies.thesis.options import last_iteration

ITERATIONS = 20
GAINS = (4.0, 7.0, 10.0)
_SHORTEST, _LONGEST = 20, 50  # beats of a trial that is cut at random


def draw(seed: int, iteration: int) -> float:
    """Beats of a trial, U(20, 50), whatever was drawn before; beyond 40 it is a full one."""
    random = np.random.default_rng((seed, iteration))
    return float(random.integers(_SHORTEST, _LONGEST, endpoint=True))


def run(gain: float, options: ExampleOptions) -> ExampleRun:
    """Raises InputError for a step that makes no trial, or a length that is none."""
    task = _task(gain, options)
    return _told(trials(task), task.iterations, cut=task.length_beats is not None)


def settings(gain: float, options: ExampleOptions) -> dict[str, Any]:
    """What ``run`` uses. A step of None: one amplitude per beat."""
    task = _task(gain, options)
    return {
        "iterations": task.iterations,
        "step": task.step_s,
        **lengths.settings(options, "full"),
    }


def _task(gain: float, options: ExampleOptions) -> FishTask:
    text = options.lengths
    task = FishTask(
        gain,
        last_iteration(options.iterations, ITERATIONS),
        step_s=options.step,
        length_beats=None if text is None else lengths.parse(text, BEATS, draw, options.seed),
        precision=options.precision,
    )
    TRIAL.afford(task.samples(), task.iterations)
    return task


def _told(series: Iterable[FishTrial], last: int, cut: bool) -> ExampleRun:
    rows = []
    for t in series:
        rows.append(
            (t.iteration, t.max_abs_error_m_s, t.executed_max_abs_error_m_s, t.length_beats)
        )
        progress.tell(t.iteration + 1, last + 1)
    iterations, errors, executed, beats = (np.array(column) for column in zip(*rows, strict=True))
    return ExampleRun(
        iterations=iterations.astype(np.int64),
        max_abs_error=errors,
        executed=executed if cut else None,
        lengths=beats if cut else None,
    )


def _figures(gain: float, study: Study, folder: Path) -> list[Figure]:
    """All of the chapter's belong to the first gain."""
    if gain != GAINS[0]:
        return []
    return draw_all(folder)


EXAMPLES: tuple[Example, ...] = tuple(
    Example(
        id=f"ch8-sim-{gain:g}",
        chapter=8,
        title=f"Robotic fish (8.13), gain {gain:g}, m/s",
        law="P with saturation (8.16)",
        knows=frozenset({"lengths", "seed", "step", "iterations"}),
        run=partial(run, gain),
        claims=partial(judged, gain),
        figures=partial(_figures, gain),
        settings=partial(settings, gain),
        weight=2.0,
    )
    for gain in GAINS
)
