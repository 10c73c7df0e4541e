"""Recordings as rows by native calls, against the same stream read message by message."""

from __future__ import annotations

import binascii
import random
import struct
from typing import Any

import pytest

from tailbeat.sensors.vn100 import batch
from tailbeat.sensors.vn100.batch import BatchReader, decode_rows
from tailbeat.sensors.vn100.decode import Reader, decode
from tailbeat.sensors.vn100.summary import StreamSummary

GROUPS = (0, 2, 4)
WORDS = (0x0001, 0x0109, 0x0020, 0x0100, 0x0041)


def frame(rng: random.Random, time_ns: int) -> bytes:
    """Of one of 155 layouts, some with time and some without."""
    groups = rng.sample(GROUPS, rng.randint(1, 3))
    words = {group: rng.choice(WORDS) & (0x0FFF if group == 2 else 0x01FF) for group in groups}
    header = bytes([0xFA, sum(1 << group for group in groups)])
    header += b"".join(struct.pack("<H", words[group]) for group in sorted(groups))
    sizes = {
        0: {0: 8, 3: 12, 5: 12, 6: 24, 8: 12},
        2: {0: 2, 3: 12, 5: 4, 6: 16, 8: 12},
        4: {0: 2, 3: 36, 5: 12, 6: 12, 8: 12},
    }
    payload = b""
    for group in sorted(groups):
        for bit, size in sizes[group].items():
            timed = (group, bit) == (0, 0)
            if words[group] >> bit & 1:
                payload += struct.pack("<Q", time_ns) if timed else rng.randbytes(size)
    body = header + payload
    return body + struct.pack(">H", binascii.crc_hqx(body[1:], 0))


def line(rng: random.Random) -> bytes:
    """Measurements, errors, answers, with either check."""
    body = rng.choice(
        ["VNYPR,+010.071,+000.278,-002.026", "VNERR,0C", "VNERR,03", "VNRRG,01,VN-100", "VNQQQ"]
    ) + rng.choice(["", "", "X"])
    if rng.random() < 0.5:
        return f"${body}*{binascii.crc_hqx(body.encode(), 0):04X}\r\n".encode()
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\n".encode()


def stream(seed: int) -> bytes:
    """500 pieces: frames, lines, bytes of nothing, damage; its end may be cut."""
    rng = random.Random(seed)
    pieces = []
    time_ns = rng.getrandbits(63)
    for _ in range(500):
        time_ns += rng.choice((10, 10, 10, 30, -1000)) * 1_000_000
        piece = frame(rng, time_ns % (1 << 64)) if rng.random() < 0.6 else line(rng)
        if rng.random() < 0.05:
            damaged = bytearray(piece)
            damaged[rng.randrange(len(piece))] ^= 1 << rng.randrange(8)
            piece = bytes(damaged)
        pieces += [piece, rng.randbytes(rng.choice((0, 0, 0, 5)))]
    return b"".join(pieces)[: -rng.randrange(1, 9)]


def by_message(data: bytes) -> dict[str, Any]:
    reader, summary = Reader(), StreamSummary()
    for message in decode(data, reader):
        summary.add(message)
    return summary.document(reader.counters, reader.bytes)


def by_row(data: bytes, chunk: int) -> dict[str, Any]:
    reader, summary = BatchReader(), StreamSummary()
    chunks = (data[at : at + chunk] for at in range(0, len(data), chunk))
    for rows in decode_rows(chunks, reader):
        summary.add_rows(rows, reader)
    return summary.document(reader.counters, reader.bytes)


@pytest.mark.parametrize("rows", [1, 7, 1 << 15])
@pytest.mark.parametrize("chunk", [5, 4096, 1 << 20])
def test_rows_tell_what_messages_tell(
    chunk: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "_ROWS", rows)
    for seed in range(3):
        data = stream(seed)
        expected = by_message(data)
        assert len(expected["headers"]) > 2 * batch._KINDS  # the table of kinds grows
        assert expected["crc_failed"] and expected["checksum_failed"] and expected["sensor_errors"]
        found = by_row(data, chunk)
        assert found == expected
        for name in ("headers", "ascii_types", "sensor_errors"):  # also in their order
            assert [*found[name]] == [*expected[name]]


def test_a_row_is_its_message() -> None:
    data, reader = stream(7), BatchReader()
    rows = [row for rows in decode_rows([data], reader) for row in rows.tolist()]
    messages = list(decode(data))
    assert len(rows) == len(messages)
    for (offset, time_ns, kind, check, error), message in zip(rows, messages, strict=True):
        assert (offset, check, error) == (
            message.offset,
            message.check,
            getattr(message, "error", 0),
        )
        assert time_ns == message.values.get("time_startup_ns", 0)
        name = reader.kinds[kind].name
        assert name == (message.kind if reader.kinds[kind].frame_bytes else message.type)
