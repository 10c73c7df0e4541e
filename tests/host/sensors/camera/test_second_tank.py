"""Speeds from films with other optics than the host tool's own renderer (second_tank.py)."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

from scipy.optimize import minimize_scalar

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import speed
from tailbeat.sensors.camera.smoother import check_stamps
from tailbeat.sensors.camera.speed import swim_speed
from tailbeat.sensors.camera.tracking.track import SEEN, Track

from .second_films import filming, measured, tracked
from .second_optics import Floats, Optics, Waves
from .second_tank import Filming, SecondTank, Swim, moments

SMALL = Optics(size_px=(640, 360), focal_px=520, height_m=1.35, x_m=0.4)
SHORT = Swim(seed=1, beats=8, lead_s=1.0, coast_s=1.0)


def test_rays_are_bent_as_light_is() -> None:
    """Against Fermat's principle: light takes the quickest way."""
    optics = Optics(lean_rad=(0.0, 0.0))
    u, v = np.array([700.0]), np.array([269.5 - 3.0])
    x, _ = optics.seen_at(u, v, 0.15, Waves(), 0.0)
    through, _ = optics.seen_at(u, v, 0.0, Waves(), 0.0)

    def time(s: float) -> float:
        return math.hypot(s - optics.x_m, optics.height_m) + 1.33 * math.hypot(x[0] - s, 0.15)

    best = minimize_scalar(time, bounds=(optics.x_m, x[0]), options={"xatol": 1e-12}).x
    assert through[0] == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("depth_m", [0.0, 0.15])
def test_points_are_where_their_rays_end(depth_m: float) -> None:
    places = np.array([[-0.1, -0.5], [1.0, 0.2], [2.1, 0.6]])
    pixels = Optics().pixels_of(places, depth_m)
    ends = Optics().seen_at(*pixels.T, depth_m, Waves(), 0.0)
    np.testing.assert_allclose(np.column_stack(ends), places, atol=1e-9)


def test_waves_move_what_lies_under_them() -> None:
    """By a quarter of the depth times the slope, for small slopes."""
    optics, waves = Optics(lean_rad=(0.0, 0.0)), Waves(0.002, 4)
    middle = np.array([optics.middle_px[0]]), np.array([optics.middle_px[1]])
    for t_s in (0.1, 0.4, 0.9):
        x, _ = optics.seen_at(*middle, 0.05, waves, t_s)
        slope, _ = waves.slopes(np.array([optics.x_m]), np.array([optics.y_m]), t_s)
        assert x[0] - optics.x_m == pytest.approx(0.05 * (1 - 1 / 1.33) * slope[0], rel=0.02)


def test_a_long_exposure_smears_the_marker() -> None:
    """And a picture is the same whenever it is drawn first."""

    def picture(exposure_s: float) -> Floats:
        by = Filming(optics=SMALL, noise=0.0, exposure_s=exposure_s)
        return SecondTank(SHORT, by).picture(2.0).astype(float)

    still = picture(0.008)
    np.testing.assert_array_equal(still, picture(0.008))
    assert np.abs(still - picture(0.2)).max() > 35


def test_a_small_film_has_the_right_speeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A marker 15 cm under small waves; bench/films/camera_films.py draws whole trials."""
    monkeypatch.setattr(SecondTank, "SAMPLES", 4)
    by = filming("15 cm deep", 3, SMALL)
    found = measured(*tracked(tmp_path / "film.mp4", SHORT, by), SHORT, by)
    error, sigma = found.error_m_s * 1e3, found.sigma_m_s * 1e3
    print(f"seed 3: RMS {np.sqrt(np.mean(error**2)):.3f} mm/s, sigma {np.median(sigma):.3f}")
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.8
    assert np.mean(np.abs(error) < 2 * sigma) >= 0.75  # of eight
    assert np.median(sigma) < 0.6


def seen(swim: Swim, by: Filming, noise_m: float = 1e-4) -> Track:
    """What would be tracked in the film, without drawing it."""
    random = np.random.default_rng((by.seed, 23))
    taken_s, stamp_s = np.array(list(moments(swim, by))).T
    order = np.argsort(stamp_s)
    x, y, heading = swim.pose(taken_s[order])
    count = len(x)
    x, y = x + random.normal(0, noise_m, count), y + random.normal(0, noise_m, count)
    state = np.full(count, SEEN, np.uint8)
    return Track(stamp_s[order], x, y, heading, np.ones(count), state, by.fps, "swim.mp4")


def test_waves_over_the_marker_are_not_taken_for_its_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.4 mm at 2.6 Hz that come and go; and what comes of it when the surge counts as way."""
    swim = Swim(3)
    track = seen(swim, Filming(seed=3))
    wave_m = 4e-4 * np.sin(2 * np.pi * 2.6 * track.t_s + 1.5 * np.sin(2 * np.pi * track.t_s / 9))
    track = replace(track, x_m=track.x_m + wave_m)

    def beats() -> tuple[float, float]:
        curve = swim_speed(track, 1.0, 0.0, beats=24)
        speed, sigma = curve.beats(24)
        error = speed - swim.true_beats(curve.direction_rad)
        inside = float(np.mean(np.abs(error) < 2 * sigma))
        print(f"seed 3: RMS {np.sqrt(np.mean(error**2)):.6f}, in 2 sigma {inside:.2f}")
        return float(np.sqrt(np.mean(error**2))), inside

    rms, inside = beats()
    assert rms < 0.25e-3
    assert inside >= 0.85
    monkeypatch.setattr(speed, "WAY_AS", np.array([1.0, 0, 0, 1, 0, 1, 0, 0]))
    with_surge, _ = beats()
    assert with_surge > 2 * rms


