"""What comes out of the servo pin in a whole trial, against a sine computed here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_US
from vboard.periph.pins import PinTrace, Pulse

SERVO_PIN, SERVO_CHANNEL = 21, 4  # of port C, PWML4
FRAMES_PER_BEAT = 50
BEATS, SOAK_BEATS = 8, 40
PERIOD_TICKS = 20_000 * TICKS_PER_US
SERVO_TICK = TICKS_PER_US // 3  # 333 ns
US_PER_RAD = 1800 / math.pi  # 10 us per degree
LONGEST_US = 2100


def probe(board: EmulatedBoard) -> PinTrace:
    """A scope on the servo pin, from before the first instruction."""
    trace = PinTrace(board.board.clock, SERVO_PIN, SERVO_CHANNEL)
    board.board.wire(lambda: trace.connect(board.board.periph["PIOC"], board.board.periph["PWM"]))
    return trace


def ideal_us(amplitude_rad: float, frame: int) -> float:
    """Pulse of a frame by the definition: a sine of one beat, 10 us per degree about 1500 us."""
    phase = 2 * math.pi * (frame % FRAMES_PER_BEAT) / FRAMES_PER_BEAT
    return 1500 + US_PER_RAD * amplitude_rad * math.sin(phase)


def worst_error_us(pulses: list[Pulse], amplitude_rad: np.ndarray) -> float:
    return max(
        abs(pulse.ticks / TICKS_PER_US - ideal_us(amplitude_rad[n // FRAMES_PER_BEAT], n))
        for n, pulse in enumerate(pulses)
    )


@dataclass(frozen=True)
class Swum:
    """All pulses of a trial, the amplitude of each beat, and the board some time after."""

    pulses: list[Pulse]
    amplitude_rad: np.ndarray
    board: EmulatedBoard

    @property
    def frames(self) -> int:
        """Pulses of the beats; those of the coast come after."""
        return len(self.amplitude_rad) * FRAMES_PER_BEAT


@pytest.fixture(scope="module", params=[BEATS, pytest.param(SOAK_BEATS, marks=pytest.mark.soak)])
def recorded(image: Path, request: pytest.FixtureRequest) -> Swum:
    """One trial, each beat with an amplitude of its own."""
    board = EmulatedBoard(image)
    trace = probe(board)
    transport = SimTransport(board)
    assert hear_board(transport) is not None
    amplitude_rad = np.random.default_rng(8).uniform(0, math.pi / 4, request.param)
    with Fish(transport) as fish:
        fish.clock.sync()
        fish.params.set("AMP_MAX_RAD", math.pi / 4)
        fish.upload_reference(records.encode_reference(1.0, np.full(request.param, 0.04)))
        fish.upload_amplitudes(amplitude_rad)
        fish.arm()
        board.run(0.5)
        before = trace.pulses()
        assert run_trial(fish).end == "complete"
        board.run(2.0)
        assert fish.health()["late_ticks"] == 0
    assert len(before) == 1, "the pull-up before the first instruction; armed, no pulses"
    assert before[0].ticks < 50 * TICKS_PER_US
    return Swum(trace.pulses()[1:], amplitude_rad, board)


def test_each_pulse_is_the_sine_of_its_beat(recorded: Swum) -> None:
    trial = recorded.pulses[: recorded.frames]
    assert len(trial) == recorded.frames >= BEATS * FRAMES_PER_BEAT
    worst_us = worst_error_us(trial, recorded.amplitude_rad)
    print(f"largest error of {len(trial)} pulses: {worst_us * 1000:.0f} ns")
    assert worst_us <= 1 / 3


def test_an_amplitude_shifted_by_one_frame_would_be_seen(recorded: Swum) -> None:
    assert worst_error_us(recorded.pulses[1 : recorded.frames], recorded.amplitude_rad) > 10


def test_the_period_is_exact(recorded: Swum) -> None:
    starts = [pulse.start for pulse in recorded.pulses]
    assert {b - a for a, b in pairwise(starts)} == {PERIOD_TICKS}
    assert {pulse.ticks % SERVO_TICK for pulse in recorded.pulses} == {0}


def test_pulses_end_with_the_coast(recorded: Swum) -> None:
    coast = recorded.pulses[recorded.frames :]
    assert len(coast) <= 0.5 * FRAMES_PER_BEAT + 1
    assert {pulse.ticks // TICKS_PER_US for pulse in coast} == {1500}
    assert recorded.board.board.clock.now - recorded.pulses[-1].start > TICKS_PER_US * 2_000_000


def test_no_pulse_is_longer_than_a_legal_one(recorded: Swum) -> None:
    assert max(pulse.ticks for pulse in recorded.pulses) <= LONGEST_US * TICKS_PER_US
