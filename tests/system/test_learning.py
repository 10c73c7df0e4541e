"""What the product is for: simulated fish learn, over the whole way, with the figures that are
promised for them. The figures are printed: ``pytest -s tests/system/test_learning.py``."""

from __future__ import annotations

import statistics

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.session.trial import run_trial

ZERO_INPUT_ERROR_M_S = 0.0791
SEEDS = [6, pytest.param(20, marks=pytest.mark.soak)]


def max_errors_m_s(plant: str, seed: int, gain: float, lead: int, trials: int) -> list[float]:
    """max|e| of iterations 1… with the thesis's limits on the amplitude."""
    with Fish.connect(f"sim:{plant}", seed=seed) as fish:
        settings = {"AMP_MAX_RAD": 0.785398, "DU_MAX_RAD": 0, "ILC_GAIN": gain, "ILC_LEAD": lead}
        for name, value in settings.items():
            fish.params.set(name, value)
        fish.upload_reference(reference.thesis().record())
        return [fish.learn(run_trial(fish).number).max_abs_error_m_s for _ in range(trials)]


@pytest.mark.parametrize("seeds", SEEDS)
def test_tank_fish_come_down_by_80_percent_in_six_iterations(seeds: int) -> None:
    last = [max_errors_m_s("tank", seed, 4.0, 1, 6)[-1] for seed in range(1, seeds + 1)]
    reductions = sorted(1 - e / ZERO_INPUT_ERROR_M_S for e in last)
    median = statistics.median(reductions)
    span = f"{reductions[0]:.1%} … {reductions[-1]:.1%}"
    print(f"\ntank, gain 4, lead 1, iteration 6, {len(last)} seeds: max|e| down by {median:.1%}")
    print(f"in the median ({span}), to {statistics.median(last) * 1e3:.1f} mm/s")
    assert median >= 0.80


@pytest.mark.parametrize("gain", [pytest.param(4.0, marks=pytest.mark.soak), 7.0])
def test_forty_trials_on_the_thesis_plant_do_not_grow(gain: float) -> None:
    errors = max_errors_m_s("thesis", 1, gain, 0, 40)
    settled = errors[6:]
    print(f"\nthesis, gain {gain:g}: {errors[5] * 1e3:.2f} mm/s at iteration 6,")
    print(f"then at most {max(settled) * 1e3:.2f} mm/s up to iteration 40")
    assert max(settled) <= errors[5] + 0.02e-3
