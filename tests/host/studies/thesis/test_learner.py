"""The C learner against the formulas of the thesis, written down once more in plain numpy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.studies.thesis.learner import Learner, LearnerConfig, LearnerRefused

TRIALS = 7


@dataclass(frozen=True)
class Trial:
    input: np.ndarray  # as the plant got it
    error: np.ndarray
    reached: np.ndarray  # of bool


def ahead(config: LearnerConfig, values: np.ndarray) -> np.ndarray:
    """values[k + lead]; beyond the end the tail's."""
    at = np.arange(config.samples) + int(config.lead)
    inside = at < config.samples
    taken = values[np.minimum(at, config.samples - 1)]
    return taken if config.tail == "error" else np.where(inside, taken, 0.0)


def p_part(config: LearnerConfig, trial: Trial) -> np.ndarray:
    return ahead(config, np.where(trial.reached, trial.error, 0.0))


def d_part(config: LearnerConfig, trial: Trial) -> np.ndarray:
    if config.samples == 1:
        return np.zeros(1)
    both = trial.reached[1:] & trial.reached[:-1]
    slopes = np.where(both, trial.error[1:] - trial.error[:-1], 0.0) / config.step
    return ahead(config, np.append(slopes, slopes[-1]))


def finished(config: LearnerConfig, total: np.ndarray, old: np.ndarray) -> np.ndarray:
    """Tail and zero-phase filter."""
    lead = int(config.lead)
    if lead and config.tail in ("hold-new", "hold-old"):
        source = total if config.tail == "hold-new" else old
        total = np.append(total[:-lead], np.full(lead, source[-lead - 1]))
    q = config.q_len
    triangle = q - np.abs(np.arange(1 - q, q))
    middle = slice(q - 1, q - 1 + config.samples)
    weighted = np.convolve(total, triangle)[middle]
    return np.clip(
        weighted / np.convolve(np.ones(config.samples), triangle)[middle], config.low, config.high
    )


def average(config: LearnerConfig, past: list[Trial]) -> np.ndarray:
    """(2.10), from its sums."""
    i = len(past) - 1
    inputs = sum(trial.input for trial in past)
    errors = sum(p_part(config, trial) for trial in past)
    return inputs / (i + 1) + (i + 2) / (i + 1) * config.kp * errors


def windowed(config: LearnerConfig, past: list[Trial]) -> np.ndarray:
    """(2.35), (3.12), (3.43): newest first; before the first trial as ``history`` has it."""
    weights = np.array(config.weights)
    trials = past[::-1][: len(weights)]
    if config.history == "none":
        whole = weights.sum(axis=0)
        weights = weights[: len(trials)]
        part = weights.sum(axis=0)
        weights = weights / part * np.array([1.0, whole[1], whole[2]])
    elif len(trials) < len(weights):
        before = past[0].input if config.history == "first" else np.zeros(config.samples)
        nothing = Trial(before, np.zeros(config.samples), np.zeros(config.samples, bool))
        trials = trials + [nothing] * (len(weights) - len(trials))
    return sum(
        alpha * trial.input
        + kp * config.kp * p_part(config, trial)
        + kd * config.kd * d_part(config, trial)
        for (alpha, kp, kd), trial in zip(weights, trials, strict=True)
    )


def expected_next(config: LearnerConfig, past: list[Trial]) -> np.ndarray:
    last = past[-1]
    if config.past == "mean":
        total = average(config, past)
    elif config.past == "window":
        total = windowed(config, past)
    else:  # (2.3), (8.16), (7.10)
        total = last.input + config.kp * p_part(config, last) + config.kd * d_part(config, last)
    return finished(config, total, last.input)


