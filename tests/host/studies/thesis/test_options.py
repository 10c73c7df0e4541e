"""What the examples take, refuse before they start, and say of the settings they used."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import Example, ExampleOptions
from tailbeat.studies.thesis.options import (
    ITERATIONS_MAX,
    Span,
    errors_beyond,
    expression,
    last_iteration,
)
from tailbeat.studies.thesis.plants import feedback
from tailbeat.studies.thesis.registry import EXAMPLES
from tailbeat.studies.thesis.study import Order, checked, choose, compute

BY_ID = {one.id: one for one in EXAMPLES}
CHEAP = ("ch2-ex2-substitute", "ch3-ex1", "ch6-heat", "ch7-heat", "ch8-sim-4", "ch4-ex1",
         "ch5-case1-sign")  # fmt: skip


def settings(what: str | None, **words: Any) -> dict[str, dict[str, Any]]:
    """By id, as the command would take the words; nothing is computed."""
    found = choose(EXAMPLES, what, checked(**words), ExampleOptions())
    return {one.id: one.settings_of(options) for one, options in found}


def refusal(what: str, **words: Any) -> str:
    with pytest.raises(InputError) as caught:
        settings(what, **words)
    told = f"{caught.value.message} {caught.value.remedy}"
    assert "\n" not in told and caught.value.remedy
    return told


# Settings that were used.


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda one: one.id)
def test_settings_are_of_all_that_an_example_knows(example: Example) -> None:
    found = example.settings_of(ExampleOptions())
    assert set(found) == example.knows | {"precision"}
    assert set(found) <= {one.name for one in fields(ExampleOptions)}


def test_settings_of_the_thesis() -> None:
    found = settings(None)
    assert found["ch2-ex1"] == {
        "iterations": 80, "lengths": "uniform", "seed": 1, "precision": "double",
    }  # fmt: skip
    assert found["ch3-fish"] == {
        "beta": 1 / 3, "iterations": 30, "lengths": "uniform", "m": 2, "seed": 1, "step": 0.05,
        "precision": "double",
    }  # fmt: skip
    assert found["ch4-ex2-smooth"]["step"] == 2 * math.pi / 5000
    assert found["ch7-printed"] == {
        "delta": 0.25, "iterations": 5, "step": 0.01, "uptake": "clip", "precision": "double",
    }  # fmt: skip
    assert found["ch8-sim-7"] == {
        "iterations": 20, "lengths": "full", "seed": None, "step": None, "precision": "double",
    }  # fmt: skip


def test_settings_that_others_lead_to() -> None:
    asked = settings("ch3-ex1", m=9, lengths_text="random", seed=4, step="1/50")["ch3-ex1"]
    assert asked["beta"] == pytest.approx(0.1) and asked["m"] == 9 and asked["step"] == 0.02
    assert asked["lengths"] == "uniform" and asked["seed"] == 4
    assert settings("ch3-ex1", m=9, beta="-0.2")["ch3-ex1"]["beta"] == -0.2


@pytest.mark.parametrize("example", CHEAP)
def test_settings_are_what_is_run(example: str) -> None:
    """Given back as options they are the same run."""
    one = BY_ID[example]
    found = one.settings_of(ExampleOptions(iterations=3))
    again = one.run(ExampleOptions(**{n: v for n, v in found.items() if v is not None}))
    assert again.iterations[-1] == found["iterations"] == 3
    np.testing.assert_array_equal(
        again.max_abs_error, one.run(ExampleOptions(iterations=3)).max_abs_error
    )


# Seeds that do nothing.


@pytest.mark.parametrize(
    ("what", "lengths"),
    [("ch2-ex1", "full"), ("ch2-ex1", "pattern:45"), ("ch3-fish", "full"), ("ch8-sim-4", None),
     ("ch8-sim-10", "full"), ("ch8-sim-10", "pattern:20+i%9")],
)  # fmt: skip
def test_a_seed_that_changes_nothing_is_refused_by_name(what: str, lengths: str | None) -> None:
    told = refusal(what, seed=4, lengths_text=lengths)
    assert told.startswith(f"{what} draws nothing") and "--lengths uniform" in told
    assert settings(what, seed=4, lengths_text="uniform")[what]["seed"] == 4
    chapter = settings(what[2], seed=4, lengths_text=lengths)  # harmless beside others
    assert chapter[what]["seed"] is None


# Steps.


@pytest.mark.parametrize(
    ("what", "step", "why"),
    [
        ("ch8-sim-4", "7", "a step of 7 s does not divide 40 s"),
        ("ch8-sim-4", "40", "is too long"),
        ("ch8-sim-4", "41", "is too long"),
        ("ch8-sim-4", "40/65536", "is too short"),
        ("ch4-ex1", "3.1e-5", "is too short"),
        ("ch4-ex1", "5", "is too long"),
        ("ch5-case2", "0.03", "does not divide 0.5 s"),
        ("ch5-case2", "1e-300", "is too short"),
        ("ch3-ex1", "3.05e-5", "is too short"),
        ("ch3-fish", "0.3", "does not divide 50 s"),
        ("ch6-heat", "0.03", "does not divide 10 min"),
        ("ch7-heat", "1e-4", "is too short"),
    ],
)
def test_a_refused_step_comes_with_one_that_is_taken(what: str, step: str, why: str) -> None:
    told = refusal(what, step=step)
    assert f"{what}: " in told and why in told
    like = re.search(r"like (\S+)\.$", told)
    assert like is not None
    taken = settings(what, step=like[1], delta="5" if "ch7" in what else None)[what]["step"]
    assert taken == pytest.approx(expression(like[1])({}), rel=1e-9)


def test_chapter_4_takes_the_nearest_step_and_says_so() -> None:
    """No short number divides 2 pi; 628 steps of 0.01 come closest."""
    assert settings("ch4-ex1", step="0.01")["ch4-ex1"]["step"] == 2 * math.pi / 628
    assert settings("ch4-ex1", step="2*pi/5000")["ch4-ex1"]["step"] == 2 * math.pi / 5000
    everything = settings(None, step="0.01")
    assert {round(one["step"], 4) for one in everything.values() if "step" in one} == {0.01}


@given(st.integers(2, 60_000), st.floats(-0.9e-9, 0.9e-9))
def test_every_divisor_is_taken(count: int, off: float) -> None:
    for duration in (2.0, 40.0, 2 * math.pi):
        span = Span(duration, "s", 60_000, 10**12)
        assert span.steps(duration / count * (1 + off)) == count
        if count < 60_000:
            with pytest.raises(InputError):
                span.steps(duration / (count + 0.4))


# What would take for ever.


@pytest.mark.parametrize(
    ("what", "step"),
    [("ch5-case2", "2.5e-6"), ("ch4-ex2-smooth", "2*pi/50000"), ("ch3-fish", "0.001"),
     ("ch6-heat", "5e-4"), ("ch7-printed", "5e-4")],
)  # fmt: skip
def test_ten_minutes_are_the_most(what: str, step: str) -> None:
    """What the refusal offers is taken, and a little more is not."""
    told = refusal(what, step=step, iterations=ITERATIONS_MAX)
    fewer = re.search(r"Give --iterations (\d+) or fewer, or --step (\S+) or longer", told)
    assert fewer is not None and "ten minutes" in told
    last, longer = int(fewer[1]), fewer[2]
    assert settings(what, step=step, iterations=last)[what]["iterations"] == last
    assert "ten minutes" in refusal(what, step=step, iterations=last + 1)
    delta = "5" if "ch7" in what else None
    settings(what, step=longer, iterations=ITERATIONS_MAX, delta=delta)


def test_most_iterations_of_the_thesiss_own_steps() -> None:
    settings(None, iterations=ITERATIONS_MAX)


def test_last_iteration() -> None:
    assert last_iteration(None, 7) == 7 and last_iteration(0, 7) == 0
    for asked, first in ((-1, 0), (0, 1), (ITERATIONS_MAX + 1, 0)):
        with pytest.raises(InputError):
            last_iteration(asked, 7, first)


@pytest.mark.parametrize("example", CHEAP)
def test_progress_is_told_trial_by_trial(example: str) -> None:
    told: list[float] = []
    with study.progress_shown(told.append):
        BY_ID[example].run(ExampleOptions(iterations=5))
    assert len(told) >= 5 and told == sorted(told) and told[-1] == 1.0
    BY_ID[example].run(ExampleOptions(iterations=1))  # nobody listens any more
    assert told[-1] == 1.0


# Divergence: the same limit everywhere.


@pytest.mark.parametrize(
    ("example", "options", "peak"),
    [
        ("ch2-ex2", {"lengths": "full", "iterations": 4000}, 1.9),
        ("ch3-ex1", {"beta": -0.9, "iterations": 400}, 2.9),
        ("ch3-fish", {"beta": -3.0, "iterations": 400}, 0.06),
        ("ch7-heat", {"delta": 1.0, "iterations": 300}, 15.625),
        ("ch5-case1-sign", {"step": 0.002, "iterations": 400}, None),
    ],
)
def test_errors_end_where_no_digit_of_the_reference_is_left(
    example: str, options: dict[str, Any], peak: float | None
) -> None:
    with np.errstate(all="ignore"):
        run = BY_ID[example].run(ExampleOptions(**options))
    errors = run.max_abs_error
    assert run.diverged is not None and len(errors) > 0
    assert np.isfinite(errors).all()
    assert errors.max() <= (peak or 10.0) * 2.0**52 * 1.1


def test_the_limit() -> None:
    assert errors_beyond(np.array([0.5, -3.0])) == 3.0 * 2.0**52


@pytest.mark.parametrize(
    ("example", "step", "width"), [("ch4-ex1", 2.0, 2), ("ch3-fish", 25.0, None)]
)
def test_a_first_trial_that_diverges_has_a_row(
    example: str, step: float, width: int | None
) -> None:
    found = compute(Order(example, ExampleOptions(step=step, iterations=3), claims=False))
    assert found.iterations.tolist() == [found.diverged]
    assert found.max_abs_error.shape == ((1,) if width is None else (1, width))
    assert np.isnan(found.max_abs_error).all()


def test_the_limit_of_trials_with_feedback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first error is 0.5."""
    peaks: list[float] = []

    def low(wanted: F64) -> float:
        peaks.append(float(np.abs(wanted).max()))
        return 0.3

    monkeypatch.setattr(feedback, "errors_beyond", low)
    run = BY_ID["ch5-case1-sign"].run(ExampleOptions(iterations=4))
    assert run.diverged == 1 and len(peaks) == 1
    monkeypatch.setattr(
        "tailbeat.studies.thesis.plants.feedback.errors_beyond", lambda wanted: 0.51
    )
    assert BY_ID["ch5-case1-sign"].run(ExampleOptions(iterations=4)).diverged is None
    assert 0.5 < peaks[0] < 10.0


