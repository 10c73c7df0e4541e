"""Speed from positions: against the simulator's truth, and against a dense Gaussian regression."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference, thesis
from tailbeat.core.speed_source import Frame
from tailbeat.sensors.camera import smoother
from tailbeat.sensors.camera import speed as speed_module
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.sensors.camera.speed import (
    COLUMNS,
    SpeedCurve,
    swim_direction_rad,
    swim_speed,
    write_speeds,
)
from tailbeat.sensors.camera.tracking.track import LOST, SEEN, Track
from tailbeat.session.trial import run_trial

SEEDS = range(1, 3)
STEP_SEEDS = range(1, 5)


def track_of(t_s, x_m, y_m=None, fps=25.0):
    count = len(t_s)
    y_m = np.zeros(count) if y_m is None else y_m
    state = np.full(count, SEEN, dtype=np.uint8)
    return Track(np.asarray(t_s), x_m, y_m, np.zeros(count), np.ones(count), state, fps)


class Watcher(SimulatedCamera):
    """Keeps what it has seen."""

    def __init__(self, board) -> None:
        super().__init__(board)
        self.seen: list[Frame] = []

    def frames(self) -> list[Frame]:
        found = super().frames()
        self.seen += found
        return found


def recorded(seed: int, fps: float, lost: float, amplitudes=None):
    """A trial's track, its true beats, and when it began."""
    url = f"sim:tank?seed={seed}"
    with Fish.connect(url, camera_fps=fps, camera_lost=lost) as fish:
        fish.upload_reference(thesis())
        fish.params.set("AMP_MAX_RAD", np.pi / 4)
        if amplitudes is not None:
            fish.params.set("DU_MAX_RAD", 0)
            wanted = np.full(len(amplitudes), 0.05, dtype=np.float32)
            fish.upload_reference(Reference(1.0, wanted, "steps"))
            fish.upload_amplitudes(amplitudes)
        camera = Watcher(fish.sim)
        boot_s = fish.sim.time_s - fish.sim.board_time_s
        begun = []
        fish.link.subscribe(
            lambda m: (
                begun.append(m.time_boot_ms * 1e-3)
                if m.get_type() == "TAILBEAT_STATUS" and m.state == 4
                else None
            )
        )
        run_trial(fish, camera)
        frames, beats = camera.seen, np.array(fish.sim.world.true_beats())
        start_s = _start_s(fish, boot_s)
    columns = np.array([(f.t_s, f.x_m, f.y_m) for f in frames]).T
    return track_of(*columns, fps=fps), beats, start_s


def _start_s(fish: Fish, boot_s: float) -> float:
    from tempfile import TemporaryDirectory

    from tailbeat.core.trial_file import read_trial

    with TemporaryDirectory() as folder:
        trial = read_trial(fish.pull_trial(fish.trials()[-1].number, Path(folder)))
    return trial.start_us * 1e-6 + boot_s


@pytest.mark.parametrize(("fps", "lost"), [(25.0, 0.0), (25.0, 0.1), (60.0, 0.1)])
def test_speeds_of_simulated_swims_are_right_and_know_how_right(fps: float, lost: float) -> None:
    errors, sigmas, noises = [], [], []
    for seed in SEEDS:
        track, beats, start_s = recorded(seed, fps, lost)
        curve = swim_speed(track, 1.0, start_s, 0.0, beats=len(beats))
        speed, sigma = curve.beats(len(beats))
        errors.append(speed - beats)
        sigmas.append(sigma)
        noises.append(curve.noise_m)
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    known = np.isfinite(error)
    rms, bias = np.sqrt(np.mean(error[known] ** 2)), error[known].mean()
    inside = np.mean(np.abs(error[known]) < 2 * sigma[known])
    print(f"seeds {SEEDS}, {fps} fps: RMS {rms:.6f}, bias {bias:.6f}, in 2 sigma {inside:.3f}")
    assert np.mean(known) > 0.97
    assert rms < 0.3e-3
    assert abs(bias) < 0.05e-3
    assert inside > 0.93
    assert sigma[known].max() < 0.5e-3
    assert np.mean((error[known] / sigma[known]) ** 2) > 0.3  # nor is it too careful
    assert np.mean(noises) == pytest.approx(1e-3, rel=0.05)


