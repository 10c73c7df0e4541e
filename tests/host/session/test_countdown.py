"""The countdown before a trial: told, seen at the LED, and ended in any way."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import InputError, LinkLostError, Refused
from tailbeat.core.speed_source import Frame
from tailbeat.link import _dialect as mavlink
from tailbeat.sensors.camera.led import read_led
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.sensors.camera.tracking.track import SEEN, Track
from tailbeat.sensors.camera.tracking.tracker import PATCH_SHAPE
from tailbeat.session.events import Countdown, Event
from tailbeat.session.preflight_step import GivenUp, NotReady, PreflightLimits, countdown
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera
from tailbeat.sim.world import CameraFrame

from ..conftest import BadRadio
from ..led_films import LedFilm
from ..tank_side import Script

WANTED = PreflightLimits()


def counted(operator: Script) -> list[int]:
    return [event.left_s for event in operator.told if isinstance(event, Countdown)]


def test_it_counts_whole_seconds_and_returns_armed(ready: Fish) -> None:
    at_s: list[float] = []
    operator = Script(on_tell=lambda _: at_s.append(ready.transport.now_s()))
    countdown(ready, WANTED, operator)
    assert counted(operator) == [5, 4, 3, 2, 1, 0]
    assert np.diff(at_s) == pytest.approx(np.ones(5), abs=0.11)
    assert ready.status().state == "ARMED"
    assert run_trial(ready).end == "complete"


@pytest.mark.parametrize(("countdown_s", "told"), [(0.0, [0]), (2.5, [3, 2, 1, 0])])
def test_other_lengths(ready: Fish, countdown_s: float, told: list[int]) -> None:
    operator = Script()
    countdown(ready, replace(WANTED, countdown_s=countdown_s), operator)
    assert counted(operator) == told
    assert ready.status().state == "ARMED"


@pytest.mark.parametrize("countdown_s", [-1.0, 61.0, math.nan, math.inf])
def test_lengths_that_the_led_cannot_show(ready: Fish, countdown_s: float) -> None:
    with pytest.raises(InputError):
        countdown(ready, replace(WANTED, countdown_s=countdown_s), Script())
    assert ready.status().state == "IDLE"


def test_a_long_one_keeps_the_heartbeats_up(ready: Fish) -> None:
    ready.params.set("LINK_TIMEOUT_S", 2.0)
    countdown(ready, replace(WANTED, countdown_s=20.0), Script())
    assert ready.status().state == "ARMED"
    assert ready.link.heartbeat_period_s == 1.0


@pytest.mark.parametrize("second", [5, 3, 1])
def test_giving_up_disarms(ready: Fish, second: int) -> None:
    def enough(told: list[Event]) -> bool:
        return any(event == Countdown(second) for event in told)

    operator = Script(aborts=enough)
    with pytest.raises(GivenUp):
        countdown(ready, WANTED, operator)
    assert counted(operator)[-1] == second
    assert ready.status().state == "IDLE"


@pytest.mark.parametrize("second", [5, 2, 0])
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_whatever_ends_it_disarms(ready: Fish, error: type[BaseException], second: int) -> None:
    def burst(event: Event) -> None:
        if event == Countdown(second):
            raise error

    with pytest.raises(error):
        countdown(ready, WANTED, Script(on_tell=burst))
    assert ready.status().state == "IDLE"
    assert ready.link.heartbeat_period_s == 1.0


def test_ctrl_c_while_the_board_says_yes(ready: Fish, spoil: Callable[..., BadRadio]) -> None:
    """It may be armed already, and is not afterwards."""
    radio = spoil(ready)

    def interrupt(data: bytes) -> bool:
        if b"\x90\x01" in data and not struck:  # 400, the command's number
            struck.append(data)
            BadRadio.write(radio, data)
            ready.link.run(0.3)
            raise KeyboardInterrupt
        return True

    struck: list[bytes] = []
    radio.on_write = interrupt
    with pytest.raises(KeyboardInterrupt):
        countdown(ready, WANTED, Script())
    assert struck
    assert ready.status().state == "IDLE"


def test_a_lost_link_is_told_and_the_board_disarms_itself(ready: Fish) -> None:
    def cut(event: Event) -> None:
        assert ready.sim is not None
        if event == Countdown(3):
            ready.sim.world.set_radio(False)

    operator = Script(on_tell=cut)
    begin_s = ready.transport.now_s()
    with pytest.raises((LinkLostError, NotReady)):
        countdown(ready, WANTED, operator)
    assert ready.transport.now_s() - begin_s < 40.0
    assert "may still be armed" in operator.notices()
    assert ready.sim is not None
    ready.sim.world.set_radio(True)
    ready.link.run(2.0)
    assert ready.status().state == "IDLE"


def test_giving_up_without_a_link_is_bounded(ready: Fish) -> None:
    def cut(event: Event) -> None:
        assert ready.sim is not None
        if event == Countdown(3):
            ready.sim.world.set_radio(False)

    operator = Script(aborts=lambda told: any(event == Countdown(2) for event in told), on_tell=cut)
    begin_s = ready.transport.now_s()
    with pytest.raises(GivenUp):
        countdown(ready, WANTED, operator)
    assert ready.transport.now_s() - begin_s < 10.0
    assert "may still be armed" in operator.notices()


def test_a_board_that_somebody_else_disarms(ready: Fish) -> None:
    def other(event: Event) -> None:
        if event == Countdown(4):
            ready.disarm()

    operator = Script(on_tell=other)
    with pytest.raises(NotReady, match="not armed any more"):
        countdown(ready, WANTED, operator)
    assert counted(operator)[-1] >= 2  # at once, not at the end


def test_a_board_that_does_not_arm_is_left_alone(
    ready: Fish, spoil: Callable[..., BadRadio]
) -> None:
    """Another host may be swimming with it: a disarm would stop that."""
    ready.arm()
    other = Fish(ready.transport)
    run_trial(other)
    assert ready.status().pending_trial == 1
    radio = spoil(ready)
    with pytest.raises(Refused, match="neither learned nor discarded"):
        countdown(ready, WANTED, Script())
    sent = mavlink.MAVLink(None).parse_buffer(b"".join(radio.sent)) or []
    arming = [m for m in sent if getattr(m, "command", 0) == mavlink.MAV_CMD_COMPONENT_ARM_DISARM]
    assert {m.param1 for m in arming} == {1.0}


def test_an_empty_battery_is_the_boards_to_refuse(ready: Fish) -> None:
    assert ready.sim is not None
    ready.sim.world.set_battery_v(6.0)
    ready.link.run(1.0)
    with pytest.raises(Refused) as raised:
        countdown(ready, WANTED, Script())
    assert raised.value.name == "BATTERY_LOW"
    assert ready.status().state == "IDLE"


@pytest.mark.parametrize("seed", range(3))
def test_over_a_bad_radio(ready: Fish, spoil: Callable[..., BadRadio], seed: int) -> None:
    print(f"seed {seed}")
    spoil(ready, seed=seed, lose=0.2, damage=0.05, twice=0.1)
    operator = Script()
    countdown(ready, WANTED, operator)
    assert counted(operator) == [5, 4, 3, 2, 1, 0]
    with pytest.raises(GivenUp):
        countdown(ready, WANTED, Script(aborts=lambda told: len(told) > 2))
    assert ready.status().state == "IDLE"


# The LED


def lit(frames: list[CameraFrame], from_s: float, until_s: float) -> list[bool]:
    """In pictures of nearly no exposure."""
    return [frame.led > 0.5 for frame in frames if from_s <= frame.time_s < until_s]


def watched(fish: Fish) -> SimulatedCamera:
    camera = default_camera(fish)
    assert isinstance(camera, SimulatedCamera)
    return camera


def test_the_led_blinks_until_zero_and_is_lit_then(reference: bytes) -> None:
    options = {"camera_fps": 50.0, "camera_exposure_s": 0.001, "camera_lost": 0.0}
    with Fish.connect("sim:tank?seed=1", **options) as fish:
        fish.upload_reference(reference)
        camera = watched(fish)
        fish.link.run(1.0)
        begin_s = fish.transport.now_s()
        countdown(fish, WANTED, Script())
        zero_s = fish.transport.now_s()
        fish.link.run(2.0)
        frames = camera.moments()
    assert not any(lit(frames, begin_s - 0.8, begin_s))
    blinking = lit(frames, begin_s + 0.1, zero_s - 0.3)
    edges = sum(a != b for a, b in pairwise(blinking))
    assert 21 <= edges <= 24  # 2.5 Hz
    assert 0.4 < np.mean(blinking) < 0.6
    assert all(lit(frames, zero_s, zero_s + 1.8))


@pytest.mark.parametrize("again", [False, True])
def test_arming_without_a_countdown_lights_it_at_once(reference: bytes, again: bool) -> None:
    with Fish.connect("sim:tank?seed=1", camera_lost=0.0) as fish:
        fish.upload_reference(reference)
        camera = watched(fish)
        if again:  # what was asked for before is forgotten
            fish.arm(blink_s=60.0)
            fish.disarm()
        fish.arm()
        begin_s = fish.transport.now_s()
        fish.link.run(3.0)
        assert all(lit(camera.moments(), begin_s + 0.1, begin_s + 2.5))


def track_of(frames: list[CameraFrame], fps: float, seed: int) -> Track:
    """What tracking a film of it would leave: the LED in one of the places, among noise."""
    rng = np.random.default_rng(seed)
    patch = rng.uniform(20, 60, PATCH_SHAPE) + rng.normal(0, 4, (len(frames), *PATCH_SHAPE))
    patch[:, 6, 20] += 100 * np.array([frame.led for frame in frames])
    t_s = np.array([frame.time_s for frame in frames])
    nothing = np.zeros(len(frames))
    state = np.full(len(frames), SEEN, np.uint8)
    levels = np.clip(patch, 0, 255).astype(np.uint8)
    return Track(t_s, nothing, nothing, nothing, nothing + 1, state, fps, "film.mp4", levels)


@pytest.mark.parametrize("at_once", [False, True])
def test_the_code_is_found_behind_a_countdown(at_once: bool) -> None:
    """The board's own LED under the simulated camera; ``at_once``: the trial cuts the blinking."""
    beats, fps = 12, 25.0
    with Fish.connect("sim:tank?seed=5", camera_fps=fps) as fish:
        fish.upload_reference(records.encode_reference(1.0, np.full(beats, 0.04)))
        camera = watched(fish)
        if at_once:
            fish.arm(blink_s=30.0)
            fish.link.run(7.3)
        else:
            countdown(fish, replace(WANTED, countdown_s=10.0), Script())
        outcome = run_trial(fish, _Off())
        assert outcome.end == "complete"
        fish.link.run(1.0)
        begin_s = _start_s(fish, outcome.number)
        frames = camera.moments()
    reading = read_led(track_of(frames, fps, 3), float(beats))
    error_s = reading.begin_s - begin_s
    print(f"{error_s * 1e3:+.1f} ms, sigma {reading.sigma_s * 1e3:.1f}, ahead {reading.ahead:.0f}")
    assert reading.number == outcome.number
    assert abs(error_s) < 0.010
    assert abs(error_s) < 3 * reading.sigma_s