@st.composite
def configs(draw: st.DrawFn) -> LearnerConfig:
    samples = draw(st.integers(1, 30))
    past = draw(st.sampled_from(["last", "mean", "window"]))
    gain = st.floats(0.05, 2.0)
    window = draw(st.integers(1, 16)) if past == "window" else 0
    low, high = draw(st.sampled_from([(-1e3, 1e3), (0.0, 0.8), (-0.5, 0.5)]))
    return LearnerConfig(
        samples=samples,
        step=draw(st.floats(0.01, 2.0)),
        kp=draw(gain) * draw(st.sampled_from([-1, 1])),
        kd=0.0 if past == "mean" else draw(st.sampled_from([0.0, 0.3, -1.1])),
        lead=draw(st.integers(0, min(3, samples - 1))),
        q_len=draw(st.integers(1, min(5, (samples + 1) // 2))),
        tail=draw(st.sampled_from(["keep", "error", "hold-new", "hold-old"])),
        low=low,
        high=high,
        past=past,
        history=draw(st.sampled_from(["zero", "first", "none"])),
        weights=[(draw(gain), draw(gain), draw(gain)) for _ in range(window)],
    )


def check(config: LearnerConfig, seed: int, precision: str, tolerance: float) -> None:
    """Random errors, lengths and holes; the first trial reaches everything."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(-1.0, 1.0, config.samples)
    learner = Learner(config, first, precision)  # type: ignore[arg-type]
    past: list[Trial] = []
    wanted = np.clip(first, config.low, config.high)
    for i in range(TRIALS):
        got = learner.input()
        scale = max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(got, wanted, rtol=0, atol=tolerance * scale)
        error = rng.normal(0.0, 0.3, config.samples)
        valid = int(rng.integers(0, config.samples + 1)) if i else config.samples
        reached = (rng.random(config.samples) < 0.9) & (np.arange(config.samples) < valid)
        learner.learn(
            np.where(reached | (np.arange(config.samples) >= valid), error, np.nan), valid
        )
        past.append(Trial(got, error, reached))
        wanted = expected_next(config, past)


@settings(max_examples=120, deadline=None, derandomize=True)
@given(config=configs(), seed=st.integers(0, 2**31))
def test_every_law_is_its_formula(config: LearnerConfig, seed: int) -> None:
    check(config, seed, "double", 1e-11)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(config=configs(), seed=st.integers(0, 2**31))
def test_in_the_boards_float_too(config: LearnerConfig, seed: int) -> None:
    check(config, seed, "float", 1e-4 / min(1.0, config.step))


def pd(m: int) -> LearnerConfig:
    weights = [(1 / (m + 1), 1.0 if j == 0 else 0.0, 0.2) for j in range(m + 1)]
    return LearnerConfig(41, step=0.05, kp=1.0, kd=1.0, past="window", weights=weights)


NAMED = {
    "P (2.3)": LearnerConfig(41, kp=0.5, lead=1),
    "average (2.10)": LearnerConfig(41, kp=0.5, lead=1, past="mean"),
    "m-th order (2.35)": LearnerConfig(
        41, kp=1.0, lead=1, past="window", weights=[(0.6, 0.3, 0), (0.3, 0.2, 0), (0.1, 0.1, 0)]
    ),
    "moving average D (3.12)": replace(pd(4), kp=0.0),
    "moving average PD (3.43)": pd(2),
    "anticipatory D (7.10)": LearnerConfig(41, kd=0.4, lead=3, tail="hold-old"),
    "D with Q (6.31)": LearnerConfig(41, kd=0.4, q_len=6),
}


@pytest.mark.parametrize("law", NAMED)
def test_the_named_laws(law: str) -> None:
    for seed in range(20):
        check(NAMED[law], seed, "double", 1e-12)


def test_a_law_that_does_not_fit_is_refused() -> None:
    for change in (
        {"lead": 41}, {"q_len": 22}, {"kp": np.nan}, {"step": 0.0}, {"past": "mean", "kd": 1.0},
        {"past": "window"}, {"past": "window", "weights": [(np.inf, 0, 0)]},
    ):  # fmt: skip
        with pytest.raises(LearnerRefused):
            Learner(replace(LearnerConfig(41), **change))


def test_a_refused_trial_leaves_the_learner_as_it_was() -> None:
    learner = Learner(LearnerConfig(3, kp=1.0, past="mean"), [1.0, 2.0, 3.0])
    with pytest.raises(LearnerRefused):
        learner.learn([1e300, 0.0, 0.0])
    np.testing.assert_array_equal(learner.input(), [1.0, 2.0, 3.0])
    learner.learn([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(learner.input(), [3.0, 2.0, 3.0])
