"""Chapter 2 against numbers recomputed independently and against its laws in plain numpy.

Random lengths are compared as distributions: their means within four standard errors of both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import chapter2
from tailbeat.studies.thesis.example import CONFIRMED, NOT_CONFIRMED, READING, ExampleOptions
from tailbeat.studies.thesis.plants import linear
from tailbeat.studies.thesis.plants.linear import (
    EXAMPLE1,
    EXAMPLE1_N30,
    EXAMPLE2,
    REFERENCE,
    SUBSTITUTE,
    Average,
    reached_probability,
)
from tailbeat.studies.thesis.series import first_within, stays_within
from tailbeat.studies.thesis.study import Study

EXAMPLES = {example.id: example for example in chapter2.EXAMPLES}
SEEDS, GOLDEN_SEEDS = 60, 400
ROWS = (0, 1, 5, 10, 20, 30, 40, 42, 60, 80, 100)
UNCUT = (
    1.9333, 2.1856, 2.9854, 2.1611, 0.38347, 0.050457, 0.0068841, 0.0046548, 1.0500e-4, 1.2756e-6,
    1.8595e-8,
)  # fmt: skip
MEAN_N5 = (1.933, 2.186, 3.109, 2.180, 0.4569, 0.0919, 0.02295, 0.01766, 0.00623, 0.00327, 0.00200)
MEAN_N30 = (1.933, 2.244, 3.381, 2.416, 0.6885, 0.2242, 0.0777, 0.0661, 0.0136, 0.00527, 0.00304)
MEAN_P = (1.933, 1.614, 0.737, 0.309, 0.0585, 0.00893, 0.00135, 0.00089, 1.8e-5, 1.1e-7, 4.6e-9)
_PRINTED = 0.006  # relative, of numbers printed with two to four digits


# --- the law and the plants once more, from the formulas


def plain_a(name: str, t: int) -> np.ndarray:
    if name == "ch2-ex1":
        return np.array([[0.5, 0, 1], [0.15, 0.3, 0], [-0.75, 0.25, -0.25]])
    return np.array([[0.2 * np.exp(-t / 100), -0.6, 0], [0, 0.5, np.sin(t)], [0, 0, 0.7]])


PLAIN: dict[str, tuple[list[float], list[float], float]] = {  # B, C, L
    "ch2-ex1": ([0, 0, 1], [0, 0, 1], 0.5),
    "ch2-ex2": ([1.3, 0.5, 0.6], [-0.5, 1.5, 0], 2.0),
    "ch2-ex2-substitute": ([1.3, 0.5, 0.6], [0, 0, 1], 1 / 3),
}


def plain_average(name: str, length: Callable[[int], float], iterations: int) -> list[float]:
    """(2.10) from running sums."""
    b, c, gain = (np.array(part) for part in PLAIN[name])
    t = np.arange(51)
    wanted = np.sin(2 * np.pi * t / 50) + np.sin(2 * np.pi * t / 5)
    u, inputs, errors, found = np.zeros(51), np.zeros(51), np.zeros(51), []
    for i in range(iterations + 1):
        x, e = np.zeros(3), np.zeros(51)
        for k in t:
            e[k] = wanted[k] - c @ x
            x = plain_a(name, k) @ x + b * u[k]
        found.append(np.abs(e).max())
        inputs += u
        errors[:-1] += np.where(t <= length(i), e, 0.0)[1:]
        u = inputs / (i + 1) + (i + 2) / (i + 1) * gain * errors
    return found


PATTERNS: dict[str, Callable[[int], float]] = {
    "full": lambda i: 50,
    "pattern:45 + i % 7": lambda i: 45 + i % 7,
    "pattern:20 + 10 * (i % 4)": lambda i: 20 + 10 * (i % 4),
    "pattern:49.5": lambda i: 49.5,
    "pattern:80 if i % 3 else 31": lambda i: 80 if i % 3 else 31,
}


@pytest.mark.parametrize("name", ["ch2-ex1", "ch2-ex2-substitute"])
@pytest.mark.parametrize("lengths", PATTERNS)
def test_any_pattern_is_the_plain_law(name: str, lengths: str) -> None:
    run = EXAMPLES[name].run(ExampleOptions(lengths=lengths, iterations=61))
    np.testing.assert_allclose(
        run.max_abs_error, plain_average(name, PATTERNS[lengths], 61), rtol=1e-9, atol=1e-14
    )
    assert run.lengths is not None
    assert run.lengths.tolist() == [PATTERNS[lengths](i) for i in range(62)]


def test_n30_differs_in_its_lengths_only() -> None:
    for lengths in ("full", "pattern:20+10*(i%4)"):
        runs = [
            EXAMPLES[name].run(ExampleOptions(lengths=lengths, iterations=30)).max_abs_error
            for name in ("ch2-ex1", "ch2-ex1-n30")
        ]
        np.testing.assert_array_equal(*runs)


# --- golden rows


@pytest.mark.parametrize(
    ("precision", "rtol", "atol"), [("double", 3e-5, 0), ("float", 1e-4, 5e-7)]
)
def test_uncut_rows(precision: Any, rtol: float, atol: float) -> None:
    run = EXAMPLES["ch2-ex1"].run(
        ExampleOptions(lengths="full", iterations=200, precision=precision)
    )
    for row, golden in zip(ROWS, UNCUT, strict=True):
        relative = max(rtol, 1.5e-4 if row == 60 else 0.0)
        assert run.max_abs_error[row] == pytest.approx(golden, rel=relative, abs=atol)
    assert run.max_abs_error[200] < (3e-15 if precision == "double" else 5e-7)
    assert run.diverged is None


def test_float_follows_double_under_random_lengths() -> None:
    for seed in (1, 2, 3):
        double, single = (
            EXAMPLES["ch2-ex1"].run(ExampleOptions(seed=seed, precision=precision)).max_abs_error
            for precision in ("double", "float")
        )
        np.testing.assert_allclose(single, double, rtol=1e-4, atol=5e-7)


def check_means(
    name: str, found: np.ndarray, golden: tuple[float, ...], rows: range | tuple
) -> None:
    for row, wanted in zip(ROWS, golden, strict=True):
        if row not in rows:
            continue
        mean, deviation = found[:, row].mean(), found[:, row].std(ddof=1)
        tolerance = 4 * deviation * np.sqrt(1 / len(found) + 1 / GOLDEN_SEEDS) + _PRINTED * wanted
        print(f"{name} i={row}: {mean:.4g}, golden {wanted:.4g} within {tolerance:.2g}")
        assert abs(mean - wanted) <= tolerance


def test_random_lengths_n5() -> None:
    found = EXAMPLE1.problem().series(range(1, SEEDS + 1), 100)
    check_means("N=5", found.max_abs_error, MEAN_N5, ROWS)
    first = first_within(found.max_abs_error, 0.0098)
    executed = first_within(found.executed, 0.0098)
    assert 41 <= np.median(first) <= 46
    assert first.min() >= 38
    assert 39 <= np.median(executed) <= 41
    assert (found.executed <= found.max_abs_error).all()


def test_random_lengths_n30() -> None:
    found = EXAMPLE1_N30.problem().series(range(1, SEEDS + 1), 200).max_abs_error
    check_means("N=30", found, MEAN_N30, ROWS)
    assert 55 <= np.median(first_within(found, 0.0097)) <= 63
    assert 62 <= np.median(stays_within(found, 0.0097)) <= 74


def test_p_type_with_zero_fill() -> None:
    found = EXAMPLE1.problem("last").series(range(1, SEEDS + 1), 60).max_abs_error
    check_means("P", found, MEAN_P, ROWS[:9])


def test_random_start() -> None:
    """What a single series expects of its next trial: 0.451 by the average, 0.446 by P."""
    for past, golden in (("mean", 0.451), ("last", 0.446)):
        seeds = range(1, 41)
        found = EXAMPLE1.problem(past, seeds).series(seeds, 200)
        value = chapter2.expected(found, 200)
        print(past, value, "golden", golden, "within 0.04")
        assert abs(value - golden) < 0.04
    starts = linear._random_start(range(300), 7)[:, 2]
    assert set(starts) == {-1.0, 0.0, 1.0}
    assert all(70 < count < 130 for count in Counter(starts).values())


def test_the_printed_plant_of_example_2_diverges() -> None:
    run = EXAMPLES["ch2-ex2"].run(ExampleOptions(lengths="full"))
    np.testing.assert_allclose(run.max_abs_error[:4], [1.9333, 24.4, 94.0, 745.0], rtol=1e-3)
    np.testing.assert_allclose(run.max_abs_error[10], 2e7, rtol=0.05)
    expected = plain_average("ch2-ex2", PATTERNS["full"], 12)
    np.testing.assert_allclose(run.max_abs_error[:13], expected, rtol=1e-9)
    assert run.diverged == len(run.max_abs_error) < 80
    assert np.isfinite(run.max_abs_error).all()
    assert EXAMPLES["ch2-ex2"].run(ExampleOptions()).diverged is not None
    assert EXAMPLES["ch2-ex2"].run(ExampleOptions(precision="float")).diverged is not None


def test_wanted_inputs() -> None:
    for setting, largest in ((EXAMPLE1, 2.9976), (EXAMPLE2, 2.5e32)):
        found = setting.plant.exact_input()
        assert np.abs(found).max() == pytest.approx(largest, rel=0.01)
    exact = np.append(EXAMPLE1.plant.exact_input(), 0.0)
    np.testing.assert_allclose(EXAMPLE1.plant.respond(exact[np.newaxis])[0], REFERENCE, atol=1e-12)


# --- lengths and conditions


def test_reached_probability_of_figure_2_2() -> None:
    found = reached_probability(np.arange(14), 7, [1 / 6] * 6)
    wanted = [1.0] * 8 + [5 / 6, 4 / 6, 3 / 6, 2 / 6, 1 / 6, 0.0]
    np.testing.assert_allclose(found, wanted, atol=1e-15)


def test_reached_probability_is_the_share_of_trials_that_get_there() -> None:
    for setting in (EXAMPLE1, EXAMPLE1_N30, SUBSTITUTE):
        drawn = np.array([setting.draw(3, i) for i in range(20_000)])
        share = (drawn[:, np.newaxis] >= np.arange(51)).mean(axis=0)
        np.testing.assert_allclose(share, setting.reached(), atol=0.015)
        assert drawn.min() == 50 - setting.spread
        assert drawn.max() == 50 + setting.spread


def test_conditions() -> None:
    assert EXAMPLE1.condition() == pytest.approx(1 - 0.5 * 6 / 11, abs=1e-12)
    assert EXAMPLE1_N30.condition() == pytest.approx(0.745902, abs=5e-7)
    assert EXAMPLE2.condition() == pytest.approx(0.8754, abs=5e-5)
    assert SUBSTITUTE.condition() == pytest.approx(EXAMPLE2.condition(), abs=1e-12)


def test_runs_are_reproducible_and_seeds_differ() -> None:
    first, again, other = (
        EXAMPLES["ch2-ex1"].run(ExampleOptions(seed=seed, iterations=20)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.max_abs_error, again.max_abs_error)
    assert (first.lengths != other.lengths).any()


def test_iterations_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError):
        EXAMPLES["ch2-ex1"].run(ExampleOptions(iterations=-1))


# --- claims and figures


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapter2, "SEEDS", range(1, 41))
    monkeypatch.setattr(chapter2, "LATE", 100)
    monkeypatch.setattr(chapter2, "_START_SEEDS", range(1, 31))
    monkeypatch.setattr(chapter2, "_FIGURE_SEEDS", range(1, 4))


def verdicts(name: str, setting: Average | None = None) -> list[str]:
    example = EXAMPLES[name] if setting is None else EXAMPLES[name].with_setting(setting)
    return [claim.verdict for claim in Study(example).judge()]


@pytest.mark.usefixtures("quick")
def test_claims() -> None:
    assert verdicts("ch2-ex1") == [CONFIRMED, READING, READING, NOT_CONFIRMED]
    assert verdicts("ch2-ex1-n30") == [NOT_CONFIRMED, CONFIRMED]
    assert verdicts("ch2-ex2") == [NOT_CONFIRMED, NOT_CONFIRMED]
    assert verdicts("ch2-ex2-substitute") == [READING]


@pytest.mark.usefixtures("quick")
def test_verdicts_follow_the_computation() -> None:
    """Other lengths or another gain, another verdict."""
    uncut = replace(EXAMPLE1, masses=(1.0,))  # nothing is slower
    assert verdicts("ch2-ex1-n30", uncut) == [NOT_CONFIRMED, NOT_CONFIRMED]
    assert verdicts("ch2-ex2-substitute", replace(SUBSTITUTE, gain=0.05)) == [NOT_CONFIRMED]
    assert verdicts("ch2-ex1", replace(EXAMPLE1, gain=0.1))[:2] == [NOT_CONFIRMED, NOT_CONFIRMED]


def test_a_plant_that_learns_flips_the_verdict_on_example_2() -> None:
    assert verdicts("ch2-ex2", SUBSTITUTE)[1] == READING


@pytest.mark.painted
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", EXAMPLES)
def test_figures(name: str, tmp_path: Path) -> None:
    figures = Study(EXAMPLES[name]).draw(tmp_path)
    assert figures
    for figure in figures:
        assert figure.path.stat().st_size > 1_500
    if name in ("ch2-ex1", "ch2-ex2"):
        assert any(figure.contradicts for figure in figures)


@pytest.mark.soak
def test_random_lengths_of_as_many_seeds_as_the_table() -> None:
    seeds = range(1001, 1001 + GOLDEN_SEEDS)
    for setting, past, golden in (
        (EXAMPLE1, "mean", MEAN_N5), (EXAMPLE1_N30, "mean", MEAN_N30), (EXAMPLE1, "last", MEAN_P),
    ):  # fmt: skip
        check_means(past, setting.problem(past).series(seeds, 100).max_abs_error, golden, ROWS)