def test_a_swim_in_steps_has_larger_errors_and_says_so() -> None:
    """Beside a step of the amplitude the speed bends within a third of a beat, faster than the
    smoother lets it: the beats there are up to 1.7 mm/s off, always to the same side."""
    amplitudes = np.repeat([0.3, 0.75, 0.2], 7)
    errors, sigmas = [], []
    for seed in STEP_SEEDS:
        track, beats, start_s = recorded(seed, 25.0, 0.1, amplitudes)
        speed, sigma = swim_speed(track, 1.0, start_s, 0.0, beats=len(beats)).beats(len(beats))
        errors.append(speed - beats)
        sigmas.append(sigma)
    error, sigma = np.array(errors), np.array(sigmas)
    known = np.isfinite(error)
    rms, bias = np.sqrt(np.mean(error[known] ** 2)), np.nanmean(error, axis=0)
    inside = np.mean(np.abs(error[known]) < 2 * sigma[known])
    print(f"seeds {STEP_SEEDS}: RMS {rms:.6f}, bias {bias.min():.6f}..{bias.max():.6f}")
    print(f"in 2 sigma {inside:.3f}, sigma {np.mean(sigma[known]):.6f}")
    assert rms < 0.75e-3
    assert np.abs(bias).max() < 1.8e-3
    assert abs(np.mean(bias)) < 0.1e-3  # all of the way is there
    assert inside >= 0.9
    assert sigma[known].max() < 1e-3


def models(*fields):
    """Of the smoother: jerk, ripple and second of each; the same drift for all."""
    drift = np.full(len(fields[0]), 0.3), np.full(len(fields[0]), 0.2)
    return smoother.Models(*map(np.array, fields), *drift)


def dense(t_s, way, beat_s, by, ends):
    """Way between two moments and its variance, by plain Gaussian conditioning on everything."""
    mean, cov = smoother.prior(beat_s, by, float(way[np.isfinite(way)][0]))
    moves, noises = smoother.steps(np.diff(t_s), beat_s, by)
    count, n = len(t_s), smoother.STATES
    means, blocks = [mean[0]], [[cov[0]]]
    for k in range(1, count):
        step, noise = moves[k - 1, 0], noises[k - 1, 0]
        blocks.append([step @ block for block in blocks[-1]])
        blocks[k].append(step @ blocks[k - 1][k - 1] @ step.T + noise)
        means.append(step @ means[-1])
    joint = np.zeros((count * n, count * n))
    for i in range(count):
        for j in range(i + 1):
            joint[i * n : i * n + n, j * n : j * n + n] = blocks[i][j]
            joint[j * n : j * n + n, i * n : i * n + n] = blocks[i][j].T
    seen = np.flatnonzero(np.isfinite(way))
    rows = np.zeros((len(seen) + 1, count * n))
    for row, k in enumerate(seen):
        rows[row, k * n : k * n + n] = smoother.SEEN_AS
    rows[-1, ends[1] * n : ends[1] * n + n] += smoother.WAY_AS
    rows[-1, ends[0] * n : ends[0] * n + n] -= smoother.WAY_AS
    all_cov = rows @ joint @ rows.T
    all_mean = rows @ np.concatenate(means)
    data = all_cov[:-1, :-1] + np.eye(len(seen))
    weights = np.linalg.solve(data, all_cov[:-1, -1])
    value = all_mean[-1] + weights @ (way[seen] - all_mean[:-1])
    return value, all_cov[-1, -1] - weights @ all_cov[:-1, -1]


