"""The LED of the real image, at its pin and in the camera's pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.native import lib
from tailbeat.core.speed_source import Frame
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from tailbeat.sim.world import CameraFrame
from vboard.core.clock import TICKS_PER_US
from vboard.periph.pins import PinTrace

NewBoard = Callable[..., EmulatedBoard]
Connect = Callable[[EmulatedBoard], Fish]

LED_PIN, SERVO_PIN, SERVO_CHANNEL = 27, 21, 4  # PB27, PC21
BEATS, FRAMES_PER_BEAT = 6, 50  # more than one block of the code
CAMERA_FPS, EXPOSURE_S = 24.0, 0.03
AT_ONCE_US = 10_000.0  # of the main loop and the tick
TICK_US = 20_000.0


class Unwatched:
    """A camera that gives nothing, so that the board's pictures stay where they are."""

    clock: Literal["host", "board"] = "host"
    fps = CAMERA_FPS

    def frames(self) -> list[Frame]:
        return []

    def close(self) -> None:
        """Nothing to give up."""


@dataclass(frozen=True)
class Seen:
    """A trial and what came before. Times in us since power-on; ``edges``: when the LED went on,
    off, on, ...; ``frames``: begin of each servo frame with a pulse; (time, armed) of orders."""

    trial: int
    edges: list[float]
    frames: list[float]
    orders: list[tuple[float, bool]]
    pictures: list[CameraFrame]
    origin_us: float

    def lit(self, time_us: float) -> bool:
        """Whether it is on."""
        return sum(edge <= time_us for edge in self.edges) % 2 == 1

    def lit_part(self, begin_us: float, end_us: float) -> float:
        """Part of that time in which it is on."""
        on_us = 0.0
        for on, off in zip(self.edges[::2], [*self.edges[1::2], np.inf], strict=False):
            on_us += max(0.0, min(off, end_us) - max(on, begin_us))
        return on_us / (end_us - begin_us)


@pytest.fixture(scope="module")
def seen(image: Path) -> Seen:
    """Armed, disarmed, armed and swum, all under the camera."""
    board = EmulatedBoard(image, camera_fps=CAMERA_FPS, camera_exposure_s=EXPOSURE_S)
    led = PinTrace(board.board.clock, LED_PIN)
    servo = PinTrace(board.board.clock, SERVO_PIN, SERVO_CHANNEL)
    periph = board.board.periph
    led.connect(periph["PIOB"])
    servo.connect(periph["PIOC"], periph["PWM"])
    transport = SimTransport(board)
    assert hear_board(transport) is not None
    orders: list[tuple[float, bool]] = []
    pictures = board.camera_frames()
    with Fish(transport) as fish:
        fish.clock.sync()
        fish.params.set("SPD_SOURCE", 1.0)
        fish.upload_reference(records.encode_reference(1.0, np.full(BEATS, 0.05, np.float32)))
        fish.upload_amplitudes(np.full(BEATS, 0.4))
        for armed in (True, False, True):
            (fish.arm if armed else fish.disarm)()
            orders.append((board.board.clock.now / TICKS_PER_US, armed))
            board.run(0.3)
            pictures += board.camera_frames()
        outcome = run_trial(fish, Unwatched())
        assert outcome.end == "complete"
    board.run(1.0)
    pictures += board.camera_frames()
    return Seen(
        outcome.number,
        [time / TICKS_PER_US for time, _ in led.edges[2:]],  # the pull-up, then driven low
        [pulse.start / TICKS_PER_US for pulse in servo.pulses()[1:]],
        orders,
        pictures,
        board.config["boot_s"] * 1e6,
    )


def test_led_is_off_until_armed_and_follows_it(seen: Seen) -> None:
    on_us, off_us, on_again_us = (time for time, _ in seen.orders)
    for edge, ordered in zip(seen.edges, (on_us, off_us, on_again_us), strict=False):
        assert ordered - TICK_US - AT_ONCE_US < edge < ordered + TICK_US + AT_ONCE_US
    swim_us = seen.frames[0]
    assert seen.edges[3] == pytest.approx(swim_us, abs=20)


def test_led_shows_the_code_while_it_swims(seen: Seen) -> None:
    trial = seen.frames[: BEATS * FRAMES_PER_BEAT]
    shown = [seen.lit(begin + TICK_US / 2) for begin in trial]
    assert shown == [lib.blink_on(frame, seen.trial) for frame in range(len(trial))]
    late_us = [
        min(abs(edge - begin) for edge in seen.edges)
        for n, begin in enumerate(trial)
        if n > 0 and shown[n] != shown[n - 1]
    ]
    print(f"largest delay of an edge after its frame's begin: {max(late_us):.1f} us")
    assert max(late_us) < 20


def test_led_stays_off_after_the_swim(seen: Seen) -> None:
    over_us = seen.frames[BEATS * FRAMES_PER_BEAT]
    assert seen.edges[-1] == pytest.approx(over_us, abs=20)
    assert len(seen.edges) % 2 == 0


def test_pictures_hold_the_light_of_their_exposure(seen: Seen) -> None:
    assert len(seen.pictures) > 200
    partly = 0
    for picture in seen.pictures:
        middle_us = picture.time_s * 1e6 - seen.origin_us
        half_us = EXPOSURE_S * 1e6 / 2
        expected = seen.lit_part(middle_us - half_us, middle_us + half_us)
        assert picture.led == pytest.approx(expected, abs=2 / (2 * half_us))
        partly += 0 < picture.led < 1
    assert partly > 15


def test_a_countdown_blinks_and_then_it_is_lit(new_board: NewBoard, connect: Connect) -> None:
    """On 0.2 s, off 0.2 s, as long as the arming asked for."""
    board = new_board()
    led = PinTrace(board.board.clock, LED_PIN)
    led.connect(board.board.periph["PIOB"])
    fish = connect(board)
    fish.upload_reference(records.encode_reference(1.0, np.full(BEATS, 0.05, np.float32)))
    armed_us = board.board.clock.now / TICKS_PER_US
    fish.arm(blink_s=2.0)
    board.run(3.0)
    disarmed_us = board.board.clock.now / TICKS_PER_US
    fish.disarm()
    board.run(0.5)
    times_us = [time / TICKS_PER_US for time, _ in led.edges]
    *blinking, off_us = [time_us for time_us in times_us if time_us > armed_us]
    assert len(blinking) == 9  # on, off, on, ..., on for good
    assert np.diff(blinking) == pytest.approx(np.full(8, 200_000.0), abs=TICK_US + AT_ONCE_US)
    assert blinking[-1] - armed_us == pytest.approx(1.8e6, abs=0.1e6)
    assert disarmed_us < off_us < disarmed_us + 0.1e6


def test_a_reset_puts_it_out_and_the_pull_up_does_not_light_it(
    new_board: NewBoard, connect: Connect
) -> None:
    board = new_board(camera_fps=60.0, camera_exposure_s=1 / 60)
    fish = connect(board)
    fish.upload_reference(records.encode_reference(1.0, np.full(BEATS, 0.05, np.float32)))
    fish.arm()
    board.run(0.2)
    board.camera_frames()
    reset_s = board.time_s
    board.board.reset_pin()
    board.run(0.4)
    assert board.board_time_s < 0.4
    pictures = board.camera_frames()
    before = [p.led for p in pictures if p.time_s + 1 / 120 < reset_s]
    after = [p.led for p in pictures if p.time_s - 1 / 120 > reset_s]
    assert len(before) > 3
    assert set(before) == {1.0}
    assert len(after) > 15
    assert set(after) == {0.0}
