"""Chapter 5: golden series recomputed independently, the loop once more in numpy, the claims."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import chapter5
from tailbeat.studies.thesis.chapter5 import (
    CASE1_SIGN,
    CASE1_SMOOTH,
    CASE2,
    EXAMPLES,
    bounded,
    input_gain,
    inverse_by_norm,
)
from tailbeat.studies.thesis.example import (
    CONFIRMED,
    NOT_CONFIRMED,
    READING,
    Example,
    ExampleOptions,
    ExampleRun,
)
from tailbeat.studies.thesis.learner import Precision
from tailbeat.studies.thesis.plants.feedback import Chapter5, TimeGrid, run_trials
from tailbeat.studies.thesis.study import Study

Doubles = F64

# Recomputed independently: trial -> max|e| of both states. Sign: input held, 5000 steps; the others
# RK4, 500.
SIGN = {
    1: (0.5, 0.35), 2: (0.01829, 0.10608), 3: (0.00565, 0.04873), 5: (0.00275, 0.02803),
    10: (0.00128, 0.01611), 20: (5.7e-4, 0.00676), 50: (6.0e-4, 0.00302),
}  # fmt: skip
SMOOTH = {
    1: (0.5, 0.35), 2: (0.041995, 0.112803), 3: (0.034497, 0.072205), 5: (0.029485, 0.059481),
    10: (0.024150, 0.047694), 20: (0.020114, 0.039146), 50: (0.015759, 0.030132),
}  # fmt: skip
UNCERTAIN = {
    1: (0.5, 0.35), 2: (0.057648, 0.109103), 3: (0.044426, 0.067450), 5: (0.032861, 0.055003),
    10: (0.020655, 0.044082), 20: (0.013156, 0.035735), 50: (0.007267, 0.026572),
}  # fmt: skip
HALF_A_DIGIT = 6e-7
PRECISIONS: tuple[Precision, ...] = ("double", "float")
Golden = dict[int, tuple[float, float]]


def example(id: str) -> Example:
    return next(one for one in EXAMPLES if one.id == id)


def check(errors: Doubles, golden: Golden, relative: float) -> None:
    for trial, expected in golden.items():
        allowed = relative * np.array(expected) + HALF_A_DIGIT
        assert np.all(np.abs(errors[trial - 1] - expected) <= allowed), trial


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(("id", "golden"), [("ch5-case1-smooth", SMOOTH), ("ch5-case2", UNCERTAIN)])
def test_the_smooth_laws(id: str, golden: Golden, precision: Precision) -> None:
    run = example(id).run(ExampleOptions(precision=precision))
    assert run.iterations.tolist() == list(range(1, 51))
    check(run.max_abs_error, golden, 2e-4)
    finer = example(id).run(ExampleOptions(precision=precision, step=0.5 / 900))
    check(finer.max_abs_error, golden, 2e-4)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_sign_law(precision: Precision) -> None:
    run = example("ch5-case1-sign").run(ExampleOptions(precision=precision))
    for trial, (first, second) in SIGN.items():
        if trial <= 20:
            assert run.max_abs_error[trial - 1, 1] == pytest.approx(second, rel=0.05), trial
        # The first is the chatter's, which no two computers share to the last digit.
        assert run.max_abs_error[trial - 1, 0] == pytest.approx(first, rel=0.1), trial


@pytest.mark.parametrize(("setting", "golden"), [(CASE1_SMOOTH, SMOOTH), (CASE2, UNCERTAIN)])
def test_a_held_input(setting: Chapter5, golden: Golden) -> None:
    held = run_trials(replace(setting, grid=TimeGrid(500, "held")), 50)
    check(held.max_abs_error, golden, 0.007)
    coarse = run_trials(replace(setting, grid=TimeGrid(100, "held")), 10)
    check(coarse.max_abs_error, {i: row for i, row in golden.items() if i <= 10}, 0.033)


# The loop once more, in the thesis's own signs and symbols.


class Independent:
    def __init__(self, setting: Chapter5) -> None:
        self.setting, self.steps = setting, setting.grid.steps
        self.theta, self.eta = np.zeros(self.steps + 1), np.zeros(self.steps + 1)
        self.x = np.array([1.5, -0.4])

    def wanted(self, t: float) -> Doubles:
        return np.array(
            [0.5 * math.sin(8 * math.pi * t) + 1, -0.25 * math.cos(16 * math.pi * t) - 0.5]
        )

    def gain(self, t: float, x: Doubles) -> Doubles:
        return np.diag(
            [
                2 + math.sin(x[0]) + 0.1 * math.sin(2 * math.pi * t),
                1 + math.sin(x[1]) + 0.1 * math.sin(4 * math.pi * t),
            ]
        )

    def known(self, x: Doubles) -> Doubles:
        return np.array([x[0] + math.sin(x[1]), 2 * math.sin(x[0] + x[1])])

    def law(self, t: float, x: Doubles, theta: float, eta: float) -> tuple[Any, ...]:
        s = self.setting
        e, b = x - self.wanted(t), self.gain(t, x)
        rho = s.bound * float(np.linalg.norm(self.known(x)))
        omega = rho * (np.tanh(rho * e / s.epsilon) if s.smooth else np.sign(e))
        taught = np.where(np.abs(e) > s.dead_zone, e, 0.0)
        theta = min((theta + s.gain_theta * float(taught @ omega)) / (1 + s.leak), s.theta_max)
        u = np.linalg.inv(b) @ (-np.diag([3.0, 2.0]) @ e - theta * omega)
        if s.uncertain:
            pull = b.T @ e
            length = float(np.linalg.norm(pull))
            unit = pull / (length + s.softness)
            kappa = 0.1 * abs(math.sin(x[0]))
            beta = 0.2 * math.sqrt(math.sin(x[0]) ** 2 + 4 * math.sin(x[1]) ** s.beta_power)
            eta = (eta + s.gain_eta * beta * float(pull @ unit)) / (1 + s.leak)
            sizes = [theta, eta]
            sizes = [v * math.tanh(v) for v in sizes] if s.smooth else [abs(v) for v in sizes]
            norm = np.linalg.norm(b, 2)
            inverse = float(np.linalg.norm(np.linalg.inv(b), 2)) if s.inverse_norm else 1 / norm
            reserve = 3.0 * float(np.linalg.norm(e)) * kappa * inverse
            reserve += math.sqrt(2) * kappa * rho * sizes[0] * inverse + kappa * beta * sizes[1]
            u = u - eta * beta * unit - unit * reserve / (1 - 0.1)
        return e, u, theta, eta

    def plant(self, t: float, x: Doubles, u: Doubles) -> Doubles:
        own = [4 * math.pi * math.cos(8 * math.pi * t), 4 * math.pi * math.sin(16 * math.pi * t)]
        push = u
        if self.setting.uncertain:
            push = u - 0.1 * math.sin(x[0]) * u
            push = push + np.array([0.1 * math.sin(x[0]), 0.2 * math.sin(x[1])])
        return self.known(x) + np.array(own) + self.gain(t, x) @ push

    def trial(self) -> Doubles:
        h, x, worst = 0.5 / self.steps, self.x, np.zeros(2)
        theta, eta = self.theta.copy(), self.eta.copy()
        scheme = self.setting.grid.scheme
        for k in range(self.steps + 1):
            t = k * h
            e, u, self.theta[k], self.eta[k] = self.law(t, x, theta[k], eta[k])
            worst = np.maximum(worst, np.abs(e))
            if k == self.steps:
                break

            def slope(part: float, y: Doubles, k: int = k, t: float = t, u: Doubles = u) -> Doubles:
                if scheme == "rk4" and part > 0:
                    between = theta[k] + part * (theta[k + 1] - theta[k])
                    other = eta[k] + part * (eta[k + 1] - eta[k])
                    u = self.law(t + part * h, y, between, other)[1]
                return self.plant(t + part * h, y, u)

            a = slope(0.0, x)
            if scheme == "euler":
                x = x + h * a
                continue
            b = slope(0.5, x + h / 2 * a)
            c = slope(0.5, x + h / 2 * b)
            d = slope(1.0, x + h * c)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
        self.x = x
        return worst


SETTINGS = {
    "I_2, Euler": Chapter5(TimeGrid(400, "euler"), smooth=True, leak=0.03, bound=1.4),
    "I_2, dead zone, cap": replace(
        CASE1_SMOOTH, grid=TimeGrid(350, "held"), dead_zone=0.015, theta_max=3.2, epsilon=0.2
    ),
    "I_1, held": Chapter5(TimeGrid(800, "held")),
    "(5.19)": replace(CASE2, grid=TimeGrid(230, "rk4")),
    "(5.19), other readings": replace(
        CASE2, grid=TimeGrid(260, "held"), beta_power=2, inverse_norm=True, softness=0.01,
        leak=0.01,
        gain_eta=2.5, gain_theta=0.7,
    ),
    "(5.13)": Chapter5(TimeGrid(1000, "held"), uncertain=True),
}  # fmt: skip


@cache
def independent(name: str) -> list[Doubles]:
    mine = Independent(SETTINGS[name])
    return [mine.trial() for _ in range(4)]


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_other_settings_against_numpy(name: str, precision: Precision) -> None:
    found = run_trials(SETTINGS[name], 4, precision)
    smooth = SETTINGS[name].smooth
    relative = 0.05 if not smooth else 1e-9 if precision == "double" else 1e-4
    for trial, expected in enumerate(independent(name), start=1):
        both = slice(None) if smooth else slice(1, None)  # the first is the chatter's
        assert found.error(trial)[both] == pytest.approx(expected[both], rel=relative), trial


# What does not come out, and what cures it.


@pytest.mark.parametrize(("steps", "last", "not_before"), [(250, 200, 100), (500, 400, 200)])
def test_sampled_the_sign_law_cannot_be_computed_in_the_end(
    steps: int, last: int, not_before: int
) -> None:
    found = run_trials(replace(CASE1_SIGN, grid=TimeGrid(steps, "held")), last)
    assert found.diverged is not None and not_before < found.diverged <= last
    assert found.grows()


def test_sampled_finely_it_passes_a_minimum_and_grows() -> None:
    found = run_trials(replace(CASE1_SIGN, grid=TimeGrid(1000, "held")), 400)
    assert found.largest(50) == pytest.approx(0.0041, rel=0.05)
    assert found.largest(400) == pytest.approx(0.11, rel=0.15)
    assert found.grows()


def test_a_dead_zone_and_leakage_cure_it() -> None:
    at = replace(CASE1_SIGN, grid=TimeGrid(1000, "held"))
    dead = run_trials(replace(at, dead_zone=0.02), 1000)
    assert dead.error(1000) == pytest.approx([0.004, 0.020], rel=0.05)
    # 3 % apart: where exactly a dead zone begins is not the thesis's.
    assert dead.max_estimate[-1, 0] == pytest.approx(3.98, rel=0.04)
    assert not dead.grows()
    leaky = run_trials(replace(CASE1_SMOOTH, leak=1e-2), 1000)
    assert leaky.error(1000) == pytest.approx([0.0164, 0.0315], rel=0.01)
    creeping = run_trials(CASE1_SMOOTH, 1000)
    assert creeping.max_estimate[49, 0] == pytest.approx(5.6, rel=0.01)
    assert creeping.max_estimate[-1, 0] == pytest.approx(10.2, rel=0.03)


def test_total_variation_tells_chatter() -> None:
    assert run_trials(CASE1_SIGN, 50).variation(50) == pytest.approx([3173, 12242], rel=0.05)
    assert run_trials(CASE1_SMOOTH, 50).variation(50) == pytest.approx([2.3, 24.7], rel=0.02)
    slow = run_trials(replace(CASE2, grid=TimeGrid(100, "held")), 50)
    assert slow.variation(50)[0] == pytest.approx(69, rel=0.05)
    assert run_trials(CASE2, 50).variation(50)[0] == pytest.approx(2.4, rel=0.05)


def test_the_input_of_the_first_trial() -> None:
    """B is almost singular there."""
    assert run_trials(CASE1_SMOOTH, 1).max_abs_input[0, 1] == pytest.approx(25.7, rel=0.002)


def test_a_smaller_bound_is_slower() -> None:
    found = run_trials(replace(CASE1_SMOOTH, bound=1.0), 5)
    assert found.largest(4) > 0.1 > found.largest(5)


@pytest.mark.parametrize("step", [0.0, -1e-3, 0.6, 1e-9, math.nan])
def test_steps_that_make_no_sense_are_refused(step: float) -> None:
    with pytest.raises(InputError, match="step"):
        example("ch5-case2").run(ExampleOptions(step=step))


def test_iterations_begin_at_one() -> None:
    assert example("ch5-case2").run(ExampleOptions(iterations=3)).iterations.tolist() == [1, 2, 3]
    with pytest.raises(InputError, match="iterations"):
        example("ch5-case2").run(ExampleOptions(iterations=0))


VERDICTS = {
    "ch5-case1-sign": [CONFIRMED, CONFIRMED, READING, CONFIRMED, CONFIRMED],
    "ch5-case1-smooth": [CONFIRMED, CONFIRMED, READING],
    "ch5-case2": [CONFIRMED, CONFIRMED, CONFIRMED, NOT_CONFIRMED],
}


def test_verdicts_of_case2() -> None:
    found = Study(example("ch5-case2")).judge()
    assert [claim.verdict for claim in found] == VERDICTS["ch5-case2"]
    assert found[0].measured == 3.0
    assert found[3].measured == pytest.approx([13.3547, 0.007267, 0.005778], rel=2e-4)
    assert not any(claim.ours for claim in found)


def test_the_norm_of_the_inverse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against numpy's norms, at every moment; and an input gain whose entries are equal."""
    t = np.linspace(0.0, 0.5, 2001)
    largest = max(
        np.linalg.norm(np.linalg.inv(b), 2) * np.linalg.norm(b, 2)
        for b in (np.diag(b) for b in input_gain(t).T)
    )
    assert inverse_by_norm(input_gain(t)) == pytest.approx(largest, rel=1e-12)
    first = [2 + math.sin(1.0), 1 + math.sin(-0.75)]
    assert input_gain(np.zeros(1))[:, 0] == pytest.approx(first)
    monkeypatch.setattr(chapter5, "input_gain", lambda t: np.full((2, len(t)), -1.5))
    assert Study(example("ch5-case2")).judge()[3].verdict == CONFIRMED