def test_the_smoother_gives_what_plain_gaussian_conditioning_gives(monkeypatch) -> None:
    # A vague prior costs the dense way its digits.
    monkeypatch.setattr(smoother, "_WAY_SPREAD", 1e2)
    monkeypatch.setattr(smoother, "_SPEED_SPREAD", 1e2)
    monkeypatch.setattr(smoother, "_RISE_SPREAD", 1e1)
    random = np.random.default_rng(5)
    t_s = np.sort(np.concatenate([np.arange(45) * 0.05, random.uniform(0, 2.2, 12)]))
    t_s = np.round(t_s, 6)
    way = 30 * t_s + np.sin(2 * np.pi * t_s) + random.normal(size=len(t_s))
    way[::7] = np.nan
    by = models([20.0], [0.8], [0.4])
    smoothed = smoother.smooth(smoother.forward(t_s, way, 1.0, by, keep=True))
    on_grid = np.arange(0, len(t_s), 4)
    speed, sigma = speed_module._mean_speeds(smoothed, on_grid, 1.0)
    for at in range(len(speed)):
        ends = on_grid[at], on_grid[at + speed_module.STEPS_PER_BEAT]
        value, variance = dense(t_s, way, 1.0, by, ends)
        assert speed[at] == pytest.approx(value, rel=1e-6)
        assert sigma[at] ** 2 == pytest.approx(variance, rel=1e-4)


def test_the_likelihood_is_that_of_the_innovations() -> None:
    columns = np.array([[5.0, 50.0], [0.5, 2.0], [0.1, 1.0]])
    t_s = np.arange(60) * 0.04
    way = np.random.default_rng(2).normal(size=60)
    both = smoother.forward(t_s, way, 1.0, models(*columns), keep=False)
    for k in range(2):
        alone = smoother.forward(t_s, way, 1.0, models(*columns[:, k : k + 1]), keep=True)
        predicted, covariance, _, _ = alone.nodes
        missed = way - predicted @ smoother.SEEN_AS
        variance = smoother.SEEN_AS @ covariance @ smoother.SEEN_AS + 1
        assert both.chi2[k] == pytest.approx(np.sum((missed**2 / variance)[1:]))
        assert both.log_variance[k] == pytest.approx(alone.log_variance[0])
    assert both.count == 59


def test_states_are_stationary_where_the_model_says_so() -> None:
    """The sizes in the model are the standard deviations after any number of steps."""
    by = models([5.0], [0.5], [0.2])
    moves, noises = smoother.steps(np.array([0.04]), 1.0, by)
    _, cov = smoother.prior(1.0, by, 0.0)
    after = moves[0] @ cov @ moves[0].transpose(0, 2, 1) + noises[0]
    np.testing.assert_allclose(after[:, 3:, 3:], cov[:, 3:, 3:], atol=1e-12)


def steady(seconds: float, fps: float, seed: int = 3):
    """A fish at 60 mm/s with ripple, 1 mm of noise."""
    random = np.random.default_rng(seed)
    t_s = np.arange(round(seconds * fps)) / fps
    x_m = 0.06 * t_s + 4e-4 * np.sin(4 * np.pi * t_s + 1.0) + random.normal(0, 1e-3, len(t_s))
    return t_s, x_m


def test_wrong_positions_are_not_believed() -> None:
    t_s, x_m = steady(20, 25)
    wrong = [60, 150, 151, 333]
    x_m[wrong] += np.array([0.025, -0.02, 0.02, 0.015])
    curve = swim_speed(track_of(t_s, x_m), 1.0)
    assert curve.outliers == len(wrong)
    assert np.abs(curve.v_m_s - 0.06).max() < 1e-3
    assert curve.noise_m == pytest.approx(1e-3, rel=0.25)


@pytest.mark.parametrize(("missing", "known"), [(5, True), (6, False)])
def test_a_hole_of_more_than_five_pictures_has_no_speed(missing: int, known: bool) -> None:
    t_s, x_m = steady(12, 25)
    keep = np.ones(len(t_s), dtype=bool)
    keep[140 : 140 + missing] = False
    full = swim_speed(track_of(t_s, x_m), 1.0)
    curve = swim_speed(track_of(t_s[keep], x_m[keep]), 1.0)
    hole_s = t_s[140] - 0.04, t_s[139 + missing] + 0.04
    crossing = [t for t in full.t_s if t - 0.5 < hole_s[0] and t + 0.5 > hole_s[1]]
    assert len(crossing) > 3
    assert all((np.abs(curve.t_s - t).min() < 1e-9) == known for t in crossing)
    if known:
        assert (np.abs(curve.v_m_s - 0.06) < 4 * curve.sigma_m_s).all()


