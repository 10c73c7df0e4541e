"""Whether a fish swam straight: made headings, the simulator's true one; speeds along its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.reference import thesis
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_checks import (
    CROOKED_RAD,
    HeadingDrift,
    HeadingTrace,
    heading_drift,
    heading_drift_of_frames,
)
from tailbeat.core.trial_file import NO_MOTION, Beats, Rest, Slots, Trial, read_trial
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session.guards import FrameRecorder
from tailbeat.session.trial import run_trial

Turn = Callable[[np.ndarray], np.ndarray]


def trial(heading: Turn, beats: int = 40, beat_s: float = 1.0, rest_s: float = 30.0) -> Trial:
    """As a board writes it: turns rounded to 0.1 mrad, 0.05 m/s, and 3 s more at the end."""
    count = math.ceil((beats * beat_s + 3) / 0.1)
    ends = heading(np.arange(count + 1) * 0.1)
    nothing = np.zeros(count)
    slots = Slots(
        index=np.arange(count, dtype=np.uint16),
        samples=nothing.astype(np.uint8),
        at_ms=nothing.astype(np.uint8),
        speed_m_s=nothing.astype(np.float32),
        sigma_10um_s=nothing.astype(np.uint16),
        gain_10um_s=nothing.astype(np.int16),
        way_um=nothing.astype(np.int16),
        turn_100urad=np.rint(np.diff(ends) * 1e4).astype(np.int16),
    )
    speed = np.full(beats, 0.05, np.float32)
    table = Beats(speed * 8, speed * 8, speed, speed, speed / 50, np.full(beats, 25, np.uint16))
    rest = Rest(-rest_s, rest_s) if rest_s else None
    return Trial(
        1, 1, 7, beat_s, 0, "simulated", "", "", 0, beats, "complete", False, {}, slots, rest,
        None, table, [],
    )  # fmt: skip


def wobble(t_s: np.ndarray, beat_s: float = 1.0) -> np.ndarray:
    """As of a body that swings by 10 degrees at 45 degrees of tail; the tail begins right."""
    return -0.17 * np.sin(math.tau * t_s / beat_s)


def without(one: Trial, holes: list[int]) -> Trial:
    turn = one.slots.turn_100urad.copy()
    turn[holes] = NO_MOTION
    return replace(one, slots=replace(one.slots, turn_100urad=turn))


@pytest.mark.parametrize("beat_s", [0.5, 1.0, 1.26, 4.0])
def test_the_wobble_of_a_body_is_no_turn(beat_s: float) -> None:
    found = heading_drift(trial(lambda t: wobble(t, beat_s), 20, beat_s))
    assert found is not None and found.source == "imu"
    # A tenth of a second is a coarse measure of half a beat that holds no whole number of them.
    assert abs(found.worst_yaw_rad) < (2e-3 if beat_s != 1.26 else 0.01)
    assert not found.crooked


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_even_turn(side: float) -> None:
    """0.01 rad/s at 0.05 m/s: 0.2 rad/m, 0.39 rad from the first beat to the last."""
    found = heading_drift(trial(lambda t: side * 0.01 * t + wobble(t)))
    assert found is not None
    assert found.worst_yaw_rad == pytest.approx(side * 0.39, abs=2e-3)
    assert found.mean_yaw_rad == pytest.approx(side * 0.195, abs=2e-3)
    assert found.curvature_1_m == pytest.approx(side * 0.2, abs=2e-3)
    assert found.crooked
    words = found.text()
    assert words.startswith("NOT STRAIGHT") and ("right" if side > 0 else "left") in words


def test_the_farthest_off_counts_also_when_it_comes_back() -> None:
    found = heading_drift(trial(lambda t: -0.4 * np.sin(math.tau * t / 80) + wobble(t)))
    assert found is not None
    assert found.worst_yaw_rad == pytest.approx(-0.4, abs=0.03) and found.crooked


def test_fifteen_degrees() -> None:
    for worst, crooked in ((CROOKED_RAD * 0.99, False), (-CROOKED_RAD * 1.01, True)):
        found = HeadingDrift(0.0, worst, 0.0, "imu")
        assert found.crooked == crooked and ("NOT" in found.text()) == crooked


def test_turns_that_are_not_known() -> None:
    whole = trial(lambda t: 0.01 * t + wobble(t))
    for holes in ([0], [399], list(range(13, 400, 20)), [100, 101, 102]):
        found = heading_drift(without(whole, holes))
        assert found is not None
        assert found.worst_yaw_rad == pytest.approx(0.39, abs=0.01), holes
    assert heading_drift(without(whole, list(range(0, 400, 9)))) is None
    assert heading_drift(replace(whole, executed_beats=0)) is None
    older = replace(whole.slots, turn_100urad=np.full_like(whole.slots.turn_100urad, NO_MOTION))
    assert heading_drift(replace(whole, slots=older)) is None


def test_only_what_was_swum_counts() -> None:
    """Somebody carries it back after beat 20."""
    carried = trial(lambda t: np.where(t < 20.05, 0.0, 3.0 * (t - 20.05)))
    found = heading_drift(replace(carried, executed_beats=20))
    assert found is not None and abs(found.worst_yaw_rad) < 1e-3


@pytest.mark.parametrize(("rest_s", "told"), [(0.0, False), (7.0, False), (9.0, True)])
def test_without_a_rest_before_it_the_gyro_has_no_zero(rest_s: float, told: bool) -> None:
    """The rest may hold a turn of a degree: 5 degrees over five times its length."""
    assert (heading_drift(trial(wobble, rest_s=rest_s)) is not None) == told


def test_a_fish_that_hardly_moved_has_no_curvature() -> None:
    one = trial(lambda t: 0.01 * t)
    for speed in (0.001, math.nan):
        beats = replace(one.beats, speed_m_s=np.full(40, speed, np.float32))
        found = heading_drift(replace(one, beats=beats))
        assert found is not None and math.isnan(found.curvature_1_m)
        assert found.worst_yaw_rad == pytest.approx(0.39, abs=2e-3)


# -- by a camera ----------------------------------------------------------------------------------


def frames(
    course_rad: float = 0.0, turn_1_m: float = 0.0, beats: int = 30, lost: float = 0.0
) -> list[Frame]:
    """0.08 m/s from 5 s before the begin at 100 s on, still until then; noise as of a marker."""
    rng = np.random.default_rng(3)
    found, x, y = [], 0.0, 0.0
    for k in range(-125, 25 * beats):
        t = k / 25
        heading = course_rad + turn_1_m * 0.08 * max(t, 0.0)
        if t > 0:
            x, y = x + 0.0032 * math.cos(heading), y + 0.0032 * math.sin(heading)
        sway = -0.17 * math.sin(math.tau * t) if t > 0 else 0.0
        seen = heading + sway + rng.normal(0, 0.004)
        seen = math.remainder(seen, math.tau)
        noisy = rng.normal(0, 1e-3, 2)
        if rng.random() >= lost:
            found.append(Frame(100 + t, x + noisy[0], y + noisy[1], seen))
    return found


@pytest.mark.parametrize("course_rad", [0.0, 0.5, 3.1])
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_by_frames(course_rad: float, lost: float) -> None:
    """Whatever the direction it set out in; headings jump by a turn at pi."""
    for turn in (-0.2, 0.0, 0.2):
        found = heading_drift_of_frames(frames(course_rad, turn, lost=lost), 100.0, 30, 1.0)
        assert found is not None and found.source == "camera"
        assert found.worst_yaw_rad == pytest.approx(turn * 0.08 * 29, abs=0.02)
        assert found.curvature_1_m == pytest.approx(turn, abs=0.01)


def test_a_camera_that_saw_too_little() -> None:
    seen = frames(beats=30)
    half = [f for f in seen if f.t_s < 114.5]
    assert heading_drift_of_frames(half, 100.0, 30, 1.0) is None
    assert heading_drift_of_frames(half, 100.0, 28, 1.0) is not None
    assert heading_drift_of_frames([], 100.0, 30, 1.0) is None
    assert heading_drift_of_frames(seen, 100.0, 0, 1.0) is None
    senseless = [Frame(math.nan, 0.0), Frame(105.01, math.inf), Frame(105.02, 0.0, 0.0, math.nan)]
    assert heading_drift_of_frames([*seen, *senseless], 100.0, 30, 1.0) is not None


# -- against the simulator's true heading ---------------------------------------------------------


@pytest.mark.parametrize("askew_rad", [-0.03, 0.0, 0.05])
def test_the_simulator_s_own_heading(askew_rad: float, tmp_path: Path) -> None:
    """By IMU and camera, both with their noise; at the end the fish has turned the farthest."""
    with Fish.connect("sim:tank", seed=4, tail_centre_rad=askew_rad, placed_after_s=0) as fish:
        assert fish.sim is not None
        fish.params.set("ILC_GAIN", 7)
        fish.upload_reference(thesis().record())
        fish.link.run(30)
        seen = FrameRecorder()
        number = run_trial(fish, guard=seen).number
        true_rad = fish.sim.world.truth().heading_rad
        one = read_trial(fish.pull_trial(number, tmp_path))
        begin_s = one.start_us * 1e-6
        by_board = [replace(f, t_s=fish.clock.board_s(f.t_s)) for f in seen.frames]
    felt = heading_drift(one)
    saw = heading_drift_of_frames(by_board, begin_s, one.executed_beats, one.beat_s)
    assert felt is not None and saw is not None
    print(askew_rad, math.degrees(true_rad), felt, saw)
    for found in (felt, saw):
        assert found.worst_yaw_rad == pytest.approx(true_rad, abs=math.radians(1.5))
        assert found.crooked == (abs(true_rad) > CROOKED_RAD)


# -- speeds along the way -------------------------------------------------------------------------


class Turned:
    """The tank's frame turned against the swim by ``angle_rad``: a camera that hangs askew."""

    clock: Literal["host", "board"] = "host"

    def __init__(self, inner: SimulatedCamera, angle_rad: float) -> None:
        self.fps, self._inner, self._angle_rad = inner.fps, inner, angle_rad

    def frames(self) -> list[Frame]:
        """Turned."""
        c, s = math.cos(self._angle_rad), math.sin(self._angle_rad)
        return [
            Frame(f.t_s, c * f.x_m - s * f.y_m, s * f.x_m + c * f.y_m, f.heading_rad)
            for f in self._inner.frames()
        ]

    def close(self) -> None:
        """As the camera."""
        self._inner.close()


