"""Trials that go through a fit together have the bits that each has alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds
from tailbeat.learning.scatter import Scatter, beat_covariance
from tailbeat.learning.slopes import groups_of, speed_and_slopes

MODEL = FishModel(9.0, 0.21, 0.16, 0.28, -0.1, 0.003, 0.12, 0.9)
SCATTER = Scatter()


def trials() -> list[TrialSpeeds]:
    """Of two lengths, some with beats that were not measured, some at another beat."""
    rng = np.random.default_rng(3)
    found = []
    for number in range(12):
        beats = 40 if number % 3 else 17
        amplitude = np.clip(rng.normal(0.4, 0.2, beats), 0.0, 0.785)
        speed = MODEL.beats(amplitude, 1.0) + rng.normal(0, 0.002, beats)
        if number % 4 == 1:
            speed[rng.permutation(beats)[:3]] = np.nan
        sigma = rng.uniform(0.0005, 0.002, beats)
        found.append(TrialSpeeds(amplitude, speed, sigma, 1.0 if number % 5 else 0.8))
    return found


def test_a_group_has_the_bits_of_each_trial_alone() -> None:
    every = trials()
    rng = np.random.default_rng(4)
    weights = rng.uniform(0.1, 1.0, len(every))
    given = [
        Conditions(abs(start), flow, 1 + gain)
        for start, flow, gain in rng.normal(0, (0.003, 0.002, 0.03), (len(every), 3))
    ]
    groups = groups_of(every, MODEL, SCATTER, weights)
    assert sorted(len(group.at) for group in groups) != [1] * len(every)
    assert sorted(at for group in groups for at in group.at) == [*range(len(every))]
    for group in groups:
        rows = group.squares(MODEL, [given[at] for at in group.at])
        for at, cost, pull, both in zip(group.at, *rows, strict=True):
            trial = every[at]
            seen = trial.measured
            noise = beat_covariance(trial, MODEL, SCATTER)[np.ix_(seen, seen)]
            white = np.linalg.inv(np.linalg.cholesky(noise / weights[at]))
            speed, by = speed_and_slopes(MODEL, trial, given[at])
            miss = white @ (speed[seen] - trial.speed_m_s[seen])
            slopes = white @ by[seen]
            assert cost == miss @ miss
            np.testing.assert_array_equal(pull, slopes.T @ miss)
            np.testing.assert_array_equal(both, slopes.T @ slopes)


def test_slopes_are_those_of_the_speeds() -> None:
    trial, given = trials()[1], Conditions(0.004, 0.001, 1.02)
    speed, by = speed_and_slopes(MODEL, trial, given)
    step = 1e-7
    np.testing.assert_array_equal(by[:, 9], 1.0)
    for column, other in (
        (5, (replace(MODEL, linear_drag_m_s=MODEL.linear_drag_m_s + step), given)),
        (8, (MODEL, replace(given, start_m_s=given.start_m_s + step))),
        (10, (MODEL, replace(given, gain=given.gain * np.exp(step)))),
    ):
        moved, _ = speed_and_slopes(other[0], trial, other[1])
        np.testing.assert_allclose((moved - speed) / step, by[:, column], atol=2e-5)
