"""Fits of simulated swims: the numbers come back, and the error bars mean what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.learning.error_bound_solve import plant_beats, plant_config
from tailbeat.learning.fish_model import FishModel, TrialSpeeds
from tailbeat.learning.fit import Prior, bootstrap, fit, sample, vector_of
from tailbeat.learning.scatter import Scatter

SIGMA_M_S = 0.0007
TRUE = FishModel(8.0, 0.22, 0.18, 0.4)
GENTLE = [np.r_[np.linspace(0.2, top, 8), np.full(6, top), np.linspace(top, 0.1, 8), np.zeros(4)]
          for top in (0.45, 0.6, 0.75)]  # fmt: skip


def trial(amplitude: np.ndarray, speed: np.ndarray, rng: np.random.Generator | None) -> TrialSpeeds:
    noise = 0.0 if rng is None else rng.normal(0, SIGMA_M_S, len(speed))
    return TrialSpeeds(amplitude, speed + noise, np.full(len(speed), SIGMA_M_S))


def of_the_model(rng: np.random.Generator | None) -> list[TrialSpeeds]:
    return [trial(u, TRUE.beats(u, 1.0), rng) for u in GENTLE]


def of_the_tank(kappa: float, rng: np.random.Generator) -> list[TrialSpeeds]:
    trials = []
    for amplitude in GENTLE:
        config = plant_config("tank", {"kappa_per_m": kappa})
        config.slope_m_s_rad *= 1 + 0.02 * rng.normal()
        speed = plant_beats(config, amplitude, 1.0) + 0.0015 * rng.normal()
        trials.append(trial(amplitude, speed, rng))
    return trials


NEARLY_NOTHING = Scatter(
    gain=1e-4, flow_m_s=1e-4, start_m_s=1e-4, model_m_s=1e-6, switch=0, moves_m_s=1e-6
)


def numbers(model: FishModel) -> list[float]:
    return list(vars(model).values())


def test_exact_data_give_the_exact_model() -> None:
    """Also one with a shape, whose numbers are told apart by amplitudes that rise and fall."""
    plain = Prior(
        FishModel(10.0, 0.2, 0.17, 0.3), kappa=9, slope=9, dead_zone_rad=9, delay_s=9,
        bend_per_rad=1e-6, linear_drag_m_s=1e-7, wake_share=1e-7, wake_s=1e-6,
    )  # fmt: skip
    found = fit(of_the_model(None), plain, NEARLY_NOTHING)
    assert numbers(found.model)[:4] == pytest.approx(numbers(TRUE)[:4], rel=2e-3)
    assert found.rms_m_s < 2e-6
    shaped = replace(TRUE, bend_per_rad=0.4, linear_drag_m_s=0.01, wake_share=0.3, wake_s=1.5)
    any_fish = Prior(kappa=9, slope=9, dead_zone_rad=9, delay_s=9, bend_per_rad=9,
                     linear_drag_m_s=9, wake_share=9, wake_s=9)  # fmt: skip
    trials = [trial(u, shaped.beats(u, 1.0), None) for u in GENTLE]
    found = fit(trials, any_fish, NEARLY_NOTHING)
    assert numbers(found.model) == pytest.approx(numbers(shaped), rel=0.02)
    assert found.rms_m_s < 1e-5


@pytest.mark.parametrize("kappa", [5.0, 10.0, 20.0])
def test_error_bars_hold_on_the_tank(kappa: float) -> None:
    """20 seeds: slope, dead zone and delay as the servo's lag of 40 ms lets them appear; the delay
    is that of a fit to a noise-free swim at the floor, 0.314 to 0.316 s. This fish has no shape."""
    lag = 1 / np.hypot(1, 2 * np.pi * 0.04)
    expected = np.array([np.log(kappa), np.log(0.219 * lag), 0.197 / lag, 0.315, 0, 0, 0])
    inside, off = np.zeros(7), []
    for seed in range(20):
        found = fit(of_the_tank(kappa, np.random.default_rng(seed)))
        got = vector_of(found.model)[:7]
        inside += np.abs(got - expected) < 1.96 * np.sqrt(np.diag(found.covariance))[:7]
        off.append(found.model.steady_m_s([0.35, 0.5, 0.7]) / (0.219 * lag) - [0.35, 0.5, 0.7])
    assert inside.min() >= 18, inside
    assert np.abs(np.median(off, axis=0) + 0.197 / lag).max() < 0.006  # of the map, in rad


def test_priors_pull_and_data_win() -> None:
    far = Prior(FishModel(20.0, 0.3, 0.1, 0.8))
    certain = Prior(far.model, *np.full(8, 1e-5).tolist())
    trials = of_the_model(np.random.default_rng(3))
    assert numbers(fit(trials, certain).model) == pytest.approx(
        numbers(far.model), rel=1e-2, abs=2e-3
    )
    assert fit(trials, far).model.kappa_per_m == pytest.approx(TRUE.kappa_per_m, rel=0.1)


def test_beats_without_a_speed_do_not_count() -> None:
    trials = of_the_model(np.random.default_rng(4))
    speed = trials[0].speed_m_s.copy()
    speed[5:9] = np.nan
    holed = TrialSpeeds(trials[0].amplitude_rad, speed, trials[0].sigma_m_s)
    found = fit([holed, *trials[1:]])
    assert found.beats == sum(s.beats for s in trials) - 4
    assert np.isnan(found.residual_m_s[0][5:9]).all()
    assert found.model.kappa_per_m == pytest.approx(TRUE.kappa_per_m, rel=0.1)
    with pytest.raises(InputError, match="no beat"):
        fit([TrialSpeeds(GENTLE[0], np.full(26, np.nan), np.full(26, 1e-3))])


def test_bootstrap_and_posterior_agree() -> None:
    """Two ways to the same spread, and both come out the same again."""
    trials = of_the_tank(10.0, np.random.default_rng(5))
    found = fit(trials)
    drawn, posterior = bootstrap(trials, found, 30, seed=2), sample(found, 400, seed=2)
    for name in ("kappa_per_m", "slope_m_s_rad", "dead_zone_rad"):
        spread = np.std([getattr(m, name) for m in drawn])
        expected = np.std([getattr(m, name) for m in posterior])
        assert 0.3 < spread / expected < 1.7, name
    assert bootstrap(trials, found, 2, seed=2) == drawn[:2]
    logs = np.log([m.kappa_per_m for m in posterior])
    assert logs.mean() == pytest.approx(np.log(found.model.kappa_per_m), abs=1e-9)
    assert logs.std() == pytest.approx(np.sqrt(found.covariance[0, 0]), rel=1e-6)
