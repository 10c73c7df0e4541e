"""Many fish side by side against the simulator they stand for, one whole board at a time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import thesis
from tailbeat.sensors.camera.tracking.live import BeatFit
from tailbeat.session.trial import run_trial
from tailbeat.sim.world import Wires
from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch

Array = F64

BEATS = 12
QUIET = {"gain_sigma": 0, "flow_sigma_m_s": 0, "start_sigma_m_s": 0, "camera_noise_m": 0}


def learned(fish: int, beats: int = BEATS, seed: int = 1) -> Array:
    """Amplitudes of a slow rise, each fish's a bit different."""
    rng = np.random.default_rng(seed)
    rise = np.clip(np.arange(beats) / 6, 0, 1)
    noise: Array = rng.uniform(-0.02, 0.02, (fish, beats))
    return 0.22 + 0.33 * rise + noise


def same(one: BatchTrials, other: BatchTrials) -> bool:
    return (
        one.true_m_s.tobytes() == other.true_m_s.tobytes()
        and one.speed_m_s.tobytes() == other.speed_m_s.tobytes()
        and one.sigma_m_s.tobytes() == other.sigma_m_s.tobytes()
    )


@pytest.mark.parametrize("seed", [3, 4])
def test_true_beats_of_the_whole_simulator(seed: int) -> None:
    batch = FishBatch("tank", [{"seed": seed}])
    with Fish.connect("sim:tank", seed=seed) as fish:
        assert fish.sim is not None
        fish.params.set("DU_MAX_RAD", 0)
        fish.upload_reference(thesis().record())
        for number in (1, 2):
            outcome = run_trial(fish)
            done = np.array([[beat.amplitude_rad for beat in outcome.beats]])
            recorded = batch.run(done, number)
            np.testing.assert_allclose(
                recorded.true_m_s[0],
                fish.sim.world.true_beats(),
                rtol=0,
                atol=5e-5,
                err_msg=str(number),
            )
            if number == 1:
                fish.learn()