def test_what_is_ours_follows_what_is_computed() -> None:
    """The cures, judged on the law that they cure."""
    growing = run_trials(replace(CASE1_SIGN, grid=TimeGrid(1000, "held")), 1000)
    kept = run_trials(replace(CASE1_SIGN, grid=TimeGrid(1000, "held"), dead_zone=0.02), 1000)
    assert [bounded(trials).verdict for trials in (growing, kept)] == [NOT_CONFIRMED, CONFIRMED]
    sign = example("ch5-case1-sign")
    assert [one.entry.ours for one in sign.claims] == [False, False, False, True, True]


def test_rho_has_to_bound() -> None:
    smooth = example("ch5-case1-smooth")
    check = smooth.claims[2].check
    assert check(Study(smooth)).verdict == READING
    less = smooth.with_setting(replace(CASE1_SMOOTH, bound=0.9))
    assert check(Study(less)).verdict == NOT_CONFIRMED


@pytest.mark.soak
@pytest.mark.parametrize("id", VERDICTS)
def test_verdicts(id: str, tmp_path: Path) -> None:
    study = Study(example(id))
    assert [claim.verdict for claim in study.judge()] == VERDICTS[id]
    for figure in study.draw(tmp_path):
        assert figure.path.stat().st_size > 10_000


def test_verdicts_flip_with_what_comes_out(monkeypatch: pytest.MonkeyPatch) -> None:
    bad = run_trials(replace(CASE2, grid=TimeGrid(100, "held")), 50, traced={50})
    rough = replace(
        bad, max_abs_error=bad.max_abs_error + 0.1, input_variation=1e6 + bad.input_variation
    )

    class Rough(Study):
        def run(self, **changes: Any) -> ExampleRun:
            return ExampleRun(np.arange(1, 51), rough.max_abs_error, traces=rough)

    monkeypatch.setattr(chapter5, "LATE", 120)
    monkeypatch.setattr(chapter5, "SAMPLED", {5000: 50})

    def judged(id: str) -> list[str]:
        return [claim.verdict for claim in Rough(example(id)).judge()]

    assert judged("ch5-case2")[:2] == [NOT_CONFIRMED, NOT_CONFIRMED]
    assert judged("ch5-case1-smooth")[0] == NOT_CONFIRMED
    assert judged("ch5-case1-sign")[:3] == [NOT_CONFIRMED, CONFIRMED, NOT_CONFIRMED]
