"""The planner against scipy, against the conditions of an optimum, and on the simulator's plant."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from tailbeat.core import reference
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.learning.error_bound_solve import plant_beats, plant_config
from tailbeat.learning.fish_model import Conditions, FishModel
from tailbeat.learning.planner import box_step, plan

Array = F64

AMPLITUDE_MAX_RAD = math.pi / 4
THESIS = reference.thesis().speed_m_s.astype(np.float64)


def fish(kappa_per_m: float, delay_s: float = 0.3) -> FishModel:
    return FishModel(kappa_per_m, 0.219, 0.197, delay_s)


@pytest.mark.parametrize("beats", [1, 2, 3])
@pytest.mark.parametrize("power", [2.0, 6.0])
def test_thrust_that_comes_after_the_end_is_not_spent(beats: int, power: float) -> None:
    wanted = np.full(beats, 0.05)
    found = plan(fish(10.0, delay_s=beats + 0.2), wanted, 1.0, AMPLITUDE_MAX_RAD, power=power)
    assert found.amplitude_rad.tolist() == [0.0] * beats
    assert found.predicted_m_s.tolist() == [0.0] * beats
    assert found.max_abs_error_m_s == pytest.approx(0.05)


def cost(model: FishModel, amplitude: Array, wanted: Array = THESIS) -> float:
    return float(np.sum((wanted - model.beats(amplitude, 1.0)) ** 2))


@pytest.mark.parametrize("seed", range(40))
def test_box_step_is_scipys_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 12))
    a, b = rng.standard_normal((n + 3, n)), 3 * rng.standard_normal(n + 3)
    low, high = -rng.random(n) * (rng.random(n) < 0.6), rng.random(n) * (rng.random(n) < 0.6)
    found = box_step(a.T @ a, -a.T @ b, low, high)
    assert np.all((low <= found) & (found <= high))
    free = low < high  # scipy wants some room
    wanted = np.zeros(n)
    if free.any():
        wanted[free] = lsq_linear(
            a[:, free], b, (low[free], high[free]), method="bvls", tol=1e-14
        ).x
    np.testing.assert_allclose(found, wanted, atol=1e-7)


@pytest.mark.parametrize(("kappa", "delay_s"), [(5, 0.3), (10, 0.0), (10, 0.3), (20, 1.4)])
def test_least_squares_is_scipys(kappa: float, delay_s: float) -> None:
    model = fish(kappa, delay_s)
    w_max = float(model.steady_m_s(AMPLITUDE_MAX_RAD)) ** 2

    def miss(x: Array) -> Array:
        return 100 * (np.diff(model.distance(x * w_max, 1.0)[0]) - THESIS)

    begin = np.clip(THESIS**2 / w_max, 1e-6, 1 - 1e-6)
    theirs = least_squares(
        miss, begin, bounds=(0, 1), xtol=1e-12, ftol=1e-12, gtol=1e-12, x_scale=0.1, max_nfev=60
    )
    mine = plan(model, THESIS, 1.0, AMPLITUDE_MAX_RAD)
    rms = math.sqrt(2 * theirs.cost / len(THESIS)) / 100
    found = math.sqrt(np.mean((THESIS - mine.predicted_m_s) ** 2))
    assert found == pytest.approx(rms, rel=1e-5)
    assert found <= rms * (1 + 1e-7)


@pytest.mark.parametrize("power", [2, 6])
def test_no_beat_wants_to_move(power: float) -> None:
    model, scatter_m_s = fish(10), 0.002

    def value(amplitude: Array) -> float:
        error = 1e3 * (THESIS - model.beats(amplitude, 1.0))
        return float(np.sum((error**2 + (1e3 * scatter_m_s) ** 2) ** (power / 2)))

    best = plan(model, THESIS, 1.0, AMPLITUDE_MAX_RAD, power=power, scatter_m_s=scatter_m_s)
    amplitude = best.amplitude_rad
    assert 4 <= np.count_nonzero(best.amplitude_rad == 0) <= 12
    lowest = value(amplitude)
    for k in range(len(amplitude)):
        for step in (-0.002, 0.002):
            moved = amplitude.copy()
            pushed = model.dead_zone_rad if amplitude[k] == 0 and step > 0 else amplitude[k]
            moved[k] = np.clip(pushed + step, 0, AMPLITUDE_MAX_RAD)
            assert value(moved) >= lowest * (1 - 1e-6), (k, step)


@pytest.mark.parametrize(
    ("kappa", "lsq_mm", "minimax_mm"), [(5, 17.2, 16.0), (10, 11.3, 10.5), (20, 7.2, 6.84)]
)
def test_reaches_the_floor_on_the_simulators_plant(
    kappa: float, lsq_mm: float, minimax_mm: float
) -> None:
    config = plant_config("tank", {"kappa_per_m": kappa})

    def largest_mm(power: float) -> float:
        made = plan(fish(kappa), THESIS, 1.0, AMPLITUDE_MAX_RAD, power=power, scatter_m_s=0.002)
        return 1e3 * float(np.abs(THESIS - plant_beats(config, made.amplitude_rad, 1.0)).max())

    assert largest_mm(2) == pytest.approx(lsq_mm, rel=0.02)
    assert minimax_mm * 0.99 < largest_mm(6) < largest_mm(2) * 0.99


def test_disturbance_flow_gain_and_start_are_planned_for() -> None:
    model = fish(10)
    disturbance = 0.004 * np.sin(np.arange(40) / 5)
    given = Conditions(start_m_s=0.01, flow_m_s=0.002, gain=0.9)
    wanted = np.full(40, 0.05)
    made = plan(model, wanted, 1.0, AMPLITUDE_MAX_RAD, disturbance, given)
    recorded = model.beats(made.amplitude_rad, 1.0, given) + disturbance
    np.testing.assert_allclose(recorded[8:], wanted[8:], atol=1e-4)
    np.testing.assert_allclose(made.predicted_m_s, recorded)


def test_limits_hold() -> None:
    model = fish(10)
    fast = plan(model, np.full(10, 0.5), 1.0, 0.4)
    assert np.all(fast.amplitude_rad == 0.4)
    still = plan(model, np.zeros(10), 1.0, 0.4)
    assert not still.amplitude_rad.any()
    weak = plan(model, THESIS, 1.0, 0.19)
    assert not weak.amplitude_rad.any()
    low, high = np.full(40, 0.25), np.full(40, 0.45)
    boxed = plan(model, THESIS, 1.0, AMPLITUDE_MAX_RAD, low_rad=low, high_rad=high)
    assert boxed.amplitude_rad.min() == 0.25 and boxed.amplitude_rad.max() == 0.45
    inner = plan(model, THESIS, 1.0, AMPLITUDE_MAX_RAD)
    assert cost(model, boxed.amplitude_rad) < cost(model, np.clip(inner.amplitude_rad, low, high))


def test_beats_whose_thrust_comes_after_the_end_rest() -> None:
    made = plan(fish(10, delay_s=2.3), np.full(20, 0.06), 1.0, AMPLITUDE_MAX_RAD)
    assert not made.amplitude_rad[-2:].any()
    assert np.all(made.amplitude_rad[2:-3] > 0.4)


def test_same_input_same_bits_and_a_step_that_the_servo_knows() -> None:
    one, two = (plan(fish(10), THESIS, 1.0, AMPLITUDE_MAX_RAD, power=6) for _ in range(2))
    assert one.amplitude_rad.tobytes() == two.amplitude_rad.tobytes()
    np.testing.assert_allclose(
        one.amplitude_rad * 1e5, np.round(one.amplitude_rad * 1e5), atol=1e-6
    )


@pytest.mark.parametrize("bad", [np.array([]), np.array([0.1, np.nan]), np.zeros((2, 2))])
def test_nonsense_is_refused(bad: Array) -> None:
    with pytest.raises(InputError):
        plan(fish(10), bad, 1.0, AMPLITUDE_MAX_RAD)
