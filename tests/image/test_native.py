"""The models in C against those in Python: the same image, the same ticks, the same bytes."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import TailbeatError
from tailbeat.link import _dialect as mavlink
from tailbeat.sim.board import CONSOLE
from tailbeat.sim.emulated import EmulatedBoard
from vboard.board import Board
from vboard.core.bench import RAM, RAM_BYTES
from vboard.core.clock import TICKS_PER_US
from vboard.native.chip import NativeChip
from vboard.periph.models import reference_models
from vboard.periph.pins import PinTrace

BEATS = 2
SERVO_PIN, SERVO_CHANNEL = 21, 4
CUT_TICKS, OFF_TICKS = 3_700 * TICKS_PER_US, 200_000 * TICKS_PER_US
LINES = ("UART", "USART0", "USART1")

Connect = Callable[[EmulatedBoard], Fish]


def state_of(board: Board) -> dict[str, Any]:
    """All that a difference would end up in."""
    return {
        "now": board.clock.now,
        "instructions": board.instructions,
        "idle": board.idle_ticks,
        "exceptions": board.chip.exceptions.taken,
        "registers": board.cpu.general_registers(),
        "ram": board.read(RAM, RAM_BYTES),
        "bank 1": board.bank1,
    }


class Session:
    """A trial with a 400 Hz IMU, its file pulled, learned from; then the power fails at a write."""

    def __init__(self, image: Path, connect: Connect) -> None:
        self.emulated = EmulatedBoard(image, "tank", seed=3)
        self.board = self.emulated.board
        assert isinstance(self.board.chip, NativeChip) == self.board.native
        self.trace = PinTrace(self.board.clock, SERVO_PIN, SERVO_CHANNEL)
        self.board.wire(self._probe)
        self.fish = connect(self.emulated)
        self.pulled = b""

    def _probe(self) -> None:
        self.trace.connect(self.board.periph["PIOC"], self.board.periph["PWM"])

    def swim(self) -> None:
        fish = self.fish
        for name, value in {"IMU_BAUD": 460800, "IMU_RATE_HZ": 400, "SPD_SOURCE": 1}.items():
            fish.params.set(name, value)
        assert fish.imu_verdict().state == "streaming"
        fish.upload_reference(records.encode_reference(1.0, [0.04] * BEATS))
        fish.arm()
        number = fish.status().next_trial
        fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_START, float(number), fish.clock.now_s())
        self.emulated.write(random.Random(1).randbytes(500), CONSOLE)
        while fish.status().state != "IDLE":
            fish.link.run(0.5)
        self.pulled = fish.ftp.read(f"/trials/{number:04d}.ulg")
        fish.upload_speeds(number, [0.03] * BEATS, 0.001)
        fish.learn(number)

    def lose_power(self) -> None:
        """While a page of the parameters is written; it comes back soon after."""
        pending = [self._cut]

        def cut_soon(busy: bool) -> None:
            if busy and pending:
                self.board.clock.after(CUT_TICKS, pending.pop())

        self.board.periph["EEFC1"].on_busy.append(cut_soon)
        with suppress(TailbeatError):
            self.fish.params.save()
        self.emulated.run(1.0)

    def _cut(self) -> None:
        self.board.power_cut()
        self.board.clock.after(OFF_TICKS, self.board.power_on)

    def outcome(self) -> dict[str, Any]:
        lines = [self.board.periph[name].line for name in LINES]
        return state_of(self.board) | {
            "edges": self.trace.edges,
            "lost": [asdict(line.lost) for line in lines],
            "moved": [(line.sent_bytes, line.received_bytes) for line in lines],
            "pulled": self.pulled,
            "fed": self.board.periph["WDT"].fed,
            "torn": self.board.flash.torn,
            "time": self.emulated.time_s,
        }


def run_session(image: Path, connect: Connect) -> dict[str, Any]:
    session = Session(image, connect)
    session.swim()
    before = session.outcome()
    assert before["pulled"] and len(before["edges"]) > 50 * BEATS
    session.lose_power()
    assert session.board.flash.torn
    return {f"{key}, before the cut": value for key, value in before.items()} | session.outcome()


def test_a_whole_session_is_the_same(
    image: Path, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    # where file transfers count from
    monkeypatch.setattr("tailbeat.link.ftp.client._first_number", lambda: 7)
    native = run_session(image, connect)
    with reference_models():
        reference = run_session(image, connect)
    assert [key for key in native if native[key] != reference[key]] == []