def world_speeds(seed: int, amplitude: Array, **others: float) -> Array:
    """Per beat what BeatFit makes of the pictures of a swim in the simulated world, NaN = nothing;
    no board: the pulses of a sine go straight to the tail."""
    world = Wires("tank", seed, imu_firmware=0, **others)
    world.rest(420_000)
    begin_us = 440_000  # with a picture's period, so that the first comes 0.33 of one later
    per_us = int(lib.NATIVE_SERVO_TICKS_PER_US)
    frames = 50 * len(amplitude)
    fit, speeds = BeatFit(), np.full(len(amplitude), np.nan)
    for frame in range(frames + 10):
        angle = amplitude[min(frame, frames - 1) // 50] * math.sin(math.tau * frame / 50)
        ticks = round((1500 + 572.9578 * angle) * per_us)
        world.frame(begin_us + 20_000 * frame, ticks if frame < frames else 0)
        for picture in world.camera_read(world.time_us):
            sample = fit.add(picture.time_s, picture.x_m)
            beat, rest = divmod(picture.time_s - begin_us * 1e-6, 1)
            if sample is not None and beat >= 1 and rest < 0.04:
                speeds[int(beat) - 1] = sample.speed_m_s
    return speeds


@pytest.mark.parametrize("lost", [0.0, 0.15])
def test_measured_as_beatfit_does(lost: float) -> None:
    others = {"camera_noise_m": 0.002, "camera_lost": lost}
    amplitude = learned(3, beats=20)
    recorded = FishBatch("tank", [{"seed": seed, **others} for seed in (1, 2, 3)]).run(amplitude, 1)
    fitted = np.array([world_speeds(i + 1, amplitude[i], **others) for i in range(3)])
    both = np.isfinite(fitted)  # BeatFit wants the pictures at both ends, too
    assert both.mean() > (0.6 if lost else 0.99)
    assert np.isfinite(recorded.speed_m_s[both]).all()
    np.testing.assert_allclose(recorded.speed_m_s[both], fitted[both], rtol=0, atol=1e-4)


def test_sigma_says_how_far_off_a_speed_is() -> None:
    fish = [{**QUIET, "camera_noise_m": 0.005, "seed": seed} for seed in range(200)]
    recorded = FishBatch("tank", fish).run(np.repeat(learned(1), 200, axis=0), 1)
    error = recorded.speed_m_s - recorded.true_m_s
    spread = error.std(axis=0).mean()
    times = (np.arange(26) - 12.5) / 25
    assert spread == pytest.approx(0.005 / np.sqrt(times @ times), rel=0.05)
    assert recorded.sigma_m_s.mean() == pytest.approx(spread, rel=0.05)
    assert abs(error.mean()) < 3e-4


def test_learned_beats_are_measured_without_bias() -> None:
    batch = FishBatch("tank", [{**QUIET, "kappa_per_m": kappa} for kappa in (5, 10, 20)])
    wanted = thesis().speed_m_s.astype(np.float64)
    amplitude = np.clip(0.197 + wanted / 0.219, 0, math.pi / 4)
    recorded = batch.run(np.repeat(amplitude[None, :], 3, axis=0), 1)
    assert np.abs(recorded.speed_m_s - recorded.true_m_s).max() < 4e-4


def test_seed_and_number_key_the_noise() -> None:
    amplitude = learned(2)
    first = FishBatch("tank", [{"seed": 1}, {"seed": 2}])
    again = first.run(amplitude, 1)
    assert same(again, FishBatch("tank", [{"seed": 1}, {"seed": 2}]).run(amplitude, 1))
    assert not same(again, first.run(amplitude, 2))
    each = first.run(amplitude, np.array([1, 2], dtype=np.uint32))
    assert each.true_m_s[0].tobytes() == again.true_m_s[0].tobytes()
    assert each.true_m_s[1].tobytes() == first.run(amplitude, 2).true_m_s[1].tobytes()


def test_a_fish_does_not_feel_its_neighbours() -> None:
    rng = np.random.default_rng(5)
    fish = [
        {"seed": seed, "kappa_per_m": rng.uniform(3, 25), "delay_s": rng.uniform(0, 0.6)}
        for seed in range(37)
    ]
    amplitude = learned(37)
    together = FishBatch("tank", fish).run(amplitude, 3)
    for i in (0, 20, 36):
        alone = FishBatch("tank", [fish[i]]).run(amplitude[i : i + 1], 3)
        assert alone.true_m_s[0].tobytes() == together.true_m_s[i].tobytes()
        assert alone.speed_m_s[0].tobytes() == together.speed_m_s[i].tobytes()
        assert alone.sigma_m_s[0].tobytes() == together.sigma_m_s[i].tobytes()


@pytest.mark.parametrize("plant", ["tank", "thesis"])
def test_quiet_fish_swim_as_the_plant_alone(plant: str) -> None:
    batch = FishBatch(plant, [QUIET, {**QUIET, "map_bend_m_s_rad2": 0.1}])
    amplitude = learned(2)
    recorded = batch.run(amplitude, 1)
    for i in range(2):
        alone = np.empty(BEATS)
        row = np.ascontiguousarray(amplitude[i])
        assert lib.sim_plant_beats(
            batch.config(i),
            ffi.from_buffer("double[]", row),
            BEATS,
            1.0,
            ffi.from_buffer("double[]", alone),
        )
        np.testing.assert_allclose(
            recorded.true_m_s[i], alone, rtol=0, atol=0 if plant == "tank" else 1e-9
        )
    bend_felt = not np.array_equal(
        batch.run(amplitude[:1].repeat(2, 0), 1).true_m_s[0],
        batch.run(amplitude[:1].repeat(2, 0), 1).true_m_s[1],
    )
    assert bend_felt == (plant == "tank")


def test_what_makes_no_sense_is_refused() -> None:
    for plant, settings in (
        ("pond", {}),
        ("tank", {"colour": 1.0}),
        ("tank", {"kappa_per_m": -1.0}),
        ("tank", {"map_bend_m_s_rad2": 1e9}),
        ("tank", {"seed": 0.5}),
    ):
        with pytest.raises(InputError):
            FishBatch(plant, [settings])
    batch = FishBatch("tank", [{}, {}])
    for amplitude, beat_s in (
        (learned(3), 1.0),
        (learned(2)[0], 1.0),
        (learned(2), 0.99),
        (np.full((2, 3), np.nan), 1.0),
    ):
        with pytest.raises(InputError):
            batch.run(amplitude, 1, beat_s)


def test_no_fish_is_a_batch_too() -> None:
    assert FishBatch("tank", []).run(np.empty((0, BEATS)), 1).true_m_s.shape == (0, BEATS)
