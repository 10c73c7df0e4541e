"""The figures of chapter 5."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tailbeat.studies.thesis import feedback as draw
from tailbeat.studies.thesis.chapter5.claims import (
    CASE1_SIGN,
    CASE1_SMOOTH,
    DEAD_ZONE,
    ITERATIONS,
    SAMPLED,
    other,
)
from tailbeat.studies.thesis.example import Figure, Study
from tailbeat.studies.thesis.feedback import TimeGrid, run_trials, trials_of

_CASE1 = "Ch. 5, case 1"
_TRIAL = f"trial {ITERATIONS}"


def case1_sign(study: Study, folder: Path) -> list[Figure]:
    found = trials_of(study.run())
    against = other(CASE1_SMOOTH)
    return [
        draw.states(
            folder / "ch5-case1-sign-states.png", f"{_CASE1}, I_1, states", found,
            f"Trials 1 and {ITERATIONS} with the reference.",
        ),
        draw.inputs(
            folder / "ch5-case1-inputs.png", f"{_CASE1}, inputs",
            {
                f"I_1, {_TRIAL}": found.traces[ITERATIONS],
                f"I_2, {_TRIAL}": against.traces[ITERATIONS],
            },
            "The inputs of both laws in the same trial.",
        ),
        _sampled(folder / "ch5-case1-sampled.png"),
    ]  # fmt: skip


def _sampled(path: Path) -> Figure:
    series = {
        f"{500.0 / steps:g} ms": run_trials(replace(CASE1_SIGN, grid=TimeGrid(steps, "held")), last)
        for steps, last in SAMPLED
    }
    steps, last = SAMPLED[-1]
    cured = replace(CASE1_SIGN, grid=TimeGrid(steps, "held"), dead_zone=DEAD_ZONE)
    series[f"{500.0 / steps:g} ms, dead zone"] = run_trials(cured, last)
    return draw.errors(
        path, f"{_CASE1}, I_1 sampled", series,
        "Error per iteration for several control periods: it grows again, against theorem 5.1.",
    )  # fmt: skip


def case1_smooth(study: Study, folder: Path) -> list[Figure]:
    found = trials_of(study.run())
    return [
        draw.errors(
            folder / "ch5-case1-error.png", f"{_CASE1}, max|e|",
            {"I_2, smooth": found, "I_1, sign": other(CASE1_SIGN)},
            "Error per iteration.",
        ),
        draw.states(
            folder / "ch5-case1-smooth-states.png", f"{_CASE1}, I_2, states", found,
            f"Trials 1 and {ITERATIONS} with the reference.",
        ),
    ]  # fmt: skip


def case2(study: Study, folder: Path) -> list[Figure]:
    found = trials_of(study.run())
    return [
        draw.errors(
            folder / "ch5-case2-error.png", "Ch. 5, case 2, max|e|", {"(5.17)-(5.19)": found},
            "Error per iteration.",
        ),
        draw.states(
            folder / "ch5-case2-states.png", "Ch. 5, case 2, states", found,
            f"Trials 1 and {ITERATIONS} with the reference.",
        ),
        draw.inputs(
            folder / "ch5-case2-inputs.png", "Ch. 5, case 2, inputs",
            {f"(5.19), {_TRIAL}": found.traces[ITERATIONS]},
            f"The inputs of trial {ITERATIONS}, continuous time.",
        ),
    ]  # fmt: skip
