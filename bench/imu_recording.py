"""What it costs to read a recording of a VN-100: rows by native calls, against message by message.

Processor time per MB of one process, the best of some runs; both ways in the same run, as this
machine may be busy. The limit is the CRC of all bytes by the same library: less than looking at
each byte once no reader can do. Exits with 1 when a goal is missed.
"""

from __future__ import annotations

import binascii
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tailbeat.core.native import ffi, lib
from tailbeat.sensors.vn100.batch import BatchReader, decode_rows
from tailbeat.sensors.vn100.decode import Reader, decode
from tailbeat.sensors.vn100.summary import StreamSummary

HEADER = bytes.fromhex("FA1129014000")
CHUNK_BYTES = 1 << 20
QUICKER = 30.0


@dataclass(frozen=True)
class Load:
    """How much is measured; ``judged``: goals count."""

    messages: int
    runs: int
    judged: bool


FULL, TINY = Load(40_000, 5, judged=True), Load(2_000, 1, judged=False)


def frame(number: int) -> bytes:
    """The fish's own binary frame."""
    values = (10.0 + number % 7, -2.5, 0.75, 0.01, -0.02, 0.5, -0.4, -0.4, -9.8, 0.016, -0.25, 0.0)
    bare = HEADER + struct.pack("<Q12f", 10_000_000 * number, *values)
    return bare + struct.pack(">H", binascii.crc_hqx(bare[1:], 0))


def line(number: int) -> bytes:
    """A line as the sensor sends it from the factory."""
    body = (
        f"VNYMR,{number % 180:+08.3f},-000.278,+002.026,+01.0670,-00.2568,+03.0696"
        ",-00.078,+00.091,-09.823,+00.001107,-00.000637,+00.000537"
    )
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def by_message(data: bytes) -> dict[str, Any]:
    """The summary, message by message."""
    reader, summary = Reader(), StreamSummary()
    for message in decode(data, reader):
        summary.add(message)
    return summary.document(reader.counters, reader.bytes)


def by_row(data: bytes) -> dict[str, Any]:
    """The summary, as the command makes it."""
    reader, summary = BatchReader(), StreamSummary()
    chunks = (data[at : at + CHUNK_BYTES] for at in range(0, len(data), CHUNK_BYTES))
    for rows in decode_rows(chunks, reader):
        summary.add_rows(rows, reader)
    return summary.document(reader.counters, reader.bytes)


def check_all(data: bytes) -> int:
    """One CRC over everything."""
    return int(lib.crc16_update(0, ffi.from_buffer(data), len(data)))


def cpu_s_per_mb(work: Callable[[bytes], Any], data: bytes, runs: int) -> float:
    """The best of some runs."""
    taken = []
    for _ in range(runs):
        begin_s = time.thread_time()
        work(data)
        taken.append(time.thread_time() - begin_s)
    return min(taken) / (len(data) / 1e6)


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    numbers = range(load.messages)
    streams = {
        "64-byte frames": b"".join(map(frame, numbers)),
        "$VNYMR lines": b"".join(map(line, numbers)),
        "both": b"".join(frame(n) + (line(n) if n % 4 == 0 else b"") for n in numbers),
    }
    missed = 0
    print("a recording of the IMU summed up, ms of processor time per MB:")
    print(
        "  by message   by row   times quicker (goal)   limit: a CRC of all bytes, by row over it"
    )
    for name, data in streams.items():
        if by_row(data) != by_message(data):
            sys.exit(f"{name}: the two ways tell different things")
        before_s = cpu_s_per_mb(by_message, data, 1)
        now_s = cpu_s_per_mb(by_row, data, load.runs)
        limit_s = cpu_s_per_mb(check_all, data, load.runs)
        missed += load.judged and before_s / now_s < QUICKER
        print(
            f"  {1e3 * before_s:10.1f} {1e3 * now_s:8.2f} {before_s / now_s:15.0f} ({QUICKER:.0f})"
            f" {1e3 * limit_s:10.2f} {now_s / limit_s:8.1f} x   {name}"
        )
    if missed:
        sys.exit(f"{missed} of {len(streams)} goals missed")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
