"""The conversation of a trial in C is the readable one, byte for byte."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import thesis
from tailbeat.core.speed_source import Frame, Unseen
from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import TrialOutcome
from tailbeat.sensors.camera.tracking.live import BeatFit
from tailbeat.session import trial_wire
from tailbeat.session.guards import Guard
from tailbeat.session.outcome import BY_HAND
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import vision_message
from tailbeat.sim.board import SimBoard, SimTransport

SENT_MAX = 1 << 20


@dataclass
class Heard:
    """All that went up to the board, and all that came of it."""

    sent: bytearray = field(default_factory=bytearray)
    wires: list[Any] = field(default_factory=list)
    seen: list[object] = field(default_factory=list)
    flash: bytes = b""
    time_s: float = 0.0
    outcome: TrialOutcome | None = None

    def drain(self) -> int:
        """Takes what C has sent; how many bytes."""
        count = 0
        for native in self.wires:
            self.sent += ffi.buffer(native.sent, native.sent_count)
            count += native.sent_count
            native.sent_count = 0
        return count


def executed(
    monkeypatch: pytest.MonkeyPatch,
    in_c: bool,
    guard: Callable[[Heard], Guard] | None = None,
    direction_rad: float = 0.0,
    **settings: float,
) -> Heard:
    """A trial of one simulated fish."""
    heard, kept, by_c = Heard(), ffi.new("uint8_t[]", SENT_MAX), [0]
    write, converse = SimBoard.write, SimBoard.converse

    def watched(board: SimBoard, wire: Any) -> Any:
        if not heard.wires:
            wire.sent, wire.sent_max = kept, SENT_MAX
            heard.wires.append(wire)
        return converse(board, wire)

    def noted(board: SimBoard, data: bytes, port: int = 0) -> int:
        by_c[0] += heard.drain()
        heard.sent += data
        return write(board, data, port)

    with monkeypatch.context() as patched:
        patched.setattr(SimBoard, "converse", watched)
        if not in_c:
            patched.setattr(trial_wire, "simulated_line", lambda fish: None)
        patched.setattr(SimBoard, "write", noted)
        board = SimBoard("tank", seed=5, **settings)
        with Fish(SimTransport(board)) as fish:
            fish.upload_reference(thesis().record())
            look = guard(heard) if guard is not None else None
            heard.outcome = run_trial(fish, guard=look, direction_rad=direction_rad)
            by_c[0] += heard.drain()
            heard.flash, heard.time_s = board.flash, board.time_s
    assert (by_c[0] > 0.5 * len(heard.sent)) == in_c
    return heard


def recorder(heard: Heard) -> Guard:
    """Keeps what a guard is asked."""
    return lambda what: heard.seen.append(what)


def stops_at(x_m: float) -> Callable[[Heard], Guard]:
    """Records, and aborts at the first picture beyond ``x_m``."""

    def guard(heard: Heard) -> Guard:
        def look(what: object) -> Any:
            heard.seen.append(what)
            return BY_HAND if isinstance(what, Frame) and what.x_m > x_m else None

        return look

    return guard


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"guard": recorder},
        {"guard": stops_at(0.4)},
        {"direction_rad": 0.1},
        {"camera_fps": 60.0},
        {"camera_fps": 8.0},
    ],
    ids=["plain", "guarded", "stopped", "askew", "fast", "slow"],
)
def test_the_line_carries_the_same_bytes(
    monkeypatch: pytest.MonkeyPatch, how: dict[str, Any]
) -> None:
    readable, in_c = (
        executed(monkeypatch, in_c=False, **how),
        executed(monkeypatch, in_c=True, **how),
    )
    assert in_c.sent == readable.sent
    assert in_c.outcome == readable.outcome
    assert in_c.seen == readable.seen
    assert in_c.time_s == readable.time_s
    assert in_c.flash == readable.flash


def test_a_guard_sees_pictures_and_their_absence(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = executed(monkeypatch, in_c=True, guard=recorder).seen
    assert sum(isinstance(what, Frame) for what in seen) > 1000
    assert any(isinstance(what, Unseen) for what in seen)


def test_a_speed_is_packed_as_by_the_dialect() -> None:
    """Over stamps, positions and sequence numbers; a fish at rest, too."""
    native, fit = ffi.new("trial_wire_t *"), BeatFit()
    ours = BeatFit()
    native.fit, native.along_x, native.system, native.component = ours.native, 1.0, 255, 190
    native.host_s, native.board_s, native.rate, native.sequence = 3.0, 1e4 / 3, 1.0 + 1e-5, 250
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    mav.seq = 250
    out, packed = ffi.new("uint8_t[280]"), 0
    for k in range(400):
        t_s = 2.0 + k * 0.04
        x_m = 0.1 if k < 60 else 0.1 + 0.05 * math.sin(t_s) + 1e-4 * (k % 7)
        length = lib.trial_wire_speed(native, [(t_s, x_m)], out)
        sample = fit.add(t_s, x_m)
        assert (length > 0) == (sample is not None)
        if sample is None:
            continue
        if sample.speed_m_s == 0:
            sample = type(sample)(sample.t_s, 1e-9, sample.sigma_m_s)
        stamp_s = native.board_s + (sample.t_s - native.host_s) * native.rate
        expected = vision_message(stamp_s, sample).pack(mav)
        mav.seq = (mav.seq + 1) & 0xFF
        assert bytes(ffi.buffer(out, length)) == bytes(expected)
        assert native.sequence == mav.seq
        packed += 1
    assert packed > 300
