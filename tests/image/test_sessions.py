"""Whole learning sessions on the flash image, through the serial ports, bit for bit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tailbeat import laws, reference
from tailbeat.demo import compare, same_bits
from tailbeat.fish import Fish
from tailbeat.trial_log import read_trial

TRIALS = 6
SEED = 3
SIGMA_M_S = 0.001


def prepare(fish: Fish, source: int) -> None:
    wanted = {
        "AMP_MAX_RAD": math.pi / 4, "DU_MAX_RAD": 0.0, "LAW_GAIN": 4.0, "LAW_LEAD": 1.0,
        "SPD_SOURCE": float(source),
    }  # fmt: skip
    for name, value in wanted.items():
        fish.params.set(name, value)
    fish.upload_reference(reference.thesis().record())


def learn_from_true_speeds(fish: Fish) -> list[np.ndarray]:
    """Amplitudes after each trial, learned from the speeds the fish really had."""
    prepare(fish, source=1)
    learned = []
    for _ in range(TRIALS):
        outcome = fish.run_trial()
        assert outcome.end == "complete"
        assert fish.sim is not None
        beats = fish.sim.true_beats()[: reference.thesis().beats]
        fish.upload_speeds(outcome.number, beats, SIGMA_M_S)
        fish.learn(outcome.number)
        learned.append(fish.amplitudes().values)
    return learned


def test_uploaded_speeds_teach_the_image_what_they_teach_the_simulated_board() -> None:
    with Fish.connect("sim:tank", seed=SEED) as fish:
        simulated = learn_from_true_speeds(fish)
    with Fish.connect("vboard", seed=SEED) as fish:
        assert fish.info().board == "emulated"
        emulated = learn_from_true_speeds(fish)
        health = fish.health()
    assert [same_bits(a, b) for a, b in zip(simulated, emulated, strict=True)] == [True] * TRIALS
    assert not same_bits(emulated[-2], emulated[-1])
    assert health["late_ticks"] == health["serial_overruns"] == health["store_failures"] == 0


def test_seen_speeds_teach_it_what_the_host_computes_from_the_log(tmp_path: Path) -> None:
    wanted = reference.thesis()
    with Fish.connect("vboard", seed=SEED) as fish:
        prepare(fish, source=0)
        params = {name: p.value for name, p in fish.params.list().items()}
        law = laws.Law.from_params(params, wanted.beat_s)
        errors = []
        for _ in range(TRIALS):
            outcome = fish.run_trial()
            assert outcome.end == "complete"
            trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
            assert not trial.problems
            report = fish.learn(outcome.number)
            compare(trial, law, fish.amplitudes().values, report.rolled_back)
            errors.append(report.max_abs_error_m_s)
        assert fish.health()["late_ticks"] == 0
    print("max|e| mm/s:", " ".join(f"{e * 1000:.1f}" for e in errors))
    assert errors[-1] < 0.25 * errors[0] < 0.1
