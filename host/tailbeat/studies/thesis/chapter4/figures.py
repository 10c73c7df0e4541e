"""The figures of chapter 4."""

from __future__ import annotations

from pathlib import Path

from tailbeat.studies.thesis import feedback as draw
from tailbeat.studies.thesis.chapter4.claims import (
    EXAMPLE2_SIGN,
    EXAMPLE2_SMOOTH,
    ITERATIONS,
    other,
)
from tailbeat.studies.thesis.example import Figure, Study
from tailbeat.studies.thesis.feedback import trials_of


def example1(study: Study, folder: Path) -> list[Figure]:
    found = trials_of(study.run())
    return [
        draw.errors(
            folder / "ch4-ex1-error.png", "Ch. 4, example 1, max|e|",
            {"all of Theta, (4.6)": found},
            "Error per iteration; the reference is another one in each.",
        ),
        draw.states(
            folder / "ch4-ex1-states.png", "Ch. 4, example 1, states", found,
            f"Trials 1 and {ITERATIONS} with their references.",
        ),
    ]  # fmt: skip


def sign(study: Study, folder: Path) -> list[Figure]:
    found, against = trials_of(study.run()), other(EXAMPLE2_SMOOTH)
    return [
        draw.states(
            folder / "ch4-ex2-sign-states.png", "Ch. 4, example 2, sign law, states", found,
            f"Trials 1 and {ITERATIONS} with their references.",
        ),
        draw.inputs(
            folder / "ch4-ex2-inputs.png", "Ch. 4, example 2, inputs",
            {
                f"sign law, trial {ITERATIONS}": found.traces[ITERATIONS],
                f"smooth law, trial {ITERATIONS}": against.traces[ITERATIONS],
            },
            "The inputs of both laws in the same trial.",
        ),
    ]  # fmt: skip


def smooth(study: Study, folder: Path) -> list[Figure]:
    found, against = trials_of(study.run()), other(EXAMPLE2_SIGN)
    return [
        draw.errors(
            folder / "ch4-ex2-error.png", "Ch. 4, example 2, max|e|",
            {"smooth, (4.18)-(4.20)": found, "sign, (4.15)-(4.17)": against},
            "Error per iteration; the reference is another one in each.",
        ),
        draw.states(
            folder / "ch4-ex2-smooth-states.png", "Ch. 4, example 2, smooth law, states", found,
            f"Trials 1 and {ITERATIONS} with their references.",
        ),
    ]  # fmt: skip
