"""Speeds from drawn pictures against the simulator's truth: light, glare, lost pictures."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cv2")

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, thesis
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.speed import SpeedCurve, swim_speed
from tailbeat.sensors.camera.sync import sync_by_led, sync_by_yaw

from ...rendered_tank import Swum, swim_before_the_camera

CLEAN = Scene()
ROUGH = Scene(glare=0.3, hidden=0.05, ripples=1.0, pixel_noise=4.0)
SMALL = replace(ROUGH, size_px=(960, 540))
SHORT = Reference(1.0, thesis().speed_m_s[8:18], "short")
LONG_SEEDS = int(os.environ.get("CAMERA_SEEDS", "20"))


def filmed(seed: int, fps: float, scene: Scene, lost: float, reference: Reference) -> Swum:
    url = f"sim:tank?seed={seed}"
    with Fish.connect(url, camera_fps=fps, camera_lost=lost, camera_noise_m=1e-3) as fish:
        fish.params.set("AMP_MAX_RAD", math.pi / 4)
        fish.upload_reference(reference)
        fish.imu_verdict()
        return swim_before_the_camera(fish, scene, patch=True)


def speeds_of(recorded: Swum) -> tuple[SpeedCurve, np.ndarray, np.ndarray]:
    """The curve, error and sigma of every beat."""
    count = len(recorded.true_beats)
    found = sync_by_led(recorded.track, recorded.trial)
    curve = swim_speed(recorded.track, recorded.trial.beat_s, found.start_s, beats=count)
    speed, sigma = curve.beats(count)
    return curve, speed - recorded.true_beats, sigma


def test_a_filmed_swim_has_the_right_speeds() -> None:
    recorded = filmed(1, 25.0, SMALL, 0.1, SHORT)
    _, error, sigma = speeds_of(recorded)
    known = np.isfinite(error)
    print(f"seed 1: RMS {np.sqrt(np.mean(error[known] ** 2)):.6f}, {known.sum()} of {len(error)}")
    assert known.mean() > 0.7
    assert np.sqrt(np.mean(error[known] ** 2)) < 0.5e-3
    assert np.mean(np.abs(error[known]) < 2 * sigma[known]) >= 0.75  # of a dozen
    led, yaw = (
        sync_by_led(recorded.track, recorded.trial),
        sync_by_yaw(recorded.track, recorded.trial),
    )
    assert abs(led.start_s - recorded.start_s) < 0.010
    assert abs(yaw.start_s - recorded.start_s) < 0.040


@pytest.mark.soak
@pytest.mark.parametrize("fps", [25.0, 60.0])
@pytest.mark.parametrize(("name", "scene", "lost"), [("clean", CLEAN, 0.0), ("rough", ROUGH, 0.1)])
def test_filmed_swims_of_many_seeds(name: str, scene: Scene, lost: float, fps: float) -> None:
    errors, sigmas, led, yaw = [], [], [], []
    for seed in range(1, LONG_SEEDS + 1):
        recorded = filmed(seed, fps, scene, lost, thesis())
        _, error, sigma = speeds_of(recorded)
        errors.append(error)
        sigmas.append(sigma)
        led.append(sync_by_led(recorded.track, recorded.trial).start_s - recorded.start_s)
        yaw.append(sync_by_yaw(recorded.track, recorded.trial).start_s - recorded.start_s)
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    known = np.isfinite(error)
    inside = np.mean(np.abs(error[known]) < 2 * sigma[known])
    rms, bias = np.sqrt(np.mean(error[known] ** 2)), error[known].mean()
    print(
        f"\n{name}, {fps:.0f} fps, seeds 1..{LONG_SEEDS}: RMS {1e3 * rms:.3f} mm/s,"
        f" bias {1e3 * bias:+.3f}, sigma {1e3 * sigma[known].mean():.3f},"
        f" in 2 sigma {100 * inside:.1f} %, measured {100 * known.mean():.1f} %;"
        f" LED worst {1e3 * np.abs(led).max():.1f} ms, RMS {1e3 * np.std(led):.1f};"
        f" yaw worst {1e3 * np.abs(yaw).max():.1f} ms, mean {1e3 * np.mean(yaw):+.1f}"
    )
    assert rms <= 1e-3
    assert sigma[known].max() <= 1e-3
    assert abs(bias) <= 0.5e-3
    assert inside >= 0.9
    assert known.mean() > 0.8
    assert np.abs(led).max() <= 0.010
    assert np.abs(yaw).max() <= 0.040
