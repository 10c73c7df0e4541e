"""Whole learning sessions on the flash image, through the serial ports, bit for bit. One along the
thesis's profile is in tests/system/test_vboard.py."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import compare, same_bits
from tailbeat.board.fish import Fish
from tailbeat.core import law as laws
from tailbeat.core import records
from tailbeat.core.errors import Refused
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import read_trial
from tailbeat.session.next_input import dry_run
from tailbeat.session.trial import run_trial

TRIALS = 3
BEATS, BEAT_S = 6, 1.0
SPEED_M_S = 0.07 * np.sin(np.linspace(0.2, 2.9, BEATS)).astype(np.float32)
SEED = 3
SIGMA_M_S = 0.001
VISION, UPLOAD, IMU, MODEL = range(4)
WINDOW = 2  # ILC_KIND
TAPER = 2  # ILC_EXTRAP
REST_S = 3.0


def prepare(fish: Fish, source: int, beats: int = BEATS) -> None:
    wanted = {
        "AMP_MAX_RAD": math.pi / 4, "DU_MAX_RAD": 0.0, "ILC_GAIN": 4.0, "ILC_LEAD": 1.0,
        "SPD_SOURCE": float(source), "REST_MIN_S": REST_S, "SETTLE_S": 2.0,
    }  # fmt: skip
    for name, value in wanted.items():
        fish.params.set(name, value)
    fish.upload_reference(records.encode_reference(BEAT_S, SPEED_M_S[:beats]))


def law_of(fish: Fish) -> laws.Law:
    return laws.Law.from_params(fish.params.values(), BEAT_S)


def learn_from_true_speeds(fish: Fish) -> list[np.ndarray]:
    """Amplitudes after each trial, learned from the speeds the fish really had."""
    prepare(fish, UPLOAD)
    learned = []
    for _ in range(TRIALS):
        outcome = run_trial(fish)
        assert outcome.end == "complete"
        assert fish.sim is not None
        fish.upload_speeds(outcome.number, fish.sim.world.true_beats()[:BEATS], SIGMA_M_S)
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
    with Fish.connect("vboard", seed=SEED) as fish:
        prepare(fish, VISION)
        law = law_of(fish)
        errors = []
        for _ in range(TRIALS):
            outcome = run_trial(fish)
            assert outcome.end == "complete"
            trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
            assert not trial.problems
            report = fish.learn(outcome.number)
            compare(trial, law, fish.amplitudes().values, report.rolled_back)
            errors.append(report.max_abs_error_m_s)
        assert fish.health()["late_ticks"] == 0
    print("max|e| mm/s:", " ".join(f"{e * 1000:.1f}" for e in errors))
    assert errors[-1] < 0.25 * errors[0] < 0.1


def test_a_moving_average_on_the_image_is_what_the_dry_run_foretells() -> None:
    beats = 3
    with Fish.connect("vboard", seed=SEED) as fish:
        prepare(fish, UPLOAD, beats)
        for name, value in {"ILC_KIND": WINDOW, "ILC_WINDOW": 2, "ILC_KD": 0.2}.items():
            fish.params.set(name, value)
        for averaged in (1, 2):
            outcome = run_trial(fish)
            assert fish.sim is not None
            fish.upload_speeds(outcome.number, fish.sim.world.true_beats()[:beats], SIGMA_M_S)
            foretold = dry_run(fish)
            fish.learn(outcome.number)
            assert same_bits(foretold.amplitude_rad, fish.amplitudes().values)
            record = fish.past_record(records.past_path(fish.status().iteration - 1))
            assert record is not None
            assert records.decode_past(record).trials == averaged
        health = fish.health()
    assert health["late_ticks"] == health["store_failures"] == 0


def test_what_is_felt_needs_an_imu() -> None:
    """Nothing is counted or stored without."""
    with Fish.connect("vboard", seed=SEED) as fish:
        assert fish.sim is not None
        number = fish.status().next_trial
        fish.sim.world.set_imu(False)
        while fish.imu_info().state == "streaming":
            fish.link.run(0.1)
        for source in (IMU, MODEL):
            prepare(fish, source)
            with pytest.raises(Refused) as refused:
                run_trial(fish)
            assert (refused.value.number, refused.value.name) == (59, "NO_IMU")
            fish.disarm()
            assert (fish.status().next_trial, fish.trials()) == (number, [])


@pytest.mark.parametrize("source", [IMU, MODEL], ids=["imu", "model"])
def test_felt_speeds_teach_it_what_the_host_computes_from_the_log(
    source: int, tmp_path: Path
) -> None:
    beats = 3
    with Fish.connect("vboard", seed=SEED) as fish:
        assert fish.sim is not None
        assert fish.imu_verdict().state == "streaming"
        prepare(fish, source, beats)
        begin_s = fish.sim.time_s
        outcome = run_trial(fish)
        took_s = fish.sim.time_s - begin_s
        assert outcome.end == "complete"
        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
        assert not trial.problems
        true = fish.sim.world.true_beats()[:beats]
        report = fish.learn(outcome.number)
        compare(trial, law_of(fish), fish.amplitudes().values, report.rolled_back)
        health = fish.health()
    speed, sigma = recompute_beats(trial)
    assert same_bits(sigma, trial.beats.sigma_m_s)
    told = np.array([beat.speed_m_s for beat in outcome.beats], dtype=np.float32)
    assert same_bits(told, trial.beats.speed_m_s)
    error = speed - true
    print(f"took {took_s:.0f} s; error mm/s: {error * 1e3}, sigma {sigma * 1e3}")
    print(f"longest pause {int(health['longest_pause_us']) / 1000:.0f} ms")
    assert report.measured_beats == beats
    assert np.all(np.abs(error) < 4 * sigma)
    assert (trial.rest_after is not None and trial.rest_after.still_s > 0) == (source == IMU)
    assert int(health["longest_pause_us"]) <= 100_000
    assert health["late_ticks"] == health["serial_overruns"] == health["store_failures"] == 0


def test_a_beat_too_far_off_stops_the_tail_and_is_learned_from(tmp_path: Path) -> None:
    limit_m_s = 0.02
    with Fish.connect("vboard", seed=SEED) as fish:
        prepare(fish, VISION)
        fish.params.set("ERR_MAX_M_S", limit_m_s)
        fish.params.set("ILC_EXTRAP", TAPER)
        outcome = run_trial(fish)
        assert outcome.end == "aborted:ERROR_LIMIT"
        assert fish.status().fault.name == "ERROR_LIMIT"
        fish.clear()
        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
        guilty = int(np.argmax(np.abs(trial.beats.error_m_s) > limit_m_s))
        assert guilty + 3 == trial.executed_beats == outcome.executed_beats < BEATS
        expected = dry_run(fish)
        assert fish.learn(outcome.number).measured_beats == trial.executed_beats
        assert same_bits(fish.amplitudes().values, expected.amplitude_rad)
        visits = fish.visits()
        assert visits is not None
        corrected = trial.executed_beats - 1  # the lead
        assert visits.tolist() == [1] * corrected + [0] * (BEATS - corrected)
        assert fish.health()["late_ticks"] == 0
