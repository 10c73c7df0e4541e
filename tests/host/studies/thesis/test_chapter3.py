"""Chapter 3 against numbers recomputed independently and against its laws in plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import chapter3
from tailbeat.studies.thesis.example import (
    CONFIRMED,
    NOT_CONFIRMED,
    READING,
    Example,
    ExampleOptions,
)
from tailbeat.studies.thesis.plants.held import (
    EXAMPLE1,
    FISH,
    Moving,
    beta_bounds,
    contraction,
    example1_reached,
    fish_exact_input,
    fish_rate_printed,
    rho_least,
)
from tailbeat.studies.thesis.study import Study

EXAMPLES = {example.id: example for example in chapter3.EXAMPLES}
SEEDS, GOLDEN_SEEDS = 100, 200
ROWS = (1, 5, 10, 15, 20, 30, 40)
M4_MEAN = (1.91, 0.622, 0.161, 0.0473, 0.0126, 9.0e-4, 8.6e-5)
M4_MEDIAN = (1.91, 0.567, 0.125, 0.0250, 0.00523, 3.6e-4, 3.1e-5)
M4_EXECUTED = (1.91, 0.409, 0.0427, 0.0122, 0.00276, 2.1e-4, 2.1e-5)
M0_MEAN = (0.922, 0.0225, 7.5e-4, 7.7e-5, 1.2e-5, 4.8e-7, 1.5e-8)
M5_MEAN = (1.95, 0.562, 0.287, 0.0917, 0.0297, 2.9e-3, 4.0e-4)
_PRINTED = 0.02


def uncut(setting: Moving, iterations: int) -> np.ndarray:
    return setting.problem().uncut(iterations)


# --- the laws and plants once more, from the formulas


def plain_example1(
    m: int,
    step: float,
    length: Callable[[int], float],
    last: int,
    beta: float | None = None,
) -> list[float]:
    """(3.12), Euler, zero history, beta = 1/(m + 1) where not given."""
    n = round(2 / step)
    t = np.arange(n + 1) * step
    wanted = np.sin(2 * np.pi * t) + np.sin(2 * np.pi * t / 5) + np.sin(5 * np.pi * t)
    inputs, slopes, found = [np.zeros(n)] * (m + 1), [np.zeros(n)] * (m + 1), []
    for i in range(last + 1):
        x, e = 0.0, np.zeros(n + 1)
        for k in range(n + 1):
            e[k] = wanted[k] - x
            if k < n:
                u = inputs[0][k]
                x = x + step * (0.5 * np.cos(x) + u + 0.5 * np.sin(u))
        found.append(np.abs(e).max())
        known = np.arange(1, n + 1) * step <= length(i) + 1e-9
        slopes = [np.where(known, np.diff(e) / step, 0.0), *slopes[:m]]
        u = sum(inputs) / (m + 1) + sum(slopes) * (beta or 1 / (m + 1))
        inputs = [u, *inputs[:m]]
    return found


def plain_fish(m: int, step: float, length: Callable[[int], float], last: int) -> list[float]:
    """(3.43), RK4 with a held input, zero history, beta = 1/(m + 1), L = -1."""
    n = round(50 / step)
    t = np.arange(n + 1) * step
    wanted = 48 / 50**5 * t**2 * (t - 50) ** 2
    inputs = [np.full(n, 0.05)] + [np.zeros(n)] * m
    slopes, found = [np.zeros(n)] * (m + 1), []
    for i in range(last + 1):
        v, e = 0.0, np.zeros(n + 1)
        for k in range(n + 1):
            e[k] = wanted[k] - v
            if k < n:
                v = rk4(v, float(inputs[0][k]), step)
        found.append(np.abs(e).max())
        reached = t <= length(i) + 1e-9
        slopes = [np.where(reached[1:], np.diff(e) / step, 0.0), *slopes[:m]]
        errors = np.where(reached, e, 0.0)[:n]
        inputs = [sum(inputs) / (m + 1) + sum(slopes) / (m + 1) + errors, *inputs[:m]]
    return found


def rk4(v: float, u: float, step: float) -> float:
    def rate(v: float) -> float:
        return -31.2485 * v * abs(v) + u

    k1 = rate(v)
    k2 = rate(v + step / 2 * k1)
    k3 = rate(v + step / 2 * k2)
    return v + step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(v + step * k3))


@pytest.mark.parametrize(
    ("m", "step", "lengths", "length"),
    [
        (4, 0.01, "full", lambda i: 2.0),
        (0, 0.02, "full", lambda i: 2.0),
        (3, 0.01, "pattern:1.2 + 0.4 * (i % 3)", lambda i: 1.2 + 0.4 * (i % 3)),
        (7, 0.04, "pattern:1.5 if i % 2 else 3", lambda i: 1.5 if i % 2 else 3.0),
        (1, 0.005, "pattern:0.755 + i / 10", lambda i: 0.755 + i / 10),
    ],
)
def test_example1_is_the_plain_law(
    m: int, step: float, lengths: str, length: Callable[[int], float]
) -> None:
    run = EXAMPLES["ch3-ex1"].run(ExampleOptions(m=m, step=step, lengths=lengths, iterations=12))
    np.testing.assert_allclose(
        run.max_abs_error, plain_example1(m, step, length, 12), rtol=1e-9, atol=1e-14
    )


@pytest.mark.parametrize("m", [0, 5])
def test_example1_with_the_gain_of_every_m(m: int) -> None:
    run = EXAMPLES["ch3-ex1"].run(ExampleOptions(m=m, beta=0.2, lengths="full", iterations=12))
    wanted = plain_example1(m, 0.01, lambda i: 2.0, 12, beta=0.2)
    np.testing.assert_allclose(run.max_abs_error, wanted, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize(
    ("m", "step", "lengths", "length"),
    [
        (2, 0.1, "full", lambda i: 50.0),
        (2, 0.2, "pattern:44 + 2 * (i % 4)", lambda i: 44.0 + 2 * (i % 4)),
        (4, 0.25, "pattern:30.1", lambda i: 30.1),
    ],
)
def test_fish_is_the_plain_law(
    m: int, step: float, lengths: str, length: Callable[[int], float]
) -> None:
    run = EXAMPLES["ch3-fish"].run(ExampleOptions(m=m, step=step, lengths=lengths, iterations=6))
    np.testing.assert_allclose(run.max_abs_error, plain_fish(m, step, length, 6), rtol=1e-9)


# --- golden rows


def test_example1_uncut() -> None:
    found = EXAMPLES["ch3-ex1"].run(ExampleOptions(lengths="full")).max_abs_error
    assert found[20] == pytest.approx(0.00180, abs=5e-6)
    better = uncut(replace(EXAMPLE1, method="rk4"), 20)
    assert better[0] == pytest.approx(2.3506, abs=1e-4)
    difference = np.abs(found[:21] / better - 1.0)
    assert difference[:11].max() <= 0.004
    assert difference.max() <= 0.02


def test_example1_with_a_tenth_of_the_step() -> None:
    coarse = uncut(EXAMPLE1, 14)
    fine = uncut(replace(EXAMPLE1, step=0.001), 14)
    assert fine[0] == pytest.approx(2.3508, abs=1e-4)
    difference = np.abs(coarse / fine - 1.0)
    assert difference[:9].max() <= 0.006
    assert difference.max() <= 0.14


def test_example1_in_float() -> None:
    for options in ({"lengths": "full"}, {"seed": 3}, {"m": 0, "seed": 4}):
        double, single = (
            EXAMPLES["ch3-ex1"].run(ExampleOptions(precision=precision, **options)).max_abs_error
            for precision in ("double", "float")
        )
        np.testing.assert_allclose(single, double, rtol=1e-4, atol=5e-7)


def check_means(name: str, found: np.ndarray, golden: tuple[float, ...]) -> None:
    for row, wanted in zip(ROWS, golden, strict=True):
        if row >= found.shape[1]:
            continue
        mean, deviation = found[:, row].mean(), found[:, row].std(ddof=1)
        tolerance = 4 * deviation * np.sqrt(1 / len(found) + 1 / GOLDEN_SEEDS) + _PRINTED * wanted
        print(f"{name} i={row}: {mean:.4g}, golden {wanted:.4g} within {tolerance:.2g}")
        assert abs(mean - wanted) <= tolerance


def check_medians(name: str, found: np.ndarray, golden: tuple[float, ...]) -> None:
    """A median scatters like a mean times sqrt(pi/2); the spread is skewed, hence in logarithms."""
    for row, wanted in zip(ROWS, golden, strict=True):
        if row >= found.shape[1]:
            continue
        logs = np.log(found[:, row])
        tolerance = 5 * logs.std() * np.sqrt(1 / len(found) + 1 / GOLDEN_SEEDS) + _PRINTED
        off = abs(np.median(logs) - np.log(wanted))
        print(f"{name} i={row}: {np.exp(np.median(logs)):.4g}, golden {wanted}, {off:.2g} "
              f"within {tolerance:.2g}")  # fmt: skip
        assert off <= tolerance


def test_example1_random_lengths() -> None:
    found = EXAMPLE1.problem().series(range(1, SEEDS + 1), 20)
    check_means("m=4", found.max_abs_error, M4_MEAN)
    check_medians("m=4", found.max_abs_error, M4_MEDIAN)
    check_medians("m=4, executed", found.executed, M4_EXECUTED)


@pytest.mark.parametrize(("m", "golden"), [(0, M0_MEAN), (5, M5_MEAN)])
def test_example1_random_lengths_with_other_m_and_a_total_gain_of_1(
    m: int, golden: tuple[float, ...]
) -> None:
    setting = replace(EXAMPLE1, m=m, beta=1 / (m + 1))
    found = setting.problem().series(range(1, SEEDS + 1), 20).max_abs_error
    check_means(f"m={m}", found, golden)


@pytest.mark.soak
def test_example1_as_many_seeds_and_iterations_as_the_table() -> None:
    seeds = range(1001, 1001 + GOLDEN_SEEDS)
    for m, golden in ((0, M0_MEAN), (4, M4_MEAN), (5, M5_MEAN)):
        setting = replace(EXAMPLE1, m=m, beta=1 / (m + 1))
        check_means(f"m={m}", setting.problem().series(seeds, 40).max_abs_error, golden)


def test_fish_ratio() -> None:
    run = EXAMPLES["ch3-fish"].run(ExampleOptions(lengths="full"))
    assert run.max_abs_error[0] / run.max_abs_error[30] == pytest.approx(113.6, abs=0.1)


def test_fish_ratio_with_the_first_input_as_history() -> None:
    errors = uncut(replace(FISH, history="first"), 30)
    assert errors[0] / errors[30] == pytest.approx(154.7, abs=0.1)


def test_fish_that_only_pushes() -> None:
    errors = uncut(replace(FISH, low=0.0), 30)
    assert errors[0] / errors[-1] == pytest.approx(10.84, abs=0.01)
    assert errors[-1] == pytest.approx(0.00369, abs=5e-6)


def test_fish_of_other_steps_and_methods() -> None:
    """The first iterations within 1 %; from the fifth on they depend on the step, by 3 % there."""
    base = uncut(FISH, 4)
    for step, method in ((0.1, "rk4"), (0.1, "euler"), (0.05, "euler")):
        found = uncut(replace(FISH, step=step, method=method), 4)
        np.testing.assert_allclose(found, base, rtol=0.01)


def test_fish_in_float() -> None:
    double, single = (
        EXAMPLES["ch3-fish"].run(ExampleOptions(precision=precision, iterations=8)).max_abs_error
        for precision in ("double", "float")
    )
    np.testing.assert_allclose(single, double, rtol=1e-4, atol=1e-7)


@pytest.mark.soak
@pytest.mark.parametrize(("kp", "wanted"), [(0.0, 0.026), (1.0, 6.8e-5), (2.0, 0.048)])
def test_fish_gains(kp: float, wanted: float) -> None:
    errors = uncut(replace(FISH, kp=kp, history="first"), 40)
    assert errors[40] == pytest.approx(wanted, rel=0.02)


@pytest.mark.soak
def test_fish_random_lengths() -> None:
    found = FISH.problem().series(range(1, 201), 30).max_abs_error
    ratios = found[:, 0] / found[:, 30]
    assert np.median(ratios) == pytest.approx(113.6, abs=0.1)
    assert (ratios > 90).mean() >= 0.96
    late = uncut(replace(FISH, step=0.01), 30)[25:]
    np.testing.assert_allclose(uncut(FISH, 30)[25:], late, rtol=0.01)


def test_printed_drag_escapes_in_the_first_learned_trial() -> None:
    found = replace(FISH, rate=fish_rate_printed, step=0.1).problem().series(range(1, 21), 2)
    assert (found.diverged == 1).all()
    assert np.isnan(found.max_abs_error[:, 1:]).all()
    run = found.example_run(cut=True)
    assert run.diverged == 1
    assert len(run.max_abs_error) == 1


def test_wanted_thrust_of_the_fish() -> None:
    t = np.linspace(0.0, 50.0, 500_001)
    u = fish_exact_input(t)
    assert u.max() == pytest.approx(0.11255, abs=5e-6)
    assert t[u.argmax()] == pytest.approx(24.73, abs=0.005)
    assert u.min() == pytest.approx(-0.0016391, abs=5e-8)
    assert t[u.argmin()] == pytest.approx(46.67, abs=0.005)
    assert t[1:-1][u[1:-1] < 0][0] == pytest.approx(44.302, abs=5e-4)


# --- conditions, lengths, options


def test_conditions() -> None:
    reached = example1_reached()
    assert reached[-1] == pytest.approx(0.5, abs=1e-12)
    assert contraction(0.2, 5, (0.5, 1.5), reached) == pytest.approx(0.15, abs=1e-12)
    fish = contraction(1 / 3, 3, (1.0, 1.0), [1.0, 8 / 14])
    assert 3 * fish == pytest.approx(3 / 7, abs=1e-12)
    assert rho_least(0.5, (0.5, 1.5)) == pytest.approx(0.75)
    np.testing.assert_allclose(beta_bounds(5, 0.5, (0.5, 1.5), 0.75), (0.2, 0.2))


def test_lengths_are_drawn_from_the_examples_distributions() -> None:
    normal = np.array([EXAMPLE1.draw(2, i) for i in range(4000)])
    assert abs(normal.mean() - 2.0) < 0.02
    assert abs(normal.std() - 0.25) < 0.01
    uniform = np.array([FISH.draw(2, i) for i in range(4000)])
    assert 44.0 <= uniform.min() < 44.05
    assert 57.95 < uniform.max() < 58.0
    assert abs((uniform >= 50.0).mean() - 8 / 14) < 0.03


@pytest.mark.parametrize(
    "options", [{"step": 0.3}, {"step": 0.0}, {"step": 2.0}, {"m": 16}, {"m": -1}]
)
def test_options_that_do_not_fit_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        EXAMPLES["ch3-ex1"].run(ExampleOptions(**options))


# --- claims and figures


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seeds in (("SEEDS", 40), ("_SWEEP_SEEDS", 5), ("_ESCAPE_SEEDS", 5)):
        monkeypatch.setattr(chapter3, name, range(1, seeds + 1))
    monkeypatch.setattr(chapter3, "_FIGURE_SEEDS", range(1, 4))
    monkeypatch.setattr(chapter3, "_FIGURE_LAST", (6, 4))


def coarse(example: Example, **changes: float) -> Study:
    """Of the fish with a longer step."""
    step = {"step": 0.25} if example is chapter3.EX2 else {}
    return Study(example.with_setting(replace(example.setting, **step, **changes)))


@pytest.mark.usefixtures("quick")
def test_claims() -> None:
    found = {
        name: [claim.verdict for claim in coarse(example).judge()]
        for name, example in EXAMPLES.items()
    }
    assert found["ch3-ex1"] == [CONFIRMED, CONFIRMED, CONFIRMED, READING]
    assert found["ch3-fish"] == [READING, NOT_CONFIRMED, NOT_CONFIRMED]


@pytest.mark.usefixtures("quick")
def test_verdicts_follow_the_computation() -> None:
    found = [claim.verdict for claim in coarse(EXAMPLES["ch3-ex1"], beta=0.05).judge()]
    assert found[:2] == [NOT_CONFIRMED, NOT_CONFIRMED]
    assert found[3] == NOT_CONFIRMED
    assert coarse(EXAMPLES["ch3-fish"], kp=0.1).judge()[0].verdict == NOT_CONFIRMED


@pytest.mark.painted
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", EXAMPLES)
def test_figures(name: str, tmp_path: Path) -> None:
    figures = coarse(EXAMPLES[name]).draw(tmp_path)
    assert len(figures) == 3  # two with a number, and one of ours
    for figure in figures:
        assert figure.path.stat().st_size > 1_500
