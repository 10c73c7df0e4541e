"""The model against an ODE solver that knows nothing of its closed form, and its derivatives
against differences."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tailbeat.core.errors import InputError
from tailbeat.learning.error_bound_solve import plant_beats, plant_config
from tailbeat.learning.fish_model import Conditions, FishModel

CASES = [
    # kappa, delay, start, beat, parts
    (10.0, 0.3, 0.01, 1.0, 1),
    (5.0, 1.3, 0.0, 1.0, 2),
    (20.0, 0.75, 0.02, 0.8, 2),
    (414.0, 0.0, 0.0, 1.0, 1),
    (2.5, 0.5, 0.05, 1.0, 2),
    (10.0, 30.0, 0.05, 1.0, 1),  # the thrust comes after the trial
]


def thrust(beats: int = 8) -> np.ndarray:
    w = np.random.default_rng(1).uniform(0, 0.016, beats)
    w[0], w[3] = 1e-9, 0.0
    return w


def solved(model: FishModel, w: np.ndarray, beat_s: float, start: float, parts: int) -> np.ndarray:
    """Distances by DOP853 between the instants where the thrust changes."""
    marks = np.arange(len(w) * parts + 1) * beat_s / parts
    switches = model.delay_s + np.arange(len(w) + 1) * beat_s
    corners = np.unique(np.r_[marks, switches[switches < marks[-1]]])
    state, distance = [0.0, start], {0.0: 0.0}
    for begin, end in itertools.pairwise(corners):
        beat = int(np.floor(((begin + end) / 2 - model.delay_s) / beat_s))
        h = w[beat] if 0 <= beat < len(w) else 0.0
        found = solve_ivp(
            lambda _t, y, h=h: [y[1], model.kappa_per_m * (h - y[1] * abs(y[1]))],
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-10,
            atol=1e-13,
        )
        state = list(found.y[:, -1])
        distance[end] = state[0]
    return np.array([distance[mark] for mark in marks])


@pytest.mark.parametrize(("kappa", "delay", "start", "beat_s", "parts"), CASES)
def test_distance_is_the_equation_s(
    kappa: float, delay: float, start: float, beat_s: float, parts: int
) -> None:
    model = FishModel(kappa, 0.2, 0.2, delay)
    distance, _, _ = model.distance(thrust(), beat_s, start, parts)
    expected = solved(model, thrust(), beat_s, start, parts)
    assert distance == pytest.approx(expected, abs=1e-9)
    assert expected[-1] > 0


@pytest.mark.parametrize(("kappa", "delay", "start", "beat_s", "parts"), CASES)
def test_slopes_are_the_differences(
    kappa: float, delay: float, start: float, beat_s: float, parts: int
) -> None:
    w, step = thrust(), 1e-6
    at, by_w, by_model = FishModel(kappa, 0.2, 0.2, delay).distance(w, beat_s, start, parts, True)
    assert by_w is not None and by_model is not None
    for j in range(len(w)):
        moved = w.copy()
        moved[j] += step * 0.01
        other, _, _ = FishModel(kappa, 0.2, 0.2, delay).distance(moved, beat_s, start, parts)
        assert by_w[:, j] == pytest.approx((other - at) / (step * 0.01), abs=3e-4 * by_w.max())
    faster, _, _ = FishModel(kappa * (1 + step), 0.2, 0.2, delay).distance(w, beat_s, start, parts)
    later, _, _ = FishModel(kappa, 0.2, 0.2, delay + step).distance(w, beat_s, start, parts)
    moving, _, _ = FishModel(kappa, 0.2, 0.2, delay).distance(w, beat_s, start + step, parts)
    assert by_model[:, 0] == pytest.approx((faster - at) / (step * kappa), abs=1e-6)
    assert by_model[:, 1] == pytest.approx((later - at) / step, abs=1e-6)
    # a start from rest has a bend of 1/kappa metres in it
    assert by_model[:, 2] == pytest.approx((moving - at) / step, abs=1e-3)


def test_beats_are_the_simulator_s_where_it_is_simple() -> None:
    """Without a servo, the ripple within a beat is the only difference, and beat means do not feel
    it but at the switch."""
    config = plant_config("tank", {"servo_lag_s": 0, "servo_rate_rad_s": 0, "delay_s": 0})
    amplitude = np.array([0.3, 0.35, 0.45, 0.5, 0.55, 0.55, 0.5, 0.4, 0.3, 0.0, 0.0])
    model = FishModel(10.0, 0.219, 0.197, 0.0)
    assert model.beats(amplitude, 1.0) == pytest.approx(
        plant_beats(config, amplitude, 1.0), abs=3e-4
    )


def test_conditions_act_as_named() -> None:
    model = FishModel(10.0, 0.2, 0.2, 0.3)
    amplitude = np.full(30, 0.6)
    still = model.beats(amplitude, 1.0)
    assert still[-1] == pytest.approx(0.08, abs=1e-6)
    drifting = model.beats(amplitude, 1.0, Conditions(flow_m_s=0.01))
    assert drifting == pytest.approx(still + 0.01)
    strong = model.beats(amplitude, 1.0, Conditions(gain=1.1))
    assert strong[-1] == pytest.approx(0.088, abs=1e-6)
    thrown = model.beats(amplitude, 1.0, Conditions(start_m_s=0.05))
    assert thrown[0] > still[0] + 0.02 and thrown[-1] == pytest.approx(still[-1], abs=1e-9)


def test_map_and_its_inverse() -> None:
    model = FishModel(10.0, 0.2, 0.2, 0.3)
    assert model.steady_m_s([0.1, 0.2, 0.7]) == pytest.approx([0, 0, 0.1])
    assert model.amplitude_rad([0.0, 0.1]) == pytest.approx([0.2, 0.7])


@pytest.mark.parametrize("bad", [FishModel(0, 1, 0, 0), FishModel(1, 1, 0, -1)])
def test_a_model_without_sense_is_refused(bad: FishModel) -> None:
    with pytest.raises(InputError, match="no sense"):
        bad.beats([0.5], 1.0)
    with pytest.raises(InputError, match="no sense"):
        FishModel(1, 1, 0, 0).beats([float("nan")], 1.0)
    with pytest.raises(InputError, match="no sense"):
        FishModel(1, 1, 0, 0).beats(np.zeros(513), 1.0)


SHAPES = [
    FishModel(8.0, 0.2, 0.1, 0.33, 0.4, 0.01, 0.3, 0.8),
    FishModel(12.0, 0.15, 0.05, 1.2, -0.6, 0.004, 0.5, 2.5),
    FishModel(6.0, 0.2, 0.15, 0.0, 0.0, 0.0, 0.0, 1.0),
]


@pytest.mark.parametrize("model", SHAPES)
def test_the_maps_ways_there_and_back(model: FishModel) -> None:
    strongest = model.strongest_rad(0.785)
    amplitude = np.linspace(model.dead_zone_rad + 0.01, min(strongest, 0.785) - 0.01, 20)
    assert model.amplitude_of_root(model.root(amplitude)) == pytest.approx(amplitude)
    assert model.amplitude_rad(model.steady_m_s(amplitude)) == pytest.approx(amplitude)
    step = 1e-6
    rise = (model.root(amplitude + step) - model.root(amplitude - step)) / (2 * step)
    assert model.root_slope(amplitude) == pytest.approx(rise, rel=1e-5)
    speed = model.steady_m_s(amplitude)
    rise = (model.steady_m_s(amplitude + step) - model.steady_m_s(amplitude - step)) / (2 * step)
    assert model.steady_slope(speed) == pytest.approx(rise, rel=1e-4)
    assert model.root(strongest) >= np.max(model.root(np.linspace(0, 0.785, 200)))
    straight = model.straight(0.5)
    assert straight.amplitude_rad(0.05) == pytest.approx(model.amplitude_rad(0.05), abs=0.04)


@pytest.mark.parametrize("model", SHAPES)
def test_drag_and_wake_against_small_steps(model: FishModel) -> None:
    """dv/dt = kappa*(f - v*v - linear*v), df by the wake, in 4000 steps a beat."""
    amplitude = 0.4 + 0.3 * np.sin(np.arange(10.0))
    thrust, steps = model.thrust(amplitude), 4000
    v, x, wake, expected = 0.01, 0.0, 0.0, [0.0]
    for beat in range(10):
        for i in range(steps):
            sent = math.floor(beat + (i + 0.5) / steps - model.delay_s)
            w = thrust[sent] if sent >= 0 else 0.0
            force = (1 - model.wake_share) * w + model.wake_share * wake
            drag = v * v + model.linear_drag_m_s * v
            v, x = max(v + model.kappa_per_m * (force - drag) / steps, 0.0), x + v / steps
            wake += (w - wake) / model.wake_s / steps
        expected.append(x)
    distance, _, _ = model.distance(thrust, 1.0, 0.01)
    assert distance == pytest.approx(np.array(expected), abs=3e-4 * expected[-1])


@pytest.mark.parametrize("model", SHAPES[:2])
def test_derivatives_by_the_shape(model: FishModel) -> None:
    thrust = model.thrust(0.4 + 0.3 * np.sin(np.arange(10.0)))
    _, by_w, by_model = model.distance(thrust, 1.0, 0.01, slopes=True)
    assert by_w is not None and by_model is not None
    for name, column in (("linear_drag_m_s", 3), ("wake_share", 4), ("wake_s", 5)):
        step = 1e-6
        low, high = (
            replace(model, **{name: getattr(model, name) + way}).distance(thrust, 1.0, 0.01)[0]
            for way in (-step, step)
        )
        assert by_model[:, column] == pytest.approx((high - low) / (2 * step), abs=1e-6), name
    for k in (0, 4, 9):
        more = thrust.copy()
        more[k] += 1e-7
        moved = model.distance(more, 1.0, 0.01)[0] - model.distance(thrust, 1.0, 0.01)[0]
        assert by_w[:, k] == pytest.approx(moved / 1e-7, abs=1e-4)
