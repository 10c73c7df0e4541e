"""The gain along the iterations: by the Kalman filter's own claim, in simulation."""

from __future__ import annotations

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.learning.assessment import fluctuation, gain_schedule, repeat_variance
from tailbeat.learning.convergence import NoiseBand, Score

NOISE = 4e-6  # (2 mm/s)**2, of a beat between repeats on the tank plant


def learned_variance(steps: list[float], start: float, walk: float = 0.0) -> float:
    """Variance of what is left to learn, by 4000 scalar series of x := x - step*(x + noise)."""
    random = np.random.default_rng(3)
    x = random.normal(0, np.sqrt(start), 4000)
    for step in steps:
        x = x - step * (x + random.normal(0, np.sqrt(NOISE), 4000))
        x = x + random.normal(0, np.sqrt(walk), 4000)
    return float(np.var(x))


def test_a_fixed_gain_leaves_what_the_formula_says() -> None:
    for step in (0.3, 0.85):
        left = learned_variance([step] * 40, 1e-4)
        assert left == pytest.approx(step * NOISE / (2 - step), rel=0.08)


@pytest.mark.parametrize("walk", [0.0, 2e-7])
@pytest.mark.parametrize("start", [NOISE, 1e-4, 1e-3])
def test_no_fixed_gain_learns_as_well(start: float, walk: float) -> None:
    """After 12 trials; the board's sequence comes near the filter's."""
    found = gain_schedule(NOISE, start, 1.0, walk, trials=12)
    kalman = learned_variance(list(found.kalman), start, walk)
    board = learned_variance(list(found.board), start, walk)
    fixed = [learned_variance([a] * 12, start, walk) for a in np.arange(0.1, 1.01, 0.1)]
    assert kalman <= 1.02 * min(fixed)
    assert board <= 1.25 * kalman


def test_without_wandering_the_gain_falls_as_one_over_the_trials() -> None:
    found = gain_schedule(NOISE, 1e3 * NOISE, 1.0, trials=10)
    np.testing.assert_allclose(found.kalman, 1 / (np.arange(10) + 1 + 1e-3), rtol=1e-9)
    assert (found.fade, found.fade_from) == (pytest.approx(1.0, abs=0.01), 0)
    np.testing.assert_allclose(found.board, found.kalman, atol=0.01)


def test_the_full_gain_stays_as_long_as_it_is_needed() -> None:
    found = gain_schedule(NOISE, 1e-3, 0.85, settled_after=4)
    np.testing.assert_array_equal(found.kalman[:4], 1.0)
    np.testing.assert_array_equal(found.board[: found.fade_from + 1], 1.0)
    assert found.fade_from == 3
    assert gain_schedule(NOISE, 1e-3, 0.02, trials=3).fade == 0.0


def test_variances_that_make_no_sense() -> None:
    for wrong in ((0.0, 1e-4), (NOISE, -1.0), (float("nan"), 1e-4)):
        with pytest.raises(InputError, match="variances"):
            gain_schedule(*wrong)


def scored(*mm: float) -> list[Score]:
    return [
        Score(at, at, at, value / 1e3, True, np.array([value / 1e3], np.float32))
        for at, value in enumerate(mm, 1)
    ]


def test_fluctuation_over_noise() -> None:
    band = NoiseBand(1 - 1.96 / 12, 1 + 1.96 / 12, 5, 0.012)  # sigma 1 mm/s
    assert fluctuation(scored(70, 30, 12, 13, 14), band) is None
    settled = [12.0, 13.5, 12.5, 14.0, 12.0]
    found = fluctuation(scored(70, 30, *settled), band)
    assert found == pytest.approx(np.std(settled, ddof=1), rel=1e-9)
    assert fluctuation([], band) is None


def test_variance_between_repeats() -> None:
    random = np.random.default_rng(5)
    shape = np.linspace(-0.01, 0.02, 40)
    scores = [
        Score(n, n, n // 4, 0.02, True, error_m_s=(shape * n + e).astype(np.float32))
        for n, e in enumerate(random.normal(0, 0.002, (12, 40)))
    ]
    same = [
        Score(n, n, n // 4, 0.02, True, error_m_s=(shape * (n // 4) + e).astype(np.float32))
        for n, e in enumerate(random.normal(0, 0.002, (12, 40)))
    ]
    assert repeat_variance(same) == pytest.approx(NOISE, rel=0.15)
    different = repeat_variance(scores)
    assert different is not None
    assert different > 10 * NOISE  # the inputs' names say repeats, their errors do not
    assert repeat_variance(scores[:1]) is None