def test_too_few_pictures_have_no_speed() -> None:
    t_s, x_m = steady(12, 25)
    keep = (np.arange(len(t_s)) % 6 < 3) | (t_s < 5) | (t_s > 8)  # half there, in threes
    curve = swim_speed(track_of(t_s[keep], x_m[keep]), 1.0)
    assert not np.any((curve.t_s > 5.6) & (curve.t_s < 7.4))
    assert np.any(curve.t_s < 4.5)
    assert np.any(curve.t_s > 8.5)


def test_a_film_whose_rate_halves_is_measured_to_its_end() -> None:
    t_s, x_m = steady(16, 25)
    keep = (t_s < 8) | (np.arange(len(t_s)) % 2 == 0)
    curve = swim_speed(track_of(t_s[keep], x_m[keep]), 1.0)
    speed, sigma = curve.beats(16)
    assert np.isfinite(speed[:15]).all()
    assert (np.abs(speed[:15] - 0.06) < 4 * sigma[:15]).all()


def test_one_picture_is_no_film() -> None:
    one = track_of(np.array([0.0]), np.array([0.1]), fps=0.0)
    with pytest.raises(InputError, match="less than two beats"):
        swim_speed(one, 1.0)


def test_the_swim_direction_is_found_and_followed() -> None:
    t_s, along = steady(20, 25)
    askew = np.radians(12)
    side = 5e-3 * np.sin(2 * np.pi * t_s)  # the body sways with the tail
    x_m = along * np.cos(askew) - side * np.sin(askew)
    y_m = along * np.sin(askew) + side * np.cos(askew)
    track = track_of(t_s, x_m, y_m)
    assert swim_direction_rad(track) == pytest.approx(askew, abs=0.005)
    curve = swim_speed(track, 1.0)
    assert np.mean(curve.v_m_s) == pytest.approx(0.06, abs=1e-4)
    short = track_of(t_s[:60], x_m[:60], y_m[:60])
    assert swim_direction_rad(short) == 0.0


def test_a_fish_that_rests_rests() -> None:
    t_s = np.arange(500) / 25
    x_m = np.random.default_rng(1).normal(0, 1e-3, 500)
    curve = swim_speed(track_of(t_s, x_m), 1.0)
    assert np.abs(curve.v_m_s).max() < 4 * curve.sigma_m_s.max()
    assert curve.sigma_m_s.max() < 1e-3


@pytest.mark.parametrize("v_m_s", [0.0, 0.06])
def test_positions_without_any_noise(v_m_s: float) -> None:
    t_s = np.arange(250) / 25
    curve = swim_speed(track_of(t_s, v_m_s * t_s), 1.0)
    np.testing.assert_allclose(curve.v_m_s, v_m_s, atol=1e-5)
    assert (curve.sigma_m_s > 0).all()
    assert curve.sigma_m_s.max() < 1e-3
    assert curve.noise_m >= 1e-6


def test_a_film_of_frozen_pictures() -> None:
    t_s, x_m = steady(12, 25)
    x_m[100:] = x_m[100]
    curve = swim_speed(track_of(t_s, x_m), 1.0)
    assert np.isfinite(curve.v_m_s).all()
    assert np.abs(curve.v_m_s[curve.t_s > 6]).max() < 1e-3
    assert (curve.sigma_m_s > 0).all()


def test_a_place_that_is_no_number_was_not_seen() -> None:
    t_s, x_m = steady(12, 25)
    without = swim_speed(track_of(np.delete(t_s, 100), np.delete(x_m, 100)), 1.0)
    for wrong in (np.nan, np.inf):
        x_m[100] = wrong
        curve = swim_speed(track_of(t_s, x_m), 1.0)
        np.testing.assert_allclose(curve.v_m_s, without.v_m_s, atol=1e-6)


