"""Which explanation of a trial is the likeliest, on trials made of known causes."""

from __future__ import annotations

import numpy as np
import pytest

from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds
from tailbeat.learning.fit import model_of, vector_of
from tailbeat.learning.prediction import (
    OTHER,
    REGULAR,
    SHAPE,
    SPOILT,
    THRUST,
    Expected,
    Explanation,
    explain,
)
from tailbeat.learning.scatter import Scatter
from tailbeat.learning.slopes import speed_and_slopes

BEATS = 40
MODEL = FishModel(10.0, 0.2, 0.1, 0.3, 0.0, 0.004, 0.15, 1.0)
SCATTER = Scatter()
AMPLITUDE = 0.4 + 0.15 * np.sin(np.arange(BEATS) / 5)
SURE = np.diag(np.square(np.array(OTHER) / 20))
LEVEL = 0.01**2


def expected(
    rng: np.random.Generator, gain: float = 0.0, flow_m_s: float = 0.0, fish: FishModel = MODEL
) -> Expected:
    """A trial with its own scatter; ``gain`` and ``flow_m_s``: beyond it."""
    noise = SCATTER.moving(BEATS, 1.0) + np.eye(BEATS) * (0.0007**2 + SCATTER.model_m_s**2)
    trial = TrialSpeeds(AMPLITUDE, np.full(BEATS, np.nan), np.full(BEATS, 0.0007))
    mean, by = speed_and_slopes(MODEL, trial, Conditions(0.002))
    given = Conditions(
        abs(rng.normal(0, SCATTER.start_m_s)),
        rng.normal(0, SCATTER.flow_m_s) + flow_m_s,
        np.exp(rng.normal(0, SCATTER.gain) + gain),
    )
    speed = fish.beats(AMPLITUDE, 1.0, given) + rng.multivariate_normal(np.zeros(BEATS), noise)
    return Expected(speed - mean, by, noise)


def shares(count: int, **causes: object) -> dict[str, float]:
    """How often each kind explains ``count`` trials in a row of one cause."""
    found: list[Explanation] = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        trials = [expected(rng, **causes) for _ in range(count)]  # type: ignore[arg-type]
        found.append(explain(trials, SURE, SCATTER, LEVEL))
    kinds = [one.kind for one in found]
    return {kind: kinds.count(kind) / 100 for kind in (REGULAR, SPOILT, THRUST, SHAPE)}


@pytest.mark.parametrize("count", [1, 2])
def test_regular_trials_are_regular(count: int) -> None:
    found = shares(count)
    assert found[REGULAR] >= 0.95 and found[SHAPE] == 0


def test_one_odd_trial_is_spoilt_and_two_alike_are_a_change() -> None:
    assert shares(1, gain=-0.15)[SPOILT] >= 0.9
    assert shares(1, flow_m_s=0.012)[SPOILT] >= 0.9
    assert shares(2, gain=-0.12)[THRUST] >= 0.9
    assert shares(2, flow_m_s=0.009)[THRUST] >= 0.85


def test_the_change_is_told() -> None:
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        trials = [expected(rng, gain=-0.14) for _ in range(2)]
        found.append(explain(trials, SURE, SCATTER, LEVEL))
    gains = [one.log_gain for one in found if one.kind == THRUST]
    assert len(gains) >= 28 and np.mean(gains) == pytest.approx(-0.13, abs=0.015), "a prior pulls"
    assert np.std(gains) < 0.03 and min(one.chance for one in found) > 1e-3


def test_another_shape_and_nonsense() -> None:
    """Another drag and delay; speeds that no fish has are explained by nothing."""
    other = model_of(vector_of(MODEL) + np.array([0.5, 0, 0.0, 0.25, 0, 0, 0, 0]))
    assert shares(2, fish=other)[SHAPE] >= 0.9
    odd = expected(np.random.default_rng(1))
    jumps = np.where(np.arange(BEATS) % 7 < 3, 0.04, -0.04)
    found = explain([Expected(odd.miss_m_s + jumps, odd.by, odd.noise)], SURE, SCATTER, LEVEL)
    assert found.chance < 1e-3
