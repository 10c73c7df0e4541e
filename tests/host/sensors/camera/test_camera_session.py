"""A fish learns from drawn pictures as well as from its true speed, live and film by film."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

pytest.importorskip("cv2")

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, thesis
from tailbeat.learning.design import design
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.speed import swim_speed
from tailbeat.sensors.camera.sync import sync
from tailbeat.session.identify import IdentificationHooks, identify_fish
from tailbeat.session.trial import run_trial

from ...rendered_tank import drawn_camera, swim_before_the_camera

SMALL = Scene(size_px=(960, 540))
SHORT = Reference(1.0, thesis().speed_m_s[:8], "short")
SEEDS = int(os.environ.get("CAMERA_SESSION_SEEDS", "4"))
UPLOAD = 1


def prepared(seed: int, reference: Reference, **overrides: float) -> Fish:
    """Its law designed for it; the speed by vision."""
    fish = Fish.connect(f"sim:tank?seed={seed}", **overrides)
    fish.params.set("AMP_MAX_RAD", math.pi / 4)
    fish.params.set("DU_MAX_RAD", 0.0)
    identified = identify_fish(fish, IdentificationHooks(), quick=True)
    law = design(identified, reference, math.pi / 4).law
    for name, value in {"ILC_GAIN": law.kp_rad_s_m, "ILC_LEAD": law.lead_beats}.items():
        fish.params.set(name, value)
    fish.upload_reference(reference)
    fish.sim.world.set_swim(1)  # the same noise, whatever was executed before
    return fish


def last_errors(fish: Fish, reference: Reference, trial, trials: int) -> tuple[float, float]:
    """Means of the true max|e| and RMS over the last half of the trials."""
    found = []
    for _ in range(trials):
        number = trial(fish)
        error = reference.speed_m_s - fish.sim.world.true_beats()
        found.append((np.abs(error).max(), np.sqrt(np.mean(error**2))))
        fish.learn(number)
    return tuple(np.mean(found[trials // 2 :], axis=0))


def by_truth(fish: Fish) -> int:
    fish.params.set("SPD_SOURCE", UPLOAD)
    number = run_trial(fish).number
    beats = fish.sim.world.true_beats()
    fish.upload_speeds(number, beats, np.full(len(beats), 1e-4))
    return number


def live(scene: Scene):
    def trial(fish: Fish) -> int:
        with drawn_camera(fish, scene) as camera:
            return run_trial(fish, camera).number

    return trial


def by_film(scene: Scene):
    """The thesis's own way: swim, look at the film, upload, learn."""

    def trial(fish: Fish) -> int:
        fish.params.set("SPD_SOURCE", UPLOAD)
        recorded = swim_before_the_camera(fish, scene, patch=True)
        start_s = sync(recorded.track, recorded.trial).start_s
        count = recorded.trial.executed_beats
        speed, sigma = swim_speed(
            recorded.track, recorded.trial.beat_s, start_s, beats=count
        ).beats(count)
        fish.upload_speeds(recorded.trial.number, speed, sigma)
        return recorded.trial.number

    return trial


def compared(reference: Reference, seeds: range, trials: int, ways) -> dict[str, float]:
    """The last errors over those with perfect speed, means over seeds; the larger of the ratios of
    max|e|, which the end of the reference rules, and of the RMS."""
    errors = {}
    for name, way in {"truth": by_truth, **ways}.items():
        found = []
        for seed in seeds:
            with prepared(seed, reference) as fish:
                found.append(last_errors(fish, reference, way, trials))
        errors[name] = np.mean(found, axis=0)
        largest, rms = 1e3 * errors[name]
        print(f"seeds {seeds}, {name}: max|e| {largest:.3f} mm/s, RMS {rms:.3f}")
    return {name: float(np.max(errors[name] / errors["truth"])) for name in ways}


def test_a_fish_learns_from_pictures_as_from_the_truth() -> None:
    found = compared(SHORT, range(1, 2), 2, {"live": live(SMALL)})
    assert found["live"] < 1.15


@pytest.mark.soak
def test_whole_sessions_of_many_seeds() -> None:
    scene = Scene(glare=0.2, hidden=0.03)
    ways = {"live": live(scene), "film": by_film(scene)}
    found = compared(thesis(), range(1, SEEDS + 1), 6, ways)
    assert found["live"] < 1.15
    assert found["film"] < 1.15
