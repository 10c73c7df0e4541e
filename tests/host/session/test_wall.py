"""The guard of the walls: frames in, a reason to abort out; and through the whole firmware."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.reference import thesis
from tailbeat.core.speed_source import CameraGone, Frame, TrackReset, Unseen
from tailbeat.core.trial_file import read_trial
from tailbeat.link.messages import BeatEvent
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.session.events import Event, TrialStopped
from tailbeat.session.guards import LENGTH_M, NOSE_M, TOUCH_M_S, WallGuard
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial

FPS = 25.0
TANK = ((-0.5, -0.9), (2.5, -0.9), (2.5, 0.9), (-0.5, 0.9))  # the thesis's; start 0.5 m from a wall


def calibration(corners: tuple[tuple[float, float], ...] | None = TANK) -> Calibration:
    area = None if corners is None else np.array(corners, dtype=np.float64)
    return Calibration((1280, 720), np.eye(3), np.zeros(5), np.eye(3), area_m=area)


def beat(number: int, reference_m_s: float = 0.0) -> BeatEvent:
    return BeatEvent(1, number, 0.4, reference_m_s, None, None, 0, False, True)


def way(
    speed_m_s: float,
    course_rad: float = 0.0,
    seconds: float = 40.0,
    start: tuple[float, float] = (0.0, 0.0),
    t0: float = 100.0,
    sway_rad: float = 0.17,
    noise_m: float = 1e-3,
) -> list[Frame]:
    """A straight way; the body sways as a swimming fish's does, and stays in line."""
    rng = np.random.default_rng(4)
    frames = []
    for k in range(round(seconds * FPS)):
        t = k / FPS
        x, y = rng.normal(0, noise_m, 2)
        frames.append(
            Frame(
                t0 + t,
                start[0] + speed_m_s * t * math.cos(course_rad) + x,
                start[1] + speed_m_s * t * math.sin(course_rad) + y,
                course_rad + sway_rad * math.sin(math.tau * t),
            )
        )
    return frames


def stopping(speed_m_s: float, kappa_per_m: float = 10.0) -> float:
    """Half a second at full speed, then drag alone, dv/dx = -kappa v, down to 0.01 m/s."""
    way_m, v = 0.5 * speed_m_s, speed_m_s
    while v > 0.01:
        way_m, v = way_m + v * 1e-3, v - kappa_per_m * v * v * 1e-3
    return way_m


def stop(guard: WallGuard, frames: list[Frame]) -> tuple[Frame, StopReason] | None:
    for frame in frames:
        if reason := guard(frame):
            return frame, reason
    return None


