"""What must be so before a trial, and what is said when it is not."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, LinkLostError, Refused
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.link import _dialect as mavlink
from tailbeat.session.events import Event, StepProgress
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.preflight import drift_of, prepare
from tailbeat.session.preflight_pose import CameraPose
from tailbeat.session.preflight_step import GivenUp, NotReady, PreflightLimits, PreflightStep
from tailbeat.session.trial import run_trial

from ..conftest import BadRadio
from ..tank_side import Overhead, Script, drifts, lies

QUICK = PreflightLimits(rest_s=0.0, patience_s=30.0)


def state_of(fish: Fish) -> str:
    return fish.status().state


def test_all_is_well(ready: Fish) -> None:
    operator = Script()
    begin_s = ready.transport.now_s()
    found = prepare(ready, QUICK, Overhead(ready, lies(0.02, -0.03, 3.0)), operator)
    assert operator.passed() == ["board", "room", "pose", "still", "board"]
    assert not operator.refused()
    assert found.rested_s is None
    assert found.travel.fits
    assert found.pose is not None
    assert found.pose.source == "camera"
    assert found.pose.x_m == pytest.approx(0.02, abs=0.001)
    assert found.pose.y_m == pytest.approx(-0.03, abs=0.001)
    assert math.degrees(found.pose.heading_rad or 0.0) == pytest.approx(3.0, abs=0.5)
    assert found.pose.yaw_deg is not None  # a simulated fish has an IMU
    assert found.drift is not None
    assert found.drift.over_s == 10.0
    assert found.drift.speed_m_s < 0.0002
    assert found.battery_v == pytest.approx(8.2)
    assert state_of(ready) == "IDLE"
    took_s = ready.transport.now_s() - begin_s
    assert 10.0 < took_s < 17.0
    assert operator.asked >= 9 * 10  # some ten times a second


# Rest


def trial(fish: Fish, beats: int = 8) -> None:
    fish.upload_amplitudes(np.full(beats, 0.3))
    assert run_trial(fish).end == "complete"
    fish.discard()


def countdown_of(operator: Script, step: str) -> list[int]:
    told = [e.left_s for e in operator.told if isinstance(e, StepProgress) and e.step == step]
    return [left for left in told if left is not None]


@pytest.mark.parametrize("before_s", [0.0, 12.0])
@pytest.mark.parametrize("known", [False, True])
def test_rest_counts_from_the_end_of_the_last_swim(
    ready: Fish, before_s: float, known: bool
) -> None:
    if known:  # by this process: it was there
        prepare(ready, replace(QUICK, still_s=0.0), None, Script())
    trial(ready)
    assert ready.sim is not None
    over_s = ready.sim.board_time_s
    ready.link.run(before_s)
    other = ready if known else Fish(ready.transport)
    operator = Script()
    found = prepare(other, PreflightLimits(rest_s=30.0, still_s=0.0), None, operator)
    rested_s = ready.sim.board_time_s - over_s
    lefts = countdown_of(operator, "rest")
    print(rested_s, found.rested_s, lefts)
    # The trial itself ended some SETTLE_S before run_trial returned.
    assert found.rested_s is not None
    assert found.rested_s == pytest.approx(rested_s + 3.0, abs=1.5)
    assert found.rested_s >= 30.0
    assert lefts == sorted(lefts, reverse=True)
    assert lefts[-1] == 0
    assert lefts[0] == pytest.approx(30.0 - before_s - 3.0, abs=2.0)


def test_the_log_is_read_as_little_as_possible(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial(ready)
    heads: list[tuple[str, int]] = []
    head = ready.ftp.head

    def spy(path: str, size: int) -> bytes:
        heads.append((path, size))
        return head(path, size)

    monkeypatch.setattr(ready.ftp, "head", spy)
    wanted = PreflightLimits(rest_s=5.0, still_s=0.0)
    prepare(ready, wanted, None, Script())
    assert heads
    assert {path for path, _ in heads} == {"/trials/0001.ulg"}
    assert sum(size for _, size in heads) <= 2 * 1024
    heads.clear()
    trial(ready)
    prepare(ready, wanted, None, Script())
    assert heads == []


def test_a_board_that_has_restarted_has_rested_as_long_as_it_is_up(ready: Fish) -> None:
    ready.link.run(200.0)
    trial(ready)
    assert ready.sim is not None
    ready.sim.world.power_cycle()
    ready.link.run(6.0)
    ready.clock.sync()
    operator = Script()
    found = prepare(ready, PreflightLimits(rest_s=30.0, still_s=0.0), None, operator)
    assert countdown_of(operator, "rest")[0] in (23, 24, 25)
    assert found.rested_s == pytest.approx(ready.sim.board_time_s, abs=0.5)


def test_a_log_that_is_gone_counts_as_a_swim_just_now(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tailbeat.link.ftp.wire import FtpError

    def none(path: str, size: int) -> bytes:
        raise FtpError(10, path)

    trial(ready)
    ready.link.run(60.0)
    monkeypatch.setattr(ready.ftp, "head", none)
    operator = Script()
    prepare(ready, PreflightLimits(rest_s=20.0, still_s=0.0), None, operator)
    assert countdown_of(operator, "rest")[0] == 20


def test_no_rest_when_none_is_asked_for_or_it_never_swam(ready: Fish) -> None:
    begin_s = ready.transport.now_s()
    operator = Script()
    prepare(ready, PreflightLimits(rest_s=500.0, still_s=0.0), None, operator)
    assert operator.texts("rest")[-1] == "it has not executed yet"
    trial(ready)
    begin_s = ready.transport.now_s()
    prepare(ready, PreflightLimits(rest_s=0.0, still_s=0.0), None, operator)
    assert ready.transport.now_s() - begin_s < 6.0


# Room


def test_no_room_is_told_before_anybody_waits(ready: Fish) -> None:
    trial(ready)
    ready.params.set("TANK_LEN_M", 0.5)
    operator = Script()
    begin_s = ready.transport.now_s()
    with pytest.raises(InputError) as raised:
        prepare(ready, PreflightLimits(), Overhead(ready, lies()), operator)
    assert "0.14" in str(raised.value)  # of 0.5 m less the fish
    assert operator.refused() == ["room"]
    assert ready.transport.now_s() - begin_s < 5.0


def test_what_may_be_too_far_at_worst_is_a_notice(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tailbeat.session.outcome import Travel

    monkeypatch.setattr(
        "tailbeat.session.preflight.travel_next",
        lambda *_: Travel(2.5, 2.71, 2.64, "a test"),
    )
    operator = Script()
    prepare(ready, replace(QUICK, still_s=0.0), None, operator)
    assert "at worst 2.71" in operator.notices()


def test_without_a_reference_there_is_nothing_to_swim(fish: Fish) -> None:
    with pytest.raises(Refused, match="no reference"):
        prepare(fish, QUICK, None, Script())


# Pose


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (lies(heading_deg=14.0), "turn the nose 14 degrees to the left"),
        (lies(heading_deg=-25.0), "turn the nose 25 degrees to the right"),
        (lies(heading_deg=181.0), "turn the nose 179 degrees to the right"),
        (lies(y_m=0.31), "it lies 0.31 m to the right of the line"),
        (lies(y_m=-0.2), "it lies 0.20 m to the left of the line"),
        (
            lies(0.0, 0.15, 30.0),
            "turn the nose 30 degrees to the left; it lies 0.15 m to the right",
        ),
    ],
)
def test_a_misplaced_fish_is_told_what_to_do(ready: Fish, pose: object, words: str) -> None:
    operator = Script()
    with pytest.raises(NotReady) as raised:
        prepare(ready, replace(QUICK, patience_s=5.0), Overhead(ready, pose), operator)  # type: ignore[arg-type]
    assert words in str(raised.value)
    assert any(text.startswith(words) for text in operator.texts("pose"))
    assert operator.refused() == ["pose"]
    assert state_of(ready) == "IDLE"


def test_it_waits_until_somebody_has_put_it_right(ready: Fish) -> None:
    def put_right(t_s: float) -> tuple[float, float, float]:
        return (0.0, 0.3, 0.5) if t_s < 8.0 else (0.0, 0.0, 0.05)

    camera = Overhead(ready, put_right)
    operator = Script()
    found = prepare(ready, QUICK, camera, operator)
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(0.05, abs=0.01)
    assert operator.passed() == ["board", "room", "pose", "still", "board"]
    assert camera.age_s > 8.0 + 10.0


@pytest.mark.parametrize("seed", range(3))
def test_headings_beside_the_seam_and_wrong_detections(ready: Fish, seed: int) -> None:
    """The mean of 179 and -179 degrees is 180; one picture in ten shows something else."""
    rng = np.random.default_rng(seed)
    print(f"seed {seed}")

    def astray(t_s: float) -> tuple[float, float, float]:
        return (0.7, -0.5, 2.0) if rng.random() < 0.1 else (0.0, 0.0, math.pi)

    operator = Script()
    with pytest.raises(NotReady):
        prepare(ready, replace(QUICK, patience_s=5.0), Overhead(ready, astray, seed), operator)
    told = [text for text in operator.texts("pose") if text.startswith("turn")]
    assert told
    assert {text.split()[3] for text in told} <= {"179", "180"}
    astray_too = replace(QUICK, patience_s=40.0)
    right = Overhead(ready, lambda t_s: (0.7, -0.5, 2.0) if rng.random() < 0.1 else (0, 0, 0), seed)
    assert prepare(ready, astray_too, right, operator).pose is not None


def test_a_fish_that_is_not_seen(ready: Fish) -> None:
    operator = Script()
    unseen = Overhead(ready, lies(), seen=lambda _: False)
    with pytest.raises(NotReady, match="the camera does not see the fish"):
        prepare(ready, replace(QUICK, patience_s=5.0), unseen, operator)


def test_a_picture_that_stands_still_is_no_still_fish(ready: Fish) -> None:
    camera = Overhead(ready, lies(), noise_m=0.0)
    with pytest.raises(NotReady, match=r"^the camera's picture stands still") as caught:
        prepare(ready, replace(QUICK, patience_s=5.0), camera, Script())
    assert caught.value.remedy.startswith("Look at the camera: it sends the same picture")


def test_a_picture_that_stops_moving_while_the_fish_comes_to_rest(ready: Fish) -> None:
    def way(t_s: float) -> tuple[float, float, float]:
        return (0.005 * math.sin(9.0 * t_s) if t_s < 4.0 else 0.0, 0.0, 0.0)

    camera = Overhead(ready, way, noise_m=0.0)
    with pytest.raises(NotReady, match=r"^the camera's picture stands still") as caught:
        prepare(ready, replace(QUICK, patience_s=8.0), camera, Script())
    assert "it sends the same picture" in caught.value.remedy


def test_without_camera_the_yaw_is_compared_across_the_seam(ready: Fish) -> None:
    operator = Script()
    first = prepare(ready, QUICK, None, operator)
    assert first.pose is not None
    assert first.pose.source == "imu"
    assert "not checked" in operator.notices()  # there is nothing to compare with yet
    yaw_deg = first.pose.yaw_deg
    assert yaw_deg is not None
    for start_deg, words in (
        (yaw_deg + 5.0, None),
        (yaw_deg - 354.0, None),
        (yaw_deg + 366.0, None),
        (yaw_deg - 20.0, "turn the nose 20 degrees to the left"),
        (yaw_deg - 340.0, "turn the nose 20 degrees to the right"),
        (yaw_deg + 190.0, "turn the nose 170 degrees to the left"),
    ):
        wanted = replace(QUICK, start_yaw_deg=start_deg, patience_s=4.0, still_s=0.0)
        if words is None:
            assert prepare(ready, wanted, None, operator).pose is not None
        else:
            with pytest.raises(NotReady, match=words):
                prepare(ready, wanted, None, operator)


def test_a_fish_on_its_side_is_told(ready: Fish) -> None:
    assert ready.sim is not None
    ready.sim.world.set_tilt_rad(math.radians(25.0))
    ready.link.run(3.0)
    operator = Script()
    prepare(ready, replace(QUICK, still_s=0.0), Overhead(ready, lies()), operator)
    assert "does not lie level: roll" in operator.notices()
    assert "25 degrees" in operator.notices()


def test_neither_camera_nor_imu_is_never_taken_for_passed(reference: bytes) -> None:
    with Fish.connect("sim:tank?seed=1") as fish:
        assert fish.sim is not None
        fish.sim.world.set_imu(False)
        fish.upload_reference(reference)
        fish.link.run(8.0)
        operator = Script()
        found = prepare(fish, QUICK, None, operator)
    assert found.pose is None
    assert found.drift is None
    assert operator.passed() == ["board", "room", "board"]
    assert "start pose is not checked" in operator.notices()
    assert "not checked: whether water and fish are still" in operator.notices()


# Still


@pytest.mark.parametrize("lost", [0.0, 0.4])
@pytest.mark.parametrize(
    ("x_m_s", "y_m_s", "passes"),
    [
        (0.0, 0.0, True),
        (0.0017, 0.0, True),
        (0.0, -0.0017, True),
        (0.0023, 0.0, False),
        (0.0, 0.0023, False),
        (-0.0016, 0.0016, False),
    ],
)
def test_drift_is_measured_over_ground_in_both_directions(
    ready: Fish, x_m_s: float, y_m_s: float, passes: bool, lost: float
) -> None:
    operator = Script()
    wanted = replace(QUICK, patience_s=16.0)
    camera = Overhead(ready, drifts(x_m_s, y_m_s), seed=7, lost=lost)
    if passes:
        found = prepare(ready, wanted, camera, operator).drift
        assert found is not None
        assert found.source == "camera"
        assert found.speed_m_s == pytest.approx(math.hypot(x_m_s, y_m_s), abs=4 * found.sigma_m_s)
        assert found.sigma_m_s < 0.0001
    else:
        with pytest.raises(NotReady) as raised:
            prepare(ready, wanted, camera, operator)
        told = re.search(r"drifts (.*) mm/s, must be below 2\.", str(raised.value))
        assert told is not None
        assert float(told[1]) == pytest.approx(2.3, abs=0.15)
        assert operator.refused() == ["still"]


def test_the_sigma_of_a_drift_is_honest() -> None:
    """Of 400 drifts seen with 1 mm of noise, and of 400 of a fish that sways on waves besides."""
    t_s = np.arange(250) / 25
    for sway_m, name in ((0.0, "noise"), (0.002, "waves")):
        rng = np.random.default_rng(11)
        errors, sigmas = [], []
        for _ in range(400):
            wave = sway_m * np.sin(2 * np.pi * (t_s / 2.7 + rng.random()))
            x_m = 0.0005 * t_s + rng.normal(0, 0.001, 250) + wave
            y_m = rng.normal(0, 0.001, 250)
            rows = zip(t_s, x_m, y_m, strict=True)
            drift = drift_of([Frame(t, x, y) for t, x, y in rows], 10.0)
            errors.append(drift.speed_m_s - 0.0005)
            sigmas.append(drift.sigma_m_s)
        ratio = float(np.std(errors) / np.median(sigmas))
        print(f"{name}: {np.std(errors) * 1e6:.0f} um/s, sigma {np.median(sigmas) * 1e6:.0f}")
        assert (0.8 if sway_m == 0 else 0.3) < ratio < 1.1


def test_a_drift_within_its_own_sigma_of_the_limit_does_not_pass(ready: Fish) -> None:
    def scatters(t_s: float) -> tuple[float, float, float]:
        return (0.0019 * t_s + 0.01 * (-1) ** round(25 * t_s), 0.0, 0.0)

    camera = Overhead(ready, scatters, noise_m=0.0001)
    with pytest.raises(NotReady, match=r"drifts 1\.9 \+- 0\.2 mm/s, must be below 2"):
        prepare(ready, replace(QUICK, patience_s=15.0), camera, Script())
    wider = replace(QUICK, drift_max_m_s=0.0022)
    assert prepare(ready, wider, Overhead(ready, scatters, noise_m=0.0001), Script()).drift


def test_a_fish_that_is_carried_starts_the_ten_seconds_anew(ready: Fish) -> None:
    camera = Overhead(ready, lambda t_s: (0.0 if t_s < 9.0 else 0.2, 0.0, 0.0))
    operator = Script()
    found = prepare(ready, QUICK, camera, operator)
    assert camera.age_s > 9.0 + 10.0
    assert found.pose is not None
    assert found.pose.x_m == pytest.approx(0.2, abs=0.002)
    lefts = countdown_of(operator, "still")
    assert lefts != sorted(lefts, reverse=True)
    assert 10 in lefts[5:]


def test_water_that_calms_down_is_waited_for(ready: Fish) -> None:
    """It moves the fish by 8 mm/s at first."""
    camera = Overhead(ready, lambda t_s: (0.08 * (1 - math.exp(-t_s / 10)), 0.0, 0.0))
    operator = Script()
    found = prepare(ready, replace(QUICK, patience_s=60.0), camera, operator)
    assert found.drift is not None
    assert found.drift.speed_m_s < 0.002
    told = [float(text.split()[1]) for text in operator.texts("still") if text.startswith("drifts")]
    print(told)
    assert told[0] > 5.0
    assert told == sorted(told, reverse=True)
    assert 19.0 < camera.age_s < 20.0  # 8 mm/s less 1/e in 10 s, in the middle of the window


@pytest.mark.parametrize(("blind_s", "anew"), [(0.7, False), (3.0, True)])
def test_out_of_sight_for_long_counts_anew(ready: Fish, blind_s: float, anew: bool) -> None:
    camera = Overhead(ready, lies(), seen=lambda t_s: not 8.0 < t_s < 8.0 + blind_s)
    prepare(ready, QUICK, camera, Script())
    assert (camera.age_s > 8.0 + blind_s + 10.0) == anew


def test_a_gap_counts_anew_though_nobody_looked_meanwhile(ready: Fish) -> None:
    """A bad radio may hold the preflight checks up for seconds."""
    camera = Overhead(ready, lies(), seen=lambda t_s: not 8.0 < t_s < 11.0)
    sight = CameraPose(ready, camera, 10.0)
    step = PreflightStep(ready, Script(), "still")
    for wait_s, from_s in ((7.5, 0.0), (5.0, 11.0)):
        ready.link.run(wait_s)
        sight.look(step)
        first_s = sight.frames[0].t_s - (ready.transport.now_s() - camera.age_s)
        assert first_s == pytest.approx(from_s, abs=0.05)


def test_a_fish_that_turns_while_the_water_calms_is_put_right_again(ready: Fish) -> None:
    def turned(t_s: float) -> tuple[float, float, float]:
        return (0.0, 0.0, 0.0 if t_s < 6.0 or t_s > 20.0 else 0.4)

    operator = Script()
    found = prepare(ready, QUICK, Overhead(ready, turned), operator)
    assert "turn the nose 23 degrees to the left" in operator.notices()
    assert operator.passed() == ["board", "room", "pose", "still", "pose", "still", "board"]
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(0.0, abs=0.01)


def test_a_camera_in_board_time(ready: Fish) -> None:
    found = prepare(ready, QUICK, Overhead(ready, drifts(0.001), clock="board"), Script())
    assert found.drift is not None
    assert found.drift.speed_m_s == pytest.approx(0.001, abs=0.0001)


def test_the_imu_only_says_that_nothing_moves_it(ready: Fish) -> None:
    operator = Script()
    found = prepare(ready, QUICK, None, operator)
    assert found.drift is not None
    assert found.drift.source == "imu"
    assert math.isnan(found.drift.speed_m_s)
    assert "slow drift cannot be felt" in operator.notices()
    assert ready.link.request("TAILBEAT_IMU_INFO").still_s >= 10.0


def test_the_imu_feels_a_fish_that_is_moved(ready: Fish) -> None:
    def roll(event: Event) -> None:
        assert ready.sim is not None
        rolled.append(0.0)
        ready.sim.world.set_tilt_rad(0.2 * (len(rolled) % 2))

    rolled: list[float] = []
    with pytest.raises(NotReady, match="does not come to rest, by the IMU"):
        prepare(ready, replace(QUICK, patience_s=20.0), None, Script(on_tell=roll))


# Battery, board


def test_an_empty_battery_is_told_at_once(ready: Fish) -> None:
    assert ready.sim is not None
    trial(ready)
    ready.sim.world.set_battery_v(6.55)
    ready.link.run(1.0)
    begin_s = ready.transport.now_s()
    with pytest.raises(NotReady, match=r"6\.55 V, .* 6\.60 V .*Swap the battery"):
        prepare(ready, PreflightLimits(), None, Script())
    assert ready.transport.now_s() - begin_s < 2.0
    ready.sim.world.set_battery_v(6.75)  # it recovers as soon as nothing pulls at it
    ready.link.run(1.0)
    with pytest.raises(NotReady, match=r"6\.80 V"):
        prepare(ready, PreflightLimits(), None, Script())
    ready.sim.world.set_battery_v(6.85)
    ready.link.run(1.0)
    assert prepare(ready, replace(QUICK, still_s=0.0), None, Script()).battery_v > 6.8


def test_a_battery_that_gets_empty_meanwhile(ready: Fish) -> None:
    def sag(event: Event) -> None:
        assert ready.sim is not None
        if isinstance(event, StepProgress) and event.step == "still":
            ready.sim.world.set_battery_v(6.5)

    with pytest.raises(NotReady, match="Swap the battery"):
        prepare(ready, QUICK, Overhead(ready, lies()), Script(on_tell=sag))


def test_a_nearly_empty_battery_is_a_notice(ready: Fish) -> None:
    assert ready.sim is not None
    ready.sim.world.set_battery_v(6.7)
    ready.link.run(1.0)
    operator = Script()
    prepare(ready, replace(QUICK, still_s=0.0), None, operator)
    assert "nearly empty" in operator.notices()


def test_a_stopped_board_says_why_and_what_to_do(ready: Fish) -> None:
    ready.upload_amplitudes(np.full(8, 0.3))
    seen: list[object] = []

    def wall(what: object) -> StopReason | None:
        seen.append(what)
        return StopReason(StopKind.WALL, "wall: near") if len(seen) > 60 else None

    run_trial(ready, guard=wall)
    assert state_of(ready) == "ABORTED"
    with pytest.raises(NotReady, match=r"WALL.*too close to a wall.*tailbeat board clear"):
        prepare(ready, PreflightLimits(), None, Script())
    ready.clear()
    with pytest.raises(
        NotReady, match=r"neither learned nor discarded \(trial 1\).*tailbeat trial learn"
    ):
        prepare(ready, PreflightLimits(), None, Script())


def test_a_board_that_is_armed_is_disarmed_first(ready: Fish) -> None:
    ready.arm()
    operator = Script()
    prepare(ready, replace(QUICK, still_s=0.0), None, operator)
    assert state_of(ready) == "IDLE"
    assert "it is disarmed until the countdown" in operator.notices()


def test_a_board_that_restarts_meanwhile(ready: Fish) -> None:
    def swap(event: Event) -> None:
        assert ready.sim is not None
        if (
            isinstance(event, StepProgress)
            and event.step == "still"
            and ready.sim.board_time_s > 9.0
        ):
            ready.sim.world.power_cycle()

    ready.link.run(20.0)
    with pytest.raises(NotReady, match="restarted"):
        prepare(ready, replace(QUICK, still_s=3.0), Overhead(ready, lies()), Script(on_tell=swap))


# Whatever goes wrong in any step


def at(step: str) -> Callable[[list[Event]], bool]:
    return lambda told: any(
        isinstance(e, StepProgress) and e.step == step and e.ok is None for e in told
    )


@pytest.mark.parametrize("step", ["rest", "pose", "still"])
def test_giving_up_in_each_step(ready: Fish, step: str) -> None:
    trial(ready)
    operator = Script(aborts=at(step))
    wanted = PreflightLimits(rest_s=12.0 if step == "rest" else 0.0)
    camera = Overhead(ready, lies(y_m=0.5) if step == "pose" else lies())
    with pytest.raises(GivenUp, match=step):
        prepare(ready, wanted, camera, operator)
    assert operator.refused() == [step]
    assert state_of(ready) == "IDLE"


@pytest.mark.parametrize(("step", "gone_s"), [("rest", 3.0), ("pose", 3.0), ("still", 6.0)])
def test_a_camera_that_dies_in_each_step(ready: Fish, step: str, gone_s: float) -> None:
    trial(ready)
    operator = Script()
    wanted = PreflightLimits(rest_s=12.0 if step == "rest" else 0.0)
    way = lies(y_m=0.5) if step == "pose" else lies()
    with pytest.raises(CameraGone, match="unplugged"):
        prepare(ready, wanted, Overhead(ready, way, gone_s=gone_s), operator)
    assert operator.refused() == [step]
    assert operator.texts(step)[-1].startswith("the camera is gone: the camera was unplugged")
    assert state_of(ready) == "IDLE"


@pytest.mark.parametrize("step", ["rest", "pose", "still"])
def test_a_link_that_is_lost_in_each_step(ready: Fish, step: str) -> None:
    def cut(event: Event) -> None:
        assert ready.sim is not None
        if isinstance(event, StepProgress) and event.step == step and event.ok is None:
            ready.sim.world.set_radio(False)

    trial(ready)
    wanted = PreflightLimits(rest_s=40.0 if step == "rest" else 0.0)
    camera = Overhead(ready, lies(y_m=0.5) if step == "pose" else lies())
    begin_s = ready.transport.now_s()
    with pytest.raises(LinkLostError):
        prepare(ready, wanted, camera, Script(on_tell=cut))
    assert ready.transport.now_s() - begin_s < 40.0


@pytest.mark.parametrize("seed", range(2))
def test_over_a_bad_radio(ready: Fish, spoil: Callable[..., BadRadio], seed: int) -> None:
    print(f"seed {seed}")
    trial(ready)
    spoil(ready, seed=seed, lose=0.15, damage=0.05, twice=0.1)
    operator = Script()
    found = prepare(ready, PreflightLimits(rest_s=15.0), Overhead(ready, lies()), operator)
    assert operator.passed() == ["board", "room", "rest", "pose", "still", "board"]
    assert found.rested_s is not None
    assert found.rested_s >= 15.0
    assert prepare(ready, QUICK, None, operator).drift is not None


# Reading the beginning of a file


@pytest.mark.parametrize("size", [1, 239, 240, 1024, 10**6])
def test_the_head_of_a_file(
    ready: Fish, spoil: Callable[..., BadRadio], tmp_path: Path, size: int
) -> None:
    trial(ready)
    whole = ready.pull_trial(1, tmp_path).read_bytes()
    spoil(ready, seed=2, lose=0.1, twice=0.2)
    assert ready.ftp.head("/trials/0001.ulg", size) == whole[:size]


def test_blinking_is_asked_for_by_the_third_parameter(
    ready: Fish, spoil: Callable[..., BadRadio]
) -> None:
    radio = spoil(ready)
    ready.arm(blink_s=3.5)
    ready.disarm()
    ready.arm()
    decoder = mavlink.MAVLink(None)
    sent = [message for data in radio.sent for message in decoder.parse_buffer(data) or []]
    arming = [m for m in sent if getattr(m, "command", 0) == mavlink.MAV_CMD_COMPONENT_ARM_DISARM]
    assert [(m.param1, m.param3) for m in arming] == [(1.0, 3.5), (0.0, 0.0), (1.0, 0.0)]