def test_a_begin_that_is_not_exactly_known_widens_the_error_bars_where_the_speed_changes() -> None:
    t_s = np.arange(40) * 0.1
    v_m_s = np.where(t_s < 2, 0.05, 0.05 + 0.03 * (t_s - 2))
    curve = SpeedCurve(t_s, v_m_s, np.full(40, 2e-4), 1.0, 0.0, 0.0, 1e-3)
    widened = curve.with_begin_sigma(0.01)
    np.testing.assert_allclose(widened.sigma_m_s[:19], 2e-4)
    np.testing.assert_allclose(widened.sigma_m_s[22:], np.hypot(2e-4, 0.03 * 0.01))
    np.testing.assert_array_equal(curve.sigma_m_s, 2e-4)
    np.testing.assert_array_equal(widened.v_m_s, curve.v_m_s)
    single = replace(curve, t_s=t_s[:1], v_m_s=v_m_s[:1], sigma_m_s=np.array([2e-4]))
    assert single.with_begin_sigma(0.01).sigma_m_s[0] == 2e-4


def test_a_fish_that_was_carried_back_swims_two_swims() -> None:
    t_s, x_m = steady(24, 25)
    x_m[t_s > 12] -= 0.7
    curve = swim_speed(track_of(t_s, x_m), 1.0)
    assert np.abs(curve.v_m_s - 0.06).max() < 1.5e-3
    assert not np.any(np.abs(curve.t_s - 12) < 0.4)


def test_beats_have_their_middles() -> None:
    t_s, x_m = steady(10, 25)
    x_m += 0.01 * np.maximum(t_s - 5, 0) ** 2
    curve = swim_speed(track_of(t_s + 100.013, x_m), 1.0, start_s=101.5)
    speed, sigma = curve.beats(9)
    assert np.isfinite(speed[:8]).all()
    assert np.isnan(speed[8])  # beyond the film
    at = 1.487 + np.arange(8)
    truth = [0.06 + 0.01 * (max(t + 1 - 5, 0) ** 2 - max(t - 5, 0) ** 2) for t in at]
    assert np.abs(speed[:8] - truth).max() < 4 * sigma[:8].max()


def test_only_the_swim_counts() -> None:
    t_s, x_m = steady(30, 25)
    rough = np.where(t_s < 8, 0.01 * np.sin(9 * t_s), 0.0)  # somebody handles the fish
    curve = swim_speed(track_of(t_s, x_m + rough), 1.0, start_s=12.0, beats=10)
    assert curve.t_s.min() > 9
    assert curve.t_s.max() < 25
    with pytest.raises(InputError, match="the trial is not in"):
        swim_speed(track_of(t_s, x_m), 1.0, start_s=99.0, beats=10)


def test_too_short_a_film_is_refused() -> None:
    t_s, x_m = steady(1.9, 25)
    with pytest.raises(InputError, match="less than two beats"):
        swim_speed(track_of(t_s, x_m), 1.0)
    lost = track_of(*steady(20, 25))
    lost.state[:] = LOST
    with pytest.raises(InputError, match="less than two beats"):
        swim_speed(lost, 1.0)


def test_the_file_counts_from_the_begin_of_the_swim(tmp_path: Path) -> None:
    curve = SpeedCurve(
        np.array([7.5, 7.6]), np.array([0.05, 0.06]), np.array([1e-3, 2e-3]), 1.0, 7.0, 0.0, 1e-3
    )
    write_speeds(curve, tmp_path / "speed.csv", trial=7)
    rows = list(csv.reader((tmp_path / "speed.csv").open()))
    assert tuple(rows[0]) == COLUMNS
    assert [float(cell) for cell in rows[1]] == [0.5, 0.05, 0.001, 1.0, 7.0]
    write_speeds(curve, tmp_path / "film.csv")
    assert (tmp_path / "film.csv").read_text().splitlines()[1] == "7.5000,0.050000,0.001000,1,"