@pytest.mark.parametrize("kappa_per_m", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("speed", [0.02, 0.04, 0.08, 0.12])
def test_the_nose_stops_where_it_can_just_still_stop(speed: float, kappa_per_m: float) -> None:
    guard = WallGuard(calibration(), kappa_per_m=kappa_per_m)
    found = stop(guard, way(speed, seconds=2.5 / speed))
    assert found is not None
    frame, reason = found
    left_m = 2.5 - (frame.x_m + NOSE_M)
    assert left_m == pytest.approx(stopping(speed, kappa_per_m), abs=0.02)
    assert reason.kind is StopKind.WALL


@pytest.mark.parametrize("speed", [0.02, 0.04, 0.08, 0.12])
def test_a_zone_that_is_given_goes_with_the_speed(speed: float) -> None:
    found = stop(WallGuard(calibration(), 0.25), way(speed, seconds=2.5 / speed))
    assert found is not None
    left_m = 2.5 - (found[0].x_m + NOSE_M)
    assert left_m == pytest.approx(0.25 * speed / 0.08, abs=0.02)


def test_every_wall_and_either_order_of_the_corners() -> None:
    for corners in (TANK, TANK[::-1]):
        for quarter in range(4):
            course = quarter * math.pi / 2
            found = stop(WallGuard(calibration(corners)), way(0.08, course, start=(1.0, 0.0)))
            assert found is not None
            frame, _ = found
            room_m = (1.5, 0.9, 1.5, 0.9)[quarter]
            gone_m = math.hypot(frame.x_m - 1.0, frame.y_m)
            assert room_m - gone_m - NOSE_M == pytest.approx(stopping(0.08), abs=0.02), course


def test_a_fish_that_drifts_backwards_stops_before_its_tail_touches() -> None:
    drift = [Frame(f.t_s, -f.x_m, f.y_m, f.heading_rad) for f in way(0.04)]
    found = stop(WallGuard(calibration()), drift)
    assert found is not None
    left_m = 0.5 + found[0].x_m - (LENGTH_M - NOSE_M)
    assert left_m == pytest.approx(stopping(0.04), abs=0.02)


def test_what_does_not_come_closer_is_no_danger() -> None:
    rest_m = LENGTH_M - NOSE_M + 0.01  # the tail a centimetre from the wall behind
    start = way(0.0, seconds=5, start=(-0.5 + rest_m, 0.0))
    off = way(0.08, seconds=10, start=(-0.5 + rest_m, 0.0), t0=105.0)
    assert stop(WallGuard(calibration()), start + off) is None
    along = way(0.08, seconds=20, start=(0.0, 0.84))
    assert stop(WallGuard(calibration()), along) is None
    slow = way(0.8 * TOUCH_M_S, seconds=60, start=(2.0, 0.0))
    assert stop(WallGuard(calibration()), slow) is None


def test_without_walls_or_with_no_zone_it_never_stops() -> None:
    for guard in (WallGuard(calibration(None)), WallGuard(calibration(), zone_m=0.0)):
        assert stop(guard, way(0.08)) is None
        assert guard(CameraGone("unplugged")) is None
        assert [guard(beat(k, 0.08)) for k in range(40)] == [None] * 40
        assert [guard(Unseen(140.0 + k)) for k in range(40)] == [None] * 40


def test_a_wider_zone_stops_earlier() -> None:
    near = stop(WallGuard(calibration(), 0.1), way(0.08))
    far = stop(WallGuard(calibration(), 0.4), way(0.08))
    assert near is not None and far is not None
    assert near[0].x_m - far[0].x_m == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("wrong", [1, 2])
def test_wrong_detections_are_not_believed(wrong: int) -> None:
    frames = way(0.08, seconds=20)
    for k in range(50, 480, 7):
        for i in range(k, k + wrong):
            frames[i] = Frame(frames[i].t_s, 2.4, 0.85, 0.0)
    assert stop(WallGuard(calibration()), frames) is None
    flipped = [
        Frame(f.t_s, f.x_m, f.y_m, f.heading_rad + (math.pi if k % 7 == 3 else 0))
        for k, f in enumerate(way(0.08, seconds=20))
    ]
    assert stop(WallGuard(calibration()), flipped) is None


def test_a_jump_is_believed_when_three_pictures_say_the_same() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.08, seconds=10)) is None
    moved = way(0.08, seconds=5, start=(2.15, 0.0), t0=110.0)
    found = stop(guard, moved)
    assert found is not None and found[0] is moved[2]


def test_jumps_that_agree_with_nothing_are_never_believed() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.08, seconds=10)) is None
    rng = np.random.default_rng(1)
    scattered = [
        Frame(110 + k / FPS, 1.8 + 0.6 * (k % 2), rng.uniform(-0.8, 0.8), 0.0) for k in range(12)
    ]
    assert stop(guard, scattered) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_senseless_frames_are_ignored(bad: float) -> None:
    guard = WallGuard(calibration())
    frames = way(0.08, seconds=10)
    senseless = [Frame(bad, 2.4), Frame(105.0, bad), Frame(105.0, 2.4, bad), frames[100]]
    assert stop(guard, [*frames[:200], *senseless, *frames[200:]]) is None
    assert guard("something else") is None


def unseen(
    guard: WallGuard, reference_m_s: float, since_s: float, beat_s: float = 1.0
) -> tuple[float, str] | None:
    """How many seconds after the last picture, at ``since_s``, it stops the fish."""
    assert guard(beat(0, reference_m_s)) is None
    for k in range(1, 2000):
        if reason := guard(Unseen(since_s + k * 0.02)):
            return k * 0.02, reason
        if k % (50 * beat_s) == 0:
            assert guard(beat(k, reference_m_s)) is None
    return None