def test_noise_that_is_correlated_is_in_the_sigma() -> None:
    """0.2 mm with a correlation time of 0.15 s, beside 0.1 mm of white noise, 4 films."""
    hits = []
    for seed in range(4):
        swim, random = Swim(seed), np.random.default_rng((seed, 29))
        track = seen(swim, Filming(seed=seed))
        drift_m, kept = np.zeros(len(track.t_s)), math.exp(-0.04 / 0.15)
        for k in range(1, len(drift_m)):
            drift_m[k] = kept * drift_m[k - 1] + 2e-4 * math.sqrt(1 - kept**2) * random.normal()
        curve = swim_speed(replace(track, x_m=track.x_m + drift_m), 1.0, 0.0, beats=24)
        speed_m_s, sigma = curve.beats(24)
        hits.append(np.abs(speed_m_s - swim.true_beats(curve.direction_rad)) < 2 * sigma)
    print(f"seeds 0..3: in 2 sigma {np.mean(hits):.2f}")
    assert np.mean(hits) >= 0.85


@pytest.mark.parametrize("seed", range(5))
def test_a_restamped_film_with_missing_pictures_is_refused(seed: int) -> None:
    swim = Swim(seed)
    by = Filming(lost=0.05, restamped=True, seed=seed)
    with pytest.raises(InputError, match=r"swim.mp4 lacks pictures, and its time stamps do not"):
        swim_speed(seen(swim, by), 1.0, 0.0, beats=24)


def test_hands_before_and_after_the_trial_do_not_matter() -> None:
    """A fish that is put down in jumps before it swims, and is taken out afterwards."""
    swim = Swim(2, lead_s=4.0, coast_s=4.0)
    track = seen(swim, Filming(seed=2))
    before, after = track.t_s < -1.0, track.t_s > 25.5
    x_m = track.x_m.copy()
    random = np.random.default_rng(3)
    for part in (before, after):
        x_m[part] += np.cumsum(0.004 + 0.004 * (random.random(part.sum()) < 0.2))
    x_m[before] -= x_m[before][-1]
    shaken = replace(track, x_m=x_m)
    with pytest.raises(InputError, match="lacks pictures"):
        check_stamps(shaken.t_s, shaken.x_m, "swim.mp4")  # as if it were all of the swim
    curve = swim_speed(shaken, 1.0, 0.0, beats=24)
    error = curve.beats(24)[0] - swim.true_beats(curve.direction_rad)
    assert np.sqrt(np.mean(error[1:-1] ** 2)) < 0.8e-3


@pytest.mark.parametrize(
    "honest",
    [{}, {"lost": 0.05}, {"lost": 0.3}, {"jitter_s": 0.005}, {"jitter_s": 0.012, "lost": 0.05}],
)
def test_films_with_their_own_time_stamps_are_not_refused(honest: dict[str, float]) -> None:
    for seed in range(20):
        for noise_m in (5e-5, 3e-4, 1e-3):
            track = seen(Swim(seed), Filming(seed=seed, **honest), noise_m)
            check_stamps(track.t_s, track.x_m, "swim.mp4")


def test_places_that_jump_to_and_fro_are_no_missing_pictures() -> None:
    track = seen(Swim(2), Filming(seed=2))
    random = np.random.default_rng(4)
    x_m = track.x_m.copy()
    x_m[random.choice(len(x_m), 30, replace=False)] += 3e-3
    check_stamps(track.t_s, x_m, "swim.mp4")