# The uptake of (7.31) below v = 0: recomputed independently; the printed one passes its pole.

UPTAKES = {
    ("monod", 0.25): [15.536284, 15.568023, 15.595721, 15.618472, 15.630855, 15.634011],
    ("abs", 0.25): [15.536284, 15.571109, 15.609202, 15.650122, 15.693927, 15.740875],
    ("clip", 0.25): [15.536284, 15.589490, 15.646120, 15.704275, 15.764233, 15.826050],
    ("monod", 0.10): [15.536284, 15.532290, 15.527329, 15.521145, 15.512006, 15.493601],
    ("abs", 0.10): [15.536284, 15.532390, 15.527961, 15.523076, 15.518089, 15.513230],
    ("clip", 0.10): [15.536284, 15.534334, 15.532545, 15.531154, 15.529683, 15.528197],
}


@pytest.mark.parametrize(("uptake", "delta"), UPTAKES)
def test_uptakes(uptake: str, delta: float) -> None:
    ((example, options),) = choose(
        EXAMPLES, "ch7-printed", checked(uptake=uptake, delta=str(delta)), ExampleOptions()
    )
    found = example.run(options).max_abs_error
    assert found == pytest.approx(UPTAKES[uptake, delta], rel=1e-5)
    assert example.settings_of(options)["uptake"] == uptake
