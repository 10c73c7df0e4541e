"""What the thesis's page says of the estimator laws on a fish in SI units,
dv/dt = -alpha v|v| + u, computed with the C law."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from tailbeat.studies.thesis.learner import load

DRAG_PER_M, PEAK_M_S, TRIAL_S = 31.2485, 0.06, 40.0
TRIALS = 30
PLANT_STEP_S = 0.01

Regressor = Callable[[float, float, "Scalar"], float]  # speed, error, the law's library


class Scalar:
    """feedback_step with one channel and one estimate."""

    def __init__(self, gain: float, gamma: float) -> None:
        native = load("double")
        self.lib, ffi = native.lib, native.ffi
        self.rules = ffi.new("feedback_rule_t[1]", [{"gain": gain, "low": -1e9, "high": 1e9}])
        self.law = ffi.new(
            "feedback_t *",
            {
                "channels": 1, "estimates": 1, "gamma": [gamma], "input_gain_min": 0.1,
                "rules": self.rules,
            },
        )  # fmt: skip
        assert self.lib.feedback_check(self.law) == self.lib.FEEDBACK_OK
        names = ("error", "feed_forward", "input_gain", "phi", "old", "now", "input")
        self.values = {name: ffi.new("double[1]") for name in names}
        self.values["input_gain"][0] = 1.0
        self.moment = ffi.new("feedback_moment_t *")
        for name in names[:4]:
            setattr(self.moment, name, self.values[name])

    def step(self, error: float, rate: float, phi: float, old: float) -> tuple[float, float]:
        v = self.values
        v["error"][0], v["feed_forward"][0], v["phi"][0], v["old"][0] = error, rate, phi, old
        done = self.lib.feedback_step(self.law, self.moment, v["old"], v["now"], v["input"])
        assert done == self.lib.FEEDBACK_OK
        return v["input"][0], v["now"][0]


@dataclass(frozen=True)
class Outcome:
    errors: list[float]  # m/s, max per trial
    middle: float  # the estimate in mid-trial


def wanted(t: float) -> tuple[float, float]:
    s = t / TRIAL_S
    peak = 16 * PEAK_M_S
    return peak * s**2 * (1 - s) ** 2, peak * 2 * s * (1 - s) * (1 - 2 * s) / TRIAL_S


def coast(speed: float, push: float, period: float) -> float:
    steps = max(1, round(period / PLANT_STEP_S))
    h = period / steps
    for _ in range(steps):
        middle = speed + h / 2 * (push - DRAG_PER_M * speed * abs(speed))
        speed += h * (push - DRAG_PER_M * middle * abs(middle))
    return speed


def trial(rate_hz: float, gain: float, regressor: Regressor) -> Outcome:
    law, samples = Scalar(gain, 0.5), round(TRIAL_S * rate_hz)
    bank, errors = [0.0] * (samples + 1), []
    for _ in range(TRIALS):
        speed, worst = 0.0, 0.0
        for k in range(samples + 1):
            reference, slope = wanted(k / rate_hz)
            error = reference - speed
            worst = max(worst, abs(error))
            if not abs(error) <= 1.0:
                return Outcome([*errors, math.inf], math.nan)
            push, bank[k] = law.step(error, slope, regressor(speed, error, law), bank[k])
            speed = coast(speed, push, 1 / rate_hz)
        errors.append(worst)
    return Outcome(errors, bank[samples // 2])


def drag(speed: float, error: float, law: Scalar) -> float:
    return -speed * abs(speed)


def bound(speed: float, error: float, law: Scalar) -> float:
    rho = speed * speed
    return float(rho * law.lib.feedback_tanh(rho * error / 0.1))


def test_in_si_units_the_adaptive_law_learns_nothing() -> None:
    found = trial(25, 1.0, drag)
    assert found.errors[-1] == pytest.approx(found.errors[0], rel=0.01)
    assert -1e-3 < found.middle < 0.0


def test_with_a_gain_it_learns_the_drag() -> None:
    found = trial(25, 1e5, drag)
    assert found.middle == pytest.approx(-DRAG_PER_M, rel=0.01)
    assert found.errors[-1] < 0.4 * found.errors[0]
    assert trial(25, 1e6, drag).errors[-1] < 0.2 * found.errors[0]


@pytest.mark.parametrize("rate_hz", [5, 1])
def test_too_much_gain_for_the_rate_destabilises(rate_hz: float) -> None:
    """q f^2 times the period must stay below 1; 1e6 * 0.06^4 is 13 per second."""
    found = trial(rate_hz, 1e6, drag)
    assert found.errors[-1] > found.errors[0]


def test_in_si_units_the_robust_law_learns_nothing() -> None:
    found = trial(25, 1.0, bound)
    assert found.errors[-1] == pytest.approx(found.errors[0], rel=0.01)
    assert 0.0 <= found.middle < 1e-3