class _Off:
    """A camera that leaves the board's pictures where they are."""

    clock: Literal["host", "board"] = "host"
    fps = 25.0

    def frames(self) -> list[Frame]:
        return []

    def close(self) -> None:
        """Nothing to give up."""


def _start_s(fish: Fish, trial: int) -> float:
    """In simulated time."""
    from tailbeat.core.trial_file import parse_trial

    assert fish.sim is not None
    booted_s = fish.sim.time_s - fish.sim.board_time_s
    head = fish.ftp.head(f"/trials/{trial:04d}.ulg", 1024)
    return parse_trial(head).start_us * 1e-6 + booted_s


@pytest.mark.parametrize(("length", "films"), [(True, 2), (False, 1)])
def test_hard_films_with_a_countdown_in_them(length: bool, films: int) -> None:
    """Half hidden, one picture in ten lost, glare; a countdown of 10 s before the trial."""
    film = LedFilm(before_s=12.0, blink_s=10.0, swim_s=20.0)
    worst_s = 0.0
    for seed in range(films):
        track, start_s = replace(film, number=53 + seed).make(seed)
        found = read_led(track, film.swim_s if length else None)
        assert found.number == 53 + seed
        worst_s = max(worst_s, abs(found.begin_s - start_s))
    print(f"worst {worst_s * 1e3:.1f} ms")
    assert worst_s < 0.010
