"""Packed logs: a second decoder, written from the protocol, must agree with the board's."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import TransferError
from tailbeat.core.records import unpack_log
from tailbeat.core.trial_file import parse_trial
from tailbeat.link.ftp.wire import NOT_FOUND, FtpError
from tailbeat.session.trial import run_trial

SHAPES = ("4442222211", "444444422", "444", "4422", "44444")
CHUNK, ESCAPE = 5, 5
HEADER_BYTES = 8


@dataclass
class Field:
    last: int = 0
    step: int = 0
    rice: int = 0


@dataclass
class Model:
    fields: list[list[Field]] = field(
        default_factory=lambda: [[Field() for _ in s] for s in SHAPES]
    )
    held: bytearray = field(default_factory=lambda: bytearray(64))


class Bits:
    def __init__(self, payload: bytes) -> None:
        self._bits = np.unpackbits(np.frombuffer(payload, np.uint8), bitorder="little")
        self._at = 0

    def take(self, count: int) -> int:
        bits = self._bits[self._at : self._at + count]
        self._at += count
        return sum(int(bit) << place for place, bit in enumerate(bits))

    def code(self, rice: int, bits: int) -> int:
        quotient = 0
        while quotient < ESCAPE and self.take(1):
            quotient += 1
        return quotient << rice | self.take(rice) if quotient < ESCAPE else self.take(bits)


def adapted(rice: int, bits: int, code: int) -> int:
    if code >> rice >= ESCAPE:
        rice += 4
    elif code >> rice >= 2:
        rice += 1
    elif code.bit_length() < rice:
        rice -= (rice - code.bit_length() + 3) // 4
    return min(rice, bits - 1)


def record(model: Model, topic: int, bits: Bits) -> bytes:
    out = b""
    for place, (digit, one) in enumerate(zip(SHAPES[topic], model.fields[topic], strict=True)):
        width = 8 * int(digit)
        code = bits.code(one.rice, width)
        difference = code >> 1 if code % 2 == 0 else -(code + 1 >> 1)
        value = (one.last + one.step + difference) % (1 << width)
        one.rice = adapted(one.rice, width, code)
        one.step = (value - one.last) % (1 << 32) if place == 0 else 0
        one.last = value
        out += value.to_bytes(width // 8, "little")
    size = len(out) + 2
    return size.to_bytes(2, "little") + b"D" + topic.to_bytes(2, "little") + out


def chunk(model: Model, bits: Bits) -> bytes:
    length = bits.take(6) + 1
    return bytes(model.held[i] if bits.take(1) else bits.take(8) for i in range(length))


def unpacked(packed: bytes) -> bytes:
    out, at, model = bytearray(), HEADER_BYTES, Model()
    while at < len(packed):
        first, ulog_bytes = np.frombuffer(packed, "<u2", 2, at)
        payload = int(first) & 0x7FFF
        model = Model() if first & 0x8000 else model
        bits, end = Bits(packed[at + 4 : at + 4 + payload]), len(out) + int(ulog_bytes)
        while len(out) < end:
            token = bits.take(3)
            piece = chunk(model, bits) if token == CHUNK else record(model, token, bits)
            model.held[: len(piece)] = piece
            out += piece
        at += 4 + payload
    return bytes(out)


def test_the_board_packs_as_documented(ready: Fish, tmp_path: Path) -> None:
    run_trial(ready)
    stored, ulog = (ready.ftp.read(f"/trials/0001.{kind}") for kind in ("ulz", "ulg"))
    assert stored[:HEADER_BYTES] == b"ULz1" + (1).to_bytes(4, "little")
    assert unpacked(stored) == ulog == unpack_log(stored)
    assert ready.pull_trial(1, tmp_path).read_bytes() == ulog
    assert [path.name for path in tmp_path.iterdir()] == ["0001.ulg"]
    assert parse_trial(ulog).problems == []
    assert [(trial.number, trial.size_bytes) for trial in ready.trials()] == [(1, len(ulog))]
    assert 2 * len(stored) < len(ulog)


def test_a_log_that_is_not_packed_stays() -> None:
    assert (
        unpack_log(b"ULog, as earlier firmware stores it") == b"ULog, as earlier firmware stores it"
    )
    assert unpack_log(b"") == b""


@pytest.mark.parametrize("length", [4, 8, 11, 30, 1000])
def test_noise_is_no_danger(length: int) -> None:
    noise = np.random.default_rng(length).bytes(length)
    assert len(unpack_log(b"ULz1" + noise)) <= 32 * (length + 4)


def test_damage_is_told(ready: Fish) -> None:
    run_trial(ready)
    stored = bytearray(ready.ftp.read("/trials/0001.ulz"))
    stored[len(stored) // 2 :] = bytes(len(stored) - len(stored) // 2)
    trial = parse_trial(unpack_log(bytes(stored)))
    assert any("damaged" in problem or "no end" in problem for problem in trial.problems)


def test_earlier_firmware_has_one_name_only(
    ready: Fish, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_trial(ready)
    ulog = ready.ftp.read("/trials/0001.ulg")
    pull, asked = ready.ftp.pull, []

    def old_board(path: str, *rest: object) -> None:
        asked.append(path)
        if path.endswith(".ulz"):
            raise FtpError(NOT_FOUND, path)
        pull(path, *rest)

    monkeypatch.setattr(ready.ftp, "pull", old_board)
    assert ready.pull_trial(1, tmp_path).read_bytes() == ulog
    assert asked == ["/trials/0001.ulz", "/trials/0001.ulg"]
    with pytest.raises(TransferError, match=r"/trials/0009\.ulg: there is no such file"):
        ready.pull_trial(9, tmp_path)
