"""Guards that are no walls: the tank's length, a key, several at once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, cosine, thesis
from tailbeat.core.speed_source import CameraGone, Frame, TrackReset, Unseen
from tailbeat.link.messages import BeatEvent
from tailbeat.session.guards import DistanceGuard, FrameRecorder, all_guards, guards_of, stop_when
from tailbeat.session.outcome import BY_HAND, StopKind, StopReason
from tailbeat.session.travel import guarded_trial, travel_next
from tailbeat.session.trial import run_trial

ROOM_M = 3.0 - 0.36


def beat(number: int, speed: float | None, provisional: bool = True) -> BeatEvent:
    return BeatEvent(1, number, 0.5, 0.1, speed, 0.001, 25, False, provisional)


def stopped_at(guard: DistanceGuard, speeds: list[float | None]) -> int | None:
    return next((k for k, v in enumerate(speeds) if guard(beat(k, v))), None)


def test_it_stops_where_the_fish_can_just_still_stop() -> None:
    """0.1 m/s: the last beat heard of ended 2 s ago, the next one is heard of in 1 s, 0.5 s until
    the tail rests, ln(10)/10 m of coast: 0.58 m."""
    for room_m in (1.0, 2.0, 2.64):
        guard = DistanceGuard(room_m)
        at = stopped_at(guard, [0.1] * 40)
        assert at is not None
        assert room_m - 0.58 - 0.1 < (at + 1) * 0.1 <= room_m - 0.58 + 0.1 + 1e-9


def test_less_drag_and_later_speeds_stop_it_earlier() -> None:
    usual = stopped_at(DistanceGuard(2.64), [0.1] * 40)
    assert usual is not None
    coasting = stopped_at(DistanceGuard(2.64, kappa_per_m=5.0), [0.1] * 40)
    late = stopped_at(DistanceGuard(2.64, late_s=4.0), [0.1] * 40)
    assert coasting == usual - 2 and late == usual - 2
    assert stopped_at(DistanceGuard(2.64, beat_s=2.0), [0.1] * 40) == pytest.approx(
        usual / 2, abs=1
    )


def test_the_reason_says_how_far() -> None:
    guard = DistanceGuard(1.0)
    reason = next(r for k in range(20) if (r := guard(beat(k, 0.1))))
    assert reason.kind is StopKind.DISTANCE and "1.00 m" in reason.text


@pytest.mark.parametrize("room_m", [0.0, math.inf])
def test_a_tank_that_is_not_checked(room_m: float) -> None:
    assert stopped_at(DistanceGuard(room_m), [0.2] * 300) is None


def test_a_beat_without_a_speed_counts_as_the_last() -> None:
    known = stopped_at(DistanceGuard(1.5), [0.1] * 40)
    assert stopped_at(DistanceGuard(1.5), [0.1] * 4 + [None] * 36) == known
    guard = DistanceGuard(1.5)  # beats that never came over the wire
    assert [guard(beat(k, 0.1)) for k in (0, 1)] == [None, None]
    assert guard(beat(9, 0.1)) is not None and guard.way_m == pytest.approx(1.0)


def test_a_beat_that_is_said_again_counts_once() -> None:
    guard = DistanceGuard(9.0)
    for k in range(3):
        assert guard(beat(k, 0.1)) is None and guard(beat(k, 0.1, provisional=False)) is None
    assert guard.way_m == pytest.approx(0.3)


def test_afresh_begins_anew_and_all_else_is_ignored() -> None:
    guard = DistanceGuard(1.0)
    assert stopped_at(guard, [0.1] * 3) is None
    assert guard(TrackReset()) is None and guard.way_m == 0
    assert stopped_at(guard, [0.1] * 3) is None
    for what in (Frame(1.0, 9.0), Unseen(9.0), CameraGone("x"), "x"):
        assert guard(what) is None


def test_a_swim_that_will_come_to_rest_in_time_is_let_swim() -> None:
    """2.5 m at 0.1 m/s and then nothing: nobody could stop it in time, and nobody need."""
    speeds: list[float | None] = [*[0.1] * 25, 0.04, 0.01, 0.0]
    planned = np.array(speeds, dtype=float)
    assert stopped_at(DistanceGuard(2.64), speeds) is not None
    assert stopped_at(DistanceGuard(2.64, planned_m_s=planned), speeds) is None
    faster = [1.1 * v for v in planned]
    at = stopped_at(DistanceGuard(2.64, planned_m_s=planned), list(faster))
    plain = stopped_at(DistanceGuard(2.64), list(faster))
    assert at is not None and at == plain


def test_a_plan_that_rises_stops_it_before_it_is_fast() -> None:
    planned = np.r_[np.full(10, 0.1), np.full(20, 0.2)]
    guard = DistanceGuard(1.8, planned_m_s=planned)
    at = stopped_at(guard, [float(v) for v in planned])
    slow = stopped_at(DistanceGuard(1.8), [float(v) for v in planned])
    assert at is not None and slow is not None and at < slow


def test_together_all_see_everything_and_the_first_reason_counts() -> None:
    seen: list[object] = []

    def look(what: object) -> StopReason | None:
        seen.append(what)
        return None

    one, two = StopReason(StopKind.CALLER, "one"), StopReason(StopKind.CALLER, "two")
    guard = all_guards(None, lambda _: one, look, lambda _: two)
    assert guard("x") == one and seen == ["x"]
    assert all_guards(None, None)("x") is None


def test_when() -> None:
    pressed = [False]
    guard = stop_when(lambda: pressed[0], BY_HAND)
    assert guard("x") is None
    pressed[0] = True
    assert guard("x") == BY_HAND


def test_seen_keeps_the_frames_of_this_swim() -> None:
    seen = FrameRecorder()
    seen(Frame(1.0, 0.5))
    seen(TrackReset())
    assert seen(Frame(102.0, 0.1, -0.2, 0.3)) is None and seen("x") is None
    assert seen.frames == [Frame(102.0, 0.1, -0.2, 0.3)]


# -- with a fish ----------------------------------------------------------------------------------


def recorded(
    reference: Reference, seed: int, stronger: float, kappa_per_m: float = 10.0
) -> tuple[str, float]:
    """(how it ended, how far it came until it was slower than 0.01 m/s). The amplitudes are those
    that a usual fish needs; nobody catches this one."""
    with Fish.connect(
        "sim:tank",
        seed=seed,
        caught_after_s=0,
        placed_after_s=0,
        kappa_per_m=kappa_per_m,
        slope_m_s_rad=0.219 * stronger,
    ) as fish:
        assert fish.sim is not None
        fish.params.set("DU_MAX_RAD", 0)
        fish.params.set("AMP_MAX_RAD", 0.785)
        fish.upload_reference(reference.record())
        wanted = reference.speed_m_s
        amplitude = np.where(wanted > 0.002, np.clip(0.197 + wanted / 0.219, 0, 0.785), 0)
        fish.upload_amplitudes(amplitude.astype(np.float32))
        travel_next(fish, None).require_room()
        end = run_trial(fish, guard=guards_of(guarded_trial(fish, None))).end
        while fish.sim.world.truth().v_m_s > 0.01:
            fish.sim.run(0.1)
        return end, fish.sim.world.truth().x_m


def check_stronger(seeds: range, kappas: tuple[float, ...]) -> None:
    for kappa in kappas:
        for reference in (thesis(), cosine(0.11, 16, 3)):
            found = [recorded(reference, seed, 1.4, kappa) for seed in seeds]
            ways = [way_m for _, way_m in found]
            print(f"kappa {kappa:g}, {reference.beats} beats: {min(ways):.3f} to {max(ways):.3f} m")
            assert {end for end, _ in found} == {"aborted:ABORT_COMMAND"}
            assert max(ways) <= ROOM_M  # the nose is at the wall at 3.00 m


def check_fitting(seeds: range) -> None:
    faster = Reference(1.0, (thesis().speed_m_s * 1.1).astype(np.float32), "faster")
    for reference in (faster, cosine(0.11, 20, 2)):
        found = [recorded(reference, seed, 1.0) for seed in seeds]
        print(f"{reference.travel_m:.2f} m: up to {max(way_m for _, way_m in found):.3f} m")
        assert [end for end, way_m in found if way_m <= ROOM_M and end != "complete"] == []


def test_a_fish_that_is_stronger_than_believed_stops_before_the_end() -> None:
    """By 40 %, with the drag that is believed and with half of it."""
    check_stronger(range(1, 3), (5.0, 10.0))


def test_a_swim_that_fits_is_never_stopped() -> None:
    check_fitting(range(1, 3))


@pytest.mark.soak
def test_twenty_fish() -> None:
    check_stronger(range(1, 21), (5.0, 10.0, 20.0))
    check_fitting(range(1, 21))
