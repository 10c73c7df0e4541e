"""Speed from the IMU through the whole firmware, as a researcher would swim: errors over seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.arrays import F64
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import BoardText, HoldRequest
from tailbeat.session.trial import run_trial

VISION, _, IMU, MODEL = range(4)
SEEDS = [12, pytest.param(40, marks=pytest.mark.soak)]
REST_S = 9.0  # the IMU is found, and the fish has been still for REST_MIN_S
Floats = F64


@dataclass(frozen=True)
class Swims:
    """Errors of all beats of all seeds, shape (seeds, beats), m/s; NaN = unmeasured."""

    error: Floats
    sigma: Floats

    def text(self) -> str:
        """As the table of docs/explanation/speed.md."""
        in_two = np.nanmean(np.abs(self.error) < 2 * self.sigma)
        return (
            f"beat RMS {1e3 * np.sqrt(np.nanmean(self.error**2)):.2f} mm/s,"
            f" mean sigma {1e3 * np.nanmean(self.sigma):.2f}, in 2 sigma {in_two:.1%},"
            f" (error/sigma)^2 {np.nanmean((self.error / self.sigma) ** 2):.2f},"
            f" mean of a trial {1e3 * self.mean_rms():.2f} mm/s"
        )

    def mean_rms(self) -> float:
        """RMS error of the mean speed of a trial."""
        return float(np.sqrt(np.mean(np.nanmean(self.error, axis=1) ** 2)))

    def assert_honest(self) -> None:
        """Most beats within two sigma, and sigma not inflated."""
        assert np.mean(np.abs(self.error) < 2 * self.sigma) >= 0.9
        assert 0.5 <= np.mean((self.error / self.sigma) ** 2) <= 1.5


def swim(fish: Fish, folder: Path, wanted: reference.Reference, **params: float) -> Trial:
    for name, value in {"DU_MAX_RAD": 0, "AMP_MAX_RAD": 0.785, **params}.items():
        fish.params.set(name, value)
    fish.upload_reference(wanted)
    speed = wanted.speed_m_s
    fish.upload_amplitudes(np.where(speed > 0.002, np.clip(0.197 + speed / 0.219, 0, 0.785), 0))
    fish.link.run(REST_S)
    outcome = run_trial(fish)
    assert outcome.end == "complete"
    return read_trial(fish.pull_trial(outcome.number, folder))


def trials(folder: Path, seeds: int, **params: float) -> Swims:
    errors, sigmas = [], []
    for seed in range(1, seeds + 1):
        with Fish.connect("sim:tank", seed=seed) as fish:
            trial = swim(fish, folder, reference.thesis(), **params)
            assert fish.sim is not None
            errors.append(
                trial.beats.speed_m_s - fish.sim.world.true_beats()[: len(trial.beats.samples)]
            )
            sigmas.append(trial.beats.sigma_m_s)
    return Swims(np.array(errors, dtype=float), np.array(sigmas, dtype=float))


@pytest.mark.parametrize("seeds", SEEDS)
def test_imu_between_two_rests(seeds: int, tmp_path: Path) -> None:
    found = trials(tmp_path, seeds, SPD_SOURCE=IMU)
    print(f"imu: {found.text()}")
    found.assert_honest()
    assert found.mean_rms() <= 0.010


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("wrong", [0.6, 1.0, 1.4])
def test_model_with_the_wrong_drag(wrong: float, seeds: int, tmp_path: Path) -> None:
    found = trials(
        tmp_path,
        seeds // 4,
        SPD_SOURCE=MODEL,
        MDL_KAPPA=10 * wrong,
        MDL_SLOPE=0.219 / np.sqrt(wrong),
    )
    print(f"model, drag {wrong - 1:+.0%}: {found.text()}")
    assert np.mean(np.abs(found.error) < 2 * found.sigma) >= 0.9
    assert found.mean_rms() <= 0.010


@pytest.mark.parametrize("beat_s", [0.4, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("rest_min_s", [2, 5])
def test_a_held_fish_is_always_measured(beat_s: float, rest_min_s: float, tmp_path: Path) -> None:
    """Whenever the last nudge was: the rest is long enough for a whole beat in its second half."""
    wanted = reference.trapezoid(0.05, 2 * beat_s, 6 * beat_s, beat_s)
    for settle_s in (2.0, 2.7, 3.4):
        with Fish.connect("sim:tank", seed=5, beat_s=beat_s) as fish:
            trial = swim(
                fish,
                tmp_path,
                wanted,
                SPD_SOURCE=IMU,
                REST_MIN_S=rest_min_s,
                SETTLE_S=settle_s,
                SPD_SIGMA_MAX=1.0,
            )
        assert np.all(np.isfinite(trial.beats.speed_m_s))


@pytest.mark.parametrize("source", [VISION, MODEL])
def test_an_imu_that_restarts_in_mid_swim_spoils_nothing(source: int, tmp_path: Path) -> None:
    """What it says afterwards is not believed: nobody knows how the body turned meanwhile."""

    def restart(event: dict) -> None:
        if isinstance(event, BeatEvent) and event.beat == 5 and event.provisional:
            fish.sim.world.reboot_imu()

    with Fish.connect("sim:tank", seed=2) as fish:
        assert fish.sim is not None
        fish.params.set("SPD_SOURCE", source)
        fish.params.set("IMU_TIMEOUT_S", 5)
        fish.params.set("AMP_MAX_RAD", 0.785)
        fish.upload_reference(reference.trapezoid(0.06, 4, 12))
        fish.link.run(REST_S)
        outcome = run_trial(fish, on_event=restart)
        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
        error = trial.beats.speed_m_s - fish.sim.world.true_beats()[: len(trial.beats.samples)]
        assert fish.health()["imu_restarts"] == 1
    assert outcome.end == "complete"
    measured = np.isfinite(error)
    assert np.count_nonzero(measured) >= 12
    assert np.all(np.abs(error[measured]) < 4 * trial.beats.sigma_m_s[measured])


def test_an_imu_that_falls_silent_after_the_swim_ends_the_waiting(tmp_path: Path) -> None:
    del tmp_path
    texts: list[str] = []

    def wedge(event: dict) -> None:
        if isinstance(event, BoardText):
            texts.append(event.text)
        if isinstance(event, HoldRequest):
            fish.sim.world.wedge_imu()

    with Fish.connect("sim:tank", seed=2) as fish:
        assert fish.sim is not None
        fish.params.set("SPD_SOURCE", IMU)
        fish.upload_reference(reference.trapezoid(0.06, 4, 4))
        fish.link.run(REST_S)
        begin_s = fish.transport.now_s()
        outcome = run_trial(fish, on_event=wedge)
        took_s = fish.transport.now_s() - begin_s
    assert outcome.end == "complete"
    assert took_s < 12 + 10
    assert all(beat.speed_m_s is None for beat in outcome.beats)
    assert "nothing comes from the IMU" in texts
    assert texts.count("the fish is not still") == 1
