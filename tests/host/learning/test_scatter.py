"""How trials scatter: what was put in comes out, and a spoilt trial changes little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.scatter import Scatter, learned, weights_of

BEATS = 40
TRUE = Scatter(0.03, 0.003, 0.004, 0.0012, 0.0, 0.002)
SIGMA = np.full(BEATS, 0.0007)


def residuals(count: int, common: np.ndarray | float = 0.0) -> tuple[list[TrialSpeeds], list]:
    rng = np.random.default_rng(4)
    noise = TRUE.moving(BEATS, 1.0) + np.eye(BEATS) * (0.0007**2 + TRUE.model_m_s**2)
    rows = rng.multivariate_normal(np.zeros(BEATS), noise, count) + common
    trials = [TrialSpeeds(np.full(BEATS, 0.4), row, SIGMA, 1.0, 17) for row in rows]
    return trials, list(rows)


def test_what_was_put_in_comes_out() -> None:
    rng = np.random.default_rng(3)
    count = 200
    own = rng.standard_normal((count, 3)) * [TRUE.start_m_s, TRUE.flow_m_s, TRUE.gain]
    trials, rows = residuals(count)
    found = learned(trials, rows, own, np.zeros((count, 3)), np.ones(count), Scatter())
    got = [found.start_m_s, found.flow_m_s, found.gain, found.moves_m_s, found.model_m_s]
    want = [TRUE.start_m_s, TRUE.flow_m_s, TRUE.gain, TRUE.moves_m_s, TRUE.model_m_s]
    assert got == pytest.approx(want, rel=0.15)


def test_what_comes_again_is_no_scatter() -> None:
    common = 0.01 * np.sin(np.arange(BEATS))
    nothing, ones = np.zeros((20, 3)), np.ones(20)
    plain, again = (
        learned(*residuals(20, one), nothing, nothing, ones, Scatter()) for one in (0.0, common)
    )
    assert again.misfit_m_s == pytest.approx(plain.misfit_m_s, rel=1e-9)
    trials, rows = residuals(20, common)
    others = [replace(trial, reference_crc=0) for trial in trials]
    assert learned(others, rows, nothing, nothing, ones, Scatter()).misfit_m_s > 0.005


def test_a_spoilt_trial_counts_little() -> None:
    usual = Scatter()
    own = np.zeros((4, 2))
    own[1], own[2] = (0.0, -0.2), (0.012, 0.0)
    weights = weights_of(own, np.array([1.0, 1.0, 1.0, 40.0]), usual)
    assert weights[0] == 1.0 and weights[1] < 0.1 and weights[2] < 0.15 and weights[3] == 0.1
    trials, rows = residuals(4)
    start = np.column_stack([np.zeros(4), own])
    found = learned(trials, rows, start, np.zeros((4, 3)), weights, usual)
    believed = learned(trials, rows, start, np.zeros((4, 3)), np.ones(4), usual)
    assert found.gain < 0.035 < 0.06 < believed.gain