@pytest.mark.parametrize("beat_s", [0.5, 1.0, 4.0])
def test_an_unseen_fish_is_taken_to_swim_on(beat_s: float) -> None:
    guard = WallGuard(calibration(), beat_s=beat_s)
    frames = way(0.08, seconds=12.5, sway_rad=0)
    assert stop(guard, frames) is None  # the nose at 1.2 m: 1.05 m to the zone, 13.1 s
    found = unseen(guard, 0.05, frames[-1].t_s, beat_s)
    assert found is not None
    assert found[0] == pytest.approx(13.1, abs=0.3) and found[1].kind is StopKind.WALL
    assert "not seen" in found[1].text


def test_with_slow_beats_an_unseen_fish_does_not_come_closer_than_a_seen_one() -> None:
    """The last picture is just outside the zone: 0.3 m away, 0.62 s before the line is crossed."""
    guard = WallGuard(calibration(), beat_s=4.0)
    frames = way(0.08, seconds=25.0, sway_rad=0)
    assert stop(guard, frames) is None
    found = unseen(guard, 0.08, frames[-1].t_s, 4.0)
    assert found is not None and found[0] == pytest.approx(0.7, abs=0.2)


def test_an_unseen_fish_is_as_fast_as_it_should_be() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.0, seconds=2.0)) is None
    found = unseen(guard, 0.08, 102.0)  # 2.3 m from the nose: 2.05 m to the zone, 25.6 s
    assert found is not None and found[0] == pytest.approx(25.6 + 1, abs=0.3)


def test_what_was_swum_unseen_stays_swum_when_the_fish_should_slow_down() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.0, seconds=2.0)) is None
    assert guard(beat(0, 0.08)) is None
    assert [guard(Unseen(102 + k * 0.1)) for k in range(250)] == [None] * 250  # 1.9 m of 2.05
    assert guard(beat(1, 0.02)) is None
    late = next(k for k in range(2000) if guard(Unseen(127 + k * 0.1)))
    assert late * 0.1 == pytest.approx((2.3 - 1.92 - stopping(0.02)) / 0.02, abs=1.0)


def test_between_two_pictures_a_slow_fish_may_be_where_a_fast_one_may_not() -> None:
    guard = WallGuard(calibration())
    assert guard(beat(0, 0.08)) is None
    for frame in way(0.02, seconds=8, start=(2.0, 0.0), noise_m=1e-4):
        assert guard(frame) is None
        assert guard(Unseen(frame.t_s + 0.02)) is None


def test_seen_again_all_is_well() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.08, seconds=12.5)) is None
    assert guard(beat(0, 0.08)) is None
    assert [guard(Unseen(112.5 + k)) for k in range(10)] == [None] * 10
    assert guard(Frame(123.0, 0.9, 0.0, 0.0)) is None
    assert [guard(Unseen(123.0 + k)) for k in range(10)] == [None] * 10


def test_a_picture_that_is_not_believed_shows_no_fish() -> None:
    """The detector sees reflections, now here, now there."""
    guard = WallGuard(calibration())
    frames = way(0.08, seconds=22.5, sway_rad=0)
    assert stop(guard, frames) is None  # the nose at 2.0 m: 0.25 m to the zone, 3.1 s
    wrong = [Frame(122.5 + k / FPS, -0.4, (-0.8, 0.8)[k % 2], 0.0) for k in range(100)]
    found = stop(guard, wrong)
    assert found is not None and found[0].t_s - 122.5 == pytest.approx(3.1, abs=0.3)


def test_what_is_afresh_forgets_the_swim_before() -> None:
    guard = WallGuard(calibration())
    assert stop(guard, way(0.08, seconds=20)) is None
    assert guard(TrackReset()) is None
    assert guard(Unseen(300.0)) is None
    assert stop(guard, way(0.02, seconds=5, t0=300.1)) is None


@pytest.mark.parametrize("beat_s", [1.0, 4.0])
def test_a_guard_that_sees_nothing_is_none(beat_s: float) -> None:
    guard = WallGuard(calibration(), beat_s=beat_s)
    reasons = [guard(Unseen(50.0 + k * 0.1)) for k in range(30)]
    blind = next(k for k, reason in enumerate(reasons) if reason)
    assert blind == pytest.approx(20, abs=1)
    assert reasons[blind].kind is StopKind.CAMERA
    assert guard(Unseen(math.nan)) is None
    gone = WallGuard(calibration())(CameraGone("unplugged"))
    assert gone is not None and gone.kind is StopKind.CAMERA


