"""The floor against values from an independent implementation of the plants."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.learning.error_bound import (
    DRAG,
    SATURATED,
    SLEW,
    START,
    error_bound,
    error_bound_range,
    lsq_max_abs_m_s,
)
from tailbeat.learning.error_bound_solve import SimulatedPlant, plant_beats, plant_config
from tailbeat.learning.fish_model import FishModel, TrialSpeeds
from tailbeat.learning.fit import Prior, fit
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan

AMPLITUDE_MAX_RAD = math.pi / 4
TANK = FishModel(10.0, 0.219, 0.197, 0.3)


def of_beats(*speed_m_s: float) -> Reference:
    return Reference(1.0, np.array(speed_m_s, dtype=np.float32), "beats")


@pytest.mark.parametrize(
    ("kappa", "minimax_mm", "lsq_mm"),
    [(2.5, 23.2, 25.6), (5, 15.9, 17.2), (10, 10.4, 11.3), (20, 6.67, 7.1)],
)
def test_tank(kappa: float, minimax_mm: float, lsq_mm: float) -> None:
    config = plant_config("tank", {"kappa_per_m": kappa})
    found = error_bound(config, reference.thesis(), math.pi / 4)
    assert found.minimax_m_s * 1e3 == pytest.approx(minimax_mm, rel=0.01)
    assert found.lsq_max_abs_m_s * 1e3 == pytest.approx(lsq_mm, rel=0.01)


def test_thesis() -> None:
    found = error_bound(plant_config("thesis", {}), reference.thesis(), math.pi / 4)
    assert found.minimax_m_s * 1e3 == pytest.approx(0.83, rel=0.02)
    assert found.lsq_max_abs_m_s * 1e3 == pytest.approx(0.88, rel=0.02)


def test_the_input_reaches_the_floor_and_stays_in_bounds() -> None:
    config = plant_config("tank", {})
    wanted = reference.thesis()
    found = error_bound(config, wanted, 0.6)
    reached = plant_beats(config, found.minimax_input.astype(np.float64), 1.0)
    assert np.abs(wanted.speed_m_s - reached).max() == pytest.approx(found.minimax_m_s, rel=1e-3)
    assert found.minimax_input.min() >= 0
    assert found.minimax_input.max() <= np.float32(0.6)


def test_values_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError):
        plant_config("tank", {"colour": 1})
    config = plant_config("tank", {"kappa_per_m": -1})
    with pytest.raises(InputError):
        error_bound(config, reference.thesis(), 0.7)


@pytest.mark.parametrize(
    ("kappa", "minimax_mm", "lsq_mm"),
    [(5, 16.0, 17.2), (10, 10.5, 11.3), (20, 6.84, 7.2)],
)
def test_an_identified_model_tells_the_floor(
    kappa: float, minimax_mm: float, lsq_mm: float
) -> None:
    """The published values are of the tank with its servo and its ripple, which the model lacks."""
    found = error_bound(replace(TANK, kappa_per_m=kappa), reference.thesis(), AMPLITUDE_MAX_RAD)
    assert found.minimax_m_s * 1e3 == pytest.approx(minimax_mm, rel=0.03)
    assert found.lsq_max_abs_m_s * 1e3 == pytest.approx(lsq_mm, rel=0.03)
    assert found.lsq_rms_m_s < found.minimax_m_s < found.lsq_max_abs_m_s
    (spot,) = found.spots
    assert (spot.last, spot.worst, spot.why) == (39, 39, DRAG)
    assert spot.error_m_s == pytest.approx(-found.lsq_max_abs_m_s)


@pytest.mark.parametrize("kappa", [5.0, 20.0])
def test_least_squares_is_where_no_beat_wants_to_move(kappa: float) -> None:
    """The conditions of Karush, Kuhn and Tucker, by differences; and the planner agrees."""
    model, wanted = replace(TANK, kappa_per_m=kappa), reference.thesis()
    found = error_bound(model, wanted, AMPLITUDE_MAX_RAD)
    u, size = found.lsq_input.astype(np.float64), 1e-4

    def cost(amplitude: np.ndarray) -> float:
        return float(np.sum((wanted.speed_m_s - model.beats(amplitude, 1.0)) ** 2))

    for j in range(len(u)):
        up, down = u.copy(), u.copy()
        up[j], down[j] = u[j] + size, max(u[j] - size, 0)
        assert cost(up) > cost(u) - 1e-10
        assert cost(down) > cost(u) - 1e-10
    planned = plan(model, wanted.speed_m_s, 1.0, AMPLITUDE_MAX_RAD)
    assert found.lsq_max_abs_m_s == pytest.approx(planned.max_abs_error_m_s, rel=1e-3)
    assert lsq_max_abs_m_s(model, wanted, AMPLITUDE_MAX_RAD) == found.lsq_max_abs_m_s


@pytest.mark.parametrize("seed", range(3))
def test_no_input_beats_the_minimax(seed: int) -> None:
    wanted = reference.thesis()
    found = error_bound(TANK, wanted, AMPLITUDE_MAX_RAD)
    best = found.minimax_input.astype(np.float64)
    generator = np.random.default_rng(seed)
    for scale in (1e-4, 1e-3, 1e-2, 0.1):
        for _ in range(100):
            u = best + scale * generator.normal(size=len(best))
            reached = TANK.beats(np.clip(u, 0, AMPLITUDE_MAX_RAD), 1.0)
            error = np.abs(wanted.speed_m_s - reached).max()
            assert error > found.minimax_m_s * (1 - 1e-3)


@pytest.mark.parametrize("beat_s", [1.0, 0.5])
def test_a_start_too_quick_is_late_by_what_full_thrust_gives(beat_s: float) -> None:
    """From rest with thrust from 0.3 s on: x = ln(cosh(kappa*vss*t))/kappa."""
    top = 0.219 * (AMPLITUDE_MAX_RAD - 0.197)
    most = math.log(math.cosh(10 * top * (beat_s - 0.3))) / 10 / beat_s
    wanted = Reference(beat_s, np.array([0.1], dtype=np.float32), "start")
    found = error_bound(TANK, wanted, AMPLITUDE_MAX_RAD)
    assert found.minimax_m_s == pytest.approx(0.1 - most, rel=1e-5)
    assert found.lsq_max_abs_m_s == pytest.approx(0.1 - most, rel=1e-5)
    assert [(spot.worst, spot.why) for spot in found.spots] == [(0, START)]
    silent = error_bound(replace(TANK, delay_s=1.5), of_beats(0.05, 0.05, 0.05), AMPLITUDE_MAX_RAD)
    assert silent.minimax_m_s == pytest.approx(0.05)


def test_a_cruise_too_fast_saturates() -> None:
    found = error_bound(TANK, reference.trapezoid(0.1, 10, 20), 0.5)
    (cruise,) = [spot for spot in found.spots if spot.error_m_s > 0]
    assert cruise.why == SATURATED
    assert found.minimax_m_s == pytest.approx(0.1 - 0.219 * (0.5 - 0.197), abs=2e-4)
    assert found.lsq_input[20] == np.float32(0.5)


def test_an_amplitude_without_thrust_leaves_the_reference() -> None:
    found = error_bound(TANK, reference.thesis(), 0.15)
    assert found.minimax_m_s == pytest.approx(0.0791, rel=1e-4)
    assert found.spots[0].why == SATURATED


def test_a_reference_within_reach_has_no_spots() -> None:
    up = of_beats(*0.08 * np.linspace(0.05, 1, 20) ** 2)
    assert error_bound(TANK, up, AMPLITUDE_MAX_RAD).spots == ()


def test_a_slew_limit_costs() -> None:
    wanted = reference.thesis()
    free = error_bound(TANK, wanted, AMPLITUDE_MAX_RAD)
    before = free.minimax_m_s * (1 - 1e-4)
    for slew in (0.2, 0.05, 0.03, 0.015):
        found = error_bound(TANK, wanted, AMPLITUDE_MAX_RAD, slew)
        for u in (found.minimax_input, found.lsq_input):
            assert np.abs(np.diff(u)).max() <= slew + 1e-6
        assert before <= found.minimax_m_s <= found.lsq_max_abs_m_s
        assert found.lsq_rms_m_s >= free.lsq_rms_m_s * (1 - 1e-4)
        before = found.minimax_m_s
    assert {spot.why for spot in found.spots} == {SLEW}


def test_the_slew_limited_floor_against_a_general_solver() -> None:
    from scipy.optimize import minimize

    wanted, slew = of_beats(0.01, 0.06, 0.08, 0.02, 0.01, 0.05), 0.06
    found = error_bound(TANK, wanted, AMPLITUDE_MAX_RAD, slew)
    change = np.diff(np.eye(6), axis=0)
    limits = {"type": "ineq", "fun": lambda u: slew - np.r_[change @ u, -change @ u]}

    def cost(u: np.ndarray) -> float:
        return 1e4 * float(np.sum((wanted.speed_m_s - TANK.beats(u, 1.0)) ** 2))

    general = minimize(
        cost,
        np.full(6, 0.4),
        method="SLSQP",
        bounds=[(0.197, AMPLITUDE_MAX_RAD)] * 6,
        constraints=limits,
        options={"ftol": 1e-12, "maxiter": 500},
    )
    rms = math.sqrt(general.fun / 1e4 / 6)
    assert found.lsq_rms_m_s == pytest.approx(rms, rel=2e-3)


def test_delay_gain_and_dead_zone_do_not_move_a_floor_of_drag() -> None:
    wanted = reference.thesis()
    right = lsq_max_abs_m_s(TANK, wanted, AMPLITUDE_MAX_RAD)
    wrong = FishModel(10.0, 0.219 * 0.85, 0.197 * 1.3, 0.1)
    assert lsq_max_abs_m_s(wrong, wanted, AMPLITUDE_MAX_RAD) == pytest.approx(right, rel=0.02)


RUNS = [np.r_[np.full(16, a), np.zeros(4)] for a in (0.4, 0.55, 0.7)]
RUNS.append(np.r_[np.full(10, 0.7), np.zeros(14)])


@pytest.mark.parametrize("kappa", [5.0, 10.0, 20.0])
@pytest.mark.parametrize(
    ("fish", "allowed"),
    [
        pytest.param({}, 0.15, id="right"),
        pytest.param(
            {"map_bend_m_s_rad2": 0.15, "slope_m_s_rad": 0.15, "servo_lag_s": 0.12},
            0.25,
            id="bent map, slow servo",
        ),
    ],
)
@pytest.mark.parametrize("corner", [(0.6, -0.2, 0.85, 1.3), (1.4, 0.2, 1.15, 0.7)])
def test_the_floor_before_the_first_trial(
    kappa: float,
    fish: dict[str, float],
    allowed: float,
    corner: tuple[float, float, float, float],
) -> None:
    """Three cruises and a coast-down, fitted from a wrong belief."""
    config = plant_config("tank", {"kappa_per_m": kappa, **fish})
    generator = np.random.default_rng(11)
    trials = []
    for u in RUNS:
        speed = plant_beats(config, u, 1.0) * (1 + 0.02 * generator.normal())
        speed += 0.0015 * generator.normal() + 0.0007 * generator.normal(size=len(u))
        trials.append(TrialSpeeds(u, speed, np.full(len(u), 0.0007)))
    drag, later, gain, dead = corner
    belief = FishModel(kappa * drag, 0.219 * gain, 0.197 * dead, 0.3 + later)
    model = fit(trials, Prior(model=belief)).model
    predicted = lsq_max_abs_m_s(model, reference.thesis(), AMPLITUDE_MAX_RAD)
    true = lsq_max_abs_m_s(config, reference.thesis(), AMPLITUDE_MAX_RAD)
    assert predicted == pytest.approx(true, rel=allowed)


def test_the_band_is_of_the_models() -> None:
    models = [replace(TANK, kappa_per_m=kappa) for kappa in np.linspace(8, 12, 21)]
    found = error_bound_range(
        Identified(TANK, models, np.eye(4)), reference.thesis(), AMPLITUDE_MAX_RAD
    )
    low, high = found.lsq_max_abs_m_s
    expected = [
        lsq_max_abs_m_s(replace(TANK, kappa_per_m=kappa), reference.thesis(), AMPLITUDE_MAX_RAD)
        for kappa in (11.8, 8.2)
    ]
    assert [low, high] == pytest.approx(expected)
    assert low < found.bound.lsq_max_abs_m_s < high


@pytest.mark.parametrize(("amplitude_max", "slew"), [(0.0, None), (0.5, 0.0), (-1.0, None)])
def test_limits_that_make_no_sense_are_refused(amplitude_max: float, slew: float | None) -> None:
    with pytest.raises(InputError, match="more than 0 rad"):
        error_bound(TANK, reference.thesis(), amplitude_max, slew)


def test_a_map_that_falls_again_is_used_up_to_its_top() -> None:
    """vss = slope*x - 0.3*x**2 beyond the dead zone is highest at x = slope/0.6."""
    config = plant_config("tank", {"map_bend_m_s_rad2": -0.3, "servo_lag_s": 0.0})
    top = 0.197 + 0.219 / 0.6
    wanted = reference.thesis()
    assert SimulatedPlant(config, 1.0, AMPLITUDE_MAX_RAD).w_max == pytest.approx(
        SimulatedPlant(config, 1.0, top).w_max, rel=1e-3
    )
    all_of_it, below = (error_bound(config, wanted, most) for most in (AMPLITUDE_MAX_RAD, top))
    assert all_of_it.minimax_input.max() <= top + 0.005
    assert all_of_it.minimax_m_s == pytest.approx(below.minimax_m_s, rel=0.01)