def speeds(angle_rad: float | None, direction_rad: float, tmp_path: Path) -> np.ndarray:
    """Of ``cosine(0.06, 4, 2)`` by the board; angle None: the camera as it is."""
    with Fish.connect("sim:tank", seed=5) as fish:
        assert fish.sim is not None
        fish.params.set("ILC_GAIN", 7)
        fish.upload_reference(reference.cosine(0.06, 4, 2).record())
        plain = SimulatedCamera(fish.sim)
        camera = plain if angle_rad is None else Turned(plain, angle_rad)
        number = run_trial(fish, camera, direction_rad=direction_rad).number
        return read_trial(fish.pull_trial(number, tmp_path)).beats.speed_m_s


def test_speeds_are_along_the_swim(tmp_path: Path) -> None:
    plain = speeds(None, 0.0, tmp_path / "0")
    assert np.isfinite(plain).all()
    for angle in (0.5, -2.0):
        along = speeds(angle, angle, tmp_path / f"{angle}")
        assert np.allclose(along, plain, atol=2e-4)
    beside = speeds(-2.0, 0.0, tmp_path / "x")
    assert np.abs(beside - plain).max() > 0.01


def test_a_swim_along_x_is_bit_for_bit_what_it_was(tmp_path: Path) -> None:
    class NoSides(Turned):
        def frames(self) -> list[Frame]:
            return [replace(f, y_m=math.nan) for f in self._inner.frames()]

    plain = speeds(None, 0.0, tmp_path / "0")
    with Fish.connect("sim:tank", seed=5) as fish:
        assert fish.sim is not None
        fish.params.set("ILC_GAIN", 7)
        fish.upload_reference(reference.cosine(0.06, 4, 2).record())
        number = run_trial(fish, NoSides(SimulatedCamera(fish.sim), 0.0)).number
        found = read_trial(fish.pull_trial(number, tmp_path / "1")).beats.speed_m_s
    assert found.tobytes() == plain.tobytes()


def test_what_is_written_down_does_not_depend_on_the_order_of_sums() -> None:
    """Nor, then, on the processor: a product of matrices adds up as that likes best."""
    random = np.random.default_rng(4)
    heading, way = random.normal(0, 0.1, 37), np.cumsum(random.uniform(0.02, 0.08, 37))
    found = HeadingTrace(heading, way).turn_rad_m()
    for _ in range(20):
        order = random.permutation(37)
        shuffled = HeadingTrace(heading[order], way[order])
        assert shuffled.turn_rad_m() == found
        one, other = (c.straightness("imu") for c in (shuffled, HeadingTrace(heading, way)))
        assert one is not None and other is not None
        assert one.mean_yaw_rad == other.mean_yaw_rad