@pytest.mark.parametrize("beat_s", [0.3, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("begin_s", [0.0, 0.25, 0.5, 0.75])
def test_sway_is_no_speed(beat_s: float, begin_s: float) -> None:
    """A fish that rests, or swims along a wall 2 cm away, and sways by 1 cm; from any phase on."""
    for speed in (0.0, 0.08):
        frames = way(speed, seconds=12, start=(0.0, 0.87), noise_m=1e-4, sway_rad=0.1)
        swaying = [
            Frame(f.t_s, f.x_m, f.y_m + 0.01 * math.sin(phase), 0.1 * math.sin(phase))
            for f in frames
            for phase in [math.tau * ((f.t_s - 100) / beat_s + begin_s)]
        ]
        assert stop(WallGuard(calibration(), beat_s=beat_s), swaying) is None


def amplitudes(wanted_m_s: np.ndarray) -> np.ndarray:
    """What the tank's fish needs for it."""
    return np.where(wanted_m_s > 0.002, np.clip(0.197 + wanted_m_s / 0.219, 0, 0.785), 0)


def set_out(fish: Fish, speed_m_s: np.ndarray) -> None:
    fish.params.set("TANK_LEN_M", 0)
    fish.params.set("DU_MAX_RAD", 0)
    fish.upload_reference(records.encode_reference(1.0, speed_m_s))
    fish.upload_amplitudes(amplitudes(speed_m_s).astype(np.float32))


FAST = np.concatenate([[0.03, 0.06], np.full(30, 0.095)])


@pytest.mark.parametrize("kappa_per_m", [5, 10, 20])
def test_the_fish_is_stopped_and_hardly_touches(kappa_per_m: float, tmp_path: Path) -> None:
    """In a tank of 2 m; nobody catches the fish, it coasts until it is there."""
    touch_m_s = 0.012
    room = ((-0.5, -0.9), (1.5, -0.9), (1.5, 0.9), (-0.5, 0.9))
    with Fish.connect("sim:tank", seed=2, kappa_per_m=kappa_per_m, caught_after_s=90) as fish:
        assert fish.sim is not None
        set_out(fish, FAST)
        events: list[Event] = []
        guard = WallGuard(calibration(room), kappa_per_m=kappa_per_m)
        outcome = run_trial(fish, on_event=events.append, guard=guard)
        assert outcome.end == "aborted:WALL"
        reasons = [event.reason for event in events if isinstance(event, TrialStopped)]
        assert len(reasons) == 1 and reasons[0].kind is StopKind.WALL
        while (truth := fish.sim.world.truth()).x_m + NOSE_M < 1.5 and truth.v_m_s > 0.004:
            fish.sim.run(0.1)
        assert truth.v_m_s < touch_m_s

        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
        measured = np.isfinite(trial.beats.speed_m_s)
        recorded = outcome.executed_beats
        assert measured[1 : recorded - 2].all()
        assert not measured[recorded - 1 :].any()  # GUARD_BEATS = 1
        fish.clear()
        assert fish.learn(outcome.number).measured_beats == measured.sum()


def test_the_tail_stops_within_a_beat() -> None:
    with Fish.connect("sim:tank", seed=2) as fish:
        assert fish.sim is not None
        board = fish.sim
        set_out(fish, FAST)
        guard, since = WallGuard(calibration(((-0.5, -1), (1.2, -1), (1.2, 1), (-0.5, 1)))), []

        def watch(what: object) -> StopReason | None:
            reason = guard(what)
            if reason and not since:
                since.append(board.time_s)
            return reason

        def look(_: object) -> None:
            if not board.world.truth().swimming and len(since) == 1:
                since.append(board.time_s)
                assert abs(board.world.truth().tail_rad) < 2e-3

        fish.link.subscribe(look)
        assert run_trial(fish, guard=watch).end == "aborted:WALL"
        assert since[1] - since[0] < 1.0


def test_the_thesis_s_own_swim_fits_into_its_tank() -> None:
    """Its nose ends a hand's breadth from the far wall; also when it is 15 % too fast."""
    for scale in (1.0, 1.15):
        with Fish.connect("sim:tank", seed=1) as fish:
            set_out(fish, thesis().speed_m_s * scale)
            events: list[Event] = []
            outcome = run_trial(fish, on_event=events.append, guard=WallGuard(calibration()))
            assert outcome.end == "complete", events
