"""The speeds of trial files, recomputed by the board's own code: the same bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial

BEATS = 12
VISION, UPLOAD, IMU, MODEL = range(4)
REST_S = 9.0  # the IMU is found, and the fish has been still for REST_MIN_S


def recorded(
    folder: Path,
    source: int,
    beat_s: float = 1.0,
    abort_at: int | None = None,
    why: StopKind = StopKind.CALLER,
    guard_beats: int = 1,
) -> Trial:
    def guard(what: object) -> StopReason | None:
        return StopReason(why, "enough") if getattr(what, "beat", -1) == abort_at else None

    with Fish.connect("sim:tank", seed=7, camera_lost=0.1, beat_s=beat_s) as fish:
        fish.params.set("SPD_SOURCE", source)
        fish.params.set("AMP_MAX_RAD", 0.785)
        fish.params.set("GUARD_BEATS", guard_beats)
        fish.upload_reference(reference.trapezoid(0.06, 3 * beat_s, (BEATS - 6) * beat_s, beat_s))
        fish.link.run(REST_S)
        run_trial(fish, guard=guard if abort_at is not None else None)
        return read_trial(fish.pull_trial(1, folder))


@pytest.mark.parametrize("beat_s", [0.76, 1.0, 2.0])
@pytest.mark.parametrize("source", [VISION, IMU, MODEL])
def test_the_same_bits(source: int, beat_s: float, tmp_path: Path) -> None:
    trial = recorded(tmp_path, source, beat_s)
    assert trial.end == "complete"
    speed, sigma = recompute_beats(trial)
    assert np.count_nonzero(np.isfinite(trial.beats.speed_m_s)) == BEATS
    assert np.array_equal(speed, trial.beats.speed_m_s, equal_nan=True)
    assert np.array_equal(sigma, trial.beats.sigma_m_s, equal_nan=True)
    assert trial.rest_before is not None
    assert (trial.rest_after is not None) == (source == IMU)


@pytest.mark.parametrize("source", [VISION, IMU, MODEL])
def test_the_same_bits_of_an_aborted_trial(source: int, tmp_path: Path) -> None:
    trial = recorded(tmp_path, source, abort_at=4)
    assert 4 < trial.executed_beats < BEATS
    speed, sigma = recompute_beats(trial)
    assert np.count_nonzero(np.isfinite(speed)) == trial.executed_beats
    assert np.array_equal(speed, trial.beats.speed_m_s, equal_nan=True)
    assert np.array_equal(sigma, trial.beats.sigma_m_s, equal_nan=True)


@pytest.mark.parametrize("guard_beats", [0, 1, 3, 10])
@pytest.mark.parametrize("source", [VISION, IMU, MODEL])
def test_the_same_bits_of_a_trial_that_ended_at_a_wall(
    source: int, guard_beats: int, tmp_path: Path
) -> None:
    trial = recorded(tmp_path, source, abort_at=4, why=StopKind.WALL, guard_beats=guard_beats)
    assert trial.end == "aborted:WALL"
    assert 4 < trial.executed_beats < BEATS
    speed, sigma = recompute_beats(trial)
    measured = max(0, trial.executed_beats - guard_beats)
    assert np.array_equal(np.isfinite(speed), np.arange(BEATS) < measured)
    assert np.array_equal(speed, trial.beats.speed_m_s, equal_nan=True)
    assert np.array_equal(sigma, trial.beats.sigma_m_s, equal_nan=True)
    assert np.all(np.isfinite(trial.beats.applied_rad[: trial.executed_beats]))


def test_a_damaged_guard_is_none(tmp_path: Path) -> None:
    trial = recorded(tmp_path, VISION, abort_at=4, why=StopKind.WALL)
    speed, _ = recompute_beats(trial)
    for value in (float("nan"), float("inf"), -3.0, 1e9, 1.5):
        damaged = replace(trial, params=trial.params | {"GUARD_BEATS": value})
        assert np.array_equal(recompute_beats(damaged)[0], speed, equal_nan=True)


def test_a_changed_slot_shows(tmp_path: Path) -> None:
    for source, column in ((VISION, "speed_m_s"), (IMU, "gain_10um_s"), (MODEL, "way_um")):
        trial = recorded(tmp_path, source)
        values = getattr(trial.slots, column)
        middle = int(np.searchsorted(trial.slots.index, 55))
        values[middle] += 0.01 if column == "speed_m_s" else 300
        assert not np.array_equal(recompute_beats(trial)[0], trial.beats.speed_m_s, equal_nan=True)


def test_without_its_rests_the_imu_knows_no_speed(tmp_path: Path) -> None:
    trial = recorded(tmp_path, IMU)
    for rests in ({"rest_before": None}, {"rest_after": None}):
        speed, sigma = recompute_beats(replace(trial, **rests))
        assert np.all(np.isnan(speed))
        assert np.all(np.isnan(sigma))


def test_uploaded_speeds_follow_from_nothing(tmp_path: Path) -> None:
    trial = recorded(tmp_path, UPLOAD)
    assert np.all(np.isnan(recompute_beats(trial)[0]))


@pytest.mark.parametrize("beat_s", [0.0, -1.0, float("nan"), 1e9])
def test_a_damaged_file_is_refused(tmp_path: Path, beat_s: float) -> None:
    trial = recorded(tmp_path, VISION)
    with pytest.raises(InputError, match="beat"):
        recompute_beats(replace(trial, beat_s=beat_s))
