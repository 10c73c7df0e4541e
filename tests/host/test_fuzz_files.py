"""Files of the board and of a sensor, damaged and made up: read, or refused with a remedy.

A few hundred in the suite; for ``FUZZ_SECONDS`` each by make fuzz. An input that fails is kept in
the folder ``FUZZ_KEEP`` names (the current one by default).
"""

from __future__ import annotations

import os
import random
import resource
import signal
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tailbeat.board import memory
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import TailbeatError
from tailbeat.core.trial_file import beats_csv, parse_trial
from tailbeat.sensors.vn100.decode import decode
from tailbeat.session.trial import run_trial

SEED = 20
ENDLESS_S = 10
GROWTH_MAX_KB = 300_000
HEADER = 16
KEPT = "crash-"
FIELDS = [
    "uint64_t",
    "float",
    "uint16_t",
    "uint8_t",
    "int8_t[4]",
    "char[9]",
    "a",
    "b",
    "uint8_t[60000]",
]

Read = Callable[[bytes], None]


@pytest.fixture(scope="module")
def ulog(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A trial of three beats with all its kinds of records."""
    from tailbeat.core import reference

    folder = tmp_path_factory.mktemp("fuzz")
    with Fish.connect("sim:tank", seed=3) as fish:
        fish.upload_reference(reference.trapezoid(0.06, 1, 1))
        run_trial(fish)
        return fish.pull_trial(1, folder).read_bytes()


def inputs(one: Callable[[random.Random], bytes], count: int) -> Iterator[bytes]:
    """``count`` of them, or as many as there is time for."""
    seconds = float(os.environ.get("FUZZ_SECONDS", "0"))
    rng = random.Random(SEED)
    begin = time.monotonic()
    done = 0
    while done < count or time.monotonic() - begin < seconds:
        done += 1
        yield one(rng)
    print(f"{done} inputs")


class Endless(BaseException):
    """Not one that a reader may take for what is wrong with its file."""


def _too_long(*_: object) -> None:
    raise Endless


def must_read(read: Read, made: Iterator[bytes]) -> None:
    """Anything but a result or a TailbeatError with a remedy fails, as does a loop without end."""
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGALRM, _too_long)
    for data in made:
        signal.alarm(ENDLESS_S)
        try:
            read(data)
        except TailbeatError as error:
            assert error.remedy and "\n" not in str(error)
        except BaseException:
            (Path(os.environ.get("FUZZ_KEEP", ".")) / f"{KEPT}{zlib.crc32(data):08x}").write_bytes(
                data
            )
            raise
        finally:
            signal.alarm(0)
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
    assert grown_kb < GROWTH_MAX_KB


def flip(rng: random.Random, data: bytes) -> bytes:
    """Some bytes changed, a piece lost, doubled or moved, the end cut off."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if not out:
            break
        at = rng.randrange(len(out))
        size = rng.randint(1, 40)
        choice = rng.randrange(7)
        if choice < 3:
            out[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
        elif choice == 3:
            del out[at : at + size]
        elif choice == 4:
            out[at:at] = out[at : at + size]
        elif choice == 5:
            out[at:at] = rng.randbytes(size)
        elif rng.random() < 0.2:
            del out[at:]
    return bytes(out)


def rows_of(ulog: bytes) -> list[bytes]:
    """Its records, each with its header."""
    rows, at = [], HEADER
    while at + 3 <= len(ulog):
        size = 3 + int.from_bytes(ulog[at : at + 2], "little")
        rows.append(ulog[at : at + size])
        at += size
    return rows


def row(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind[0]) + body


def made_up_row(rng: random.Random) -> bytes:
    """A record that is one, of contents nobody writes."""
    name = rng.choice(["a", "b", "beat", "slot", "rest", "trial_end", "battery"])
    fields = "".join(
        f"{rng.choice(FIELDS)} {rng.choice(['timestamp', 'beat', 'end', 'x', 'samples'])};"
        for _ in range(rng.randint(0, 6))
    )
    key = rng.choice(
        ["trial", "beats", "beat_s", "reference_crc", "start_us", "iteration", "board"]
    )
    typed = f"{rng.choice([*FIELDS, 'double', 'int64_t'])} {key}".encode()
    value = rng.choice([b"", rng.randbytes(rng.choice([1, 2, 4, 8])), b"\xff" * 8, bytes(8)])
    number = rng.randrange(6)
    return rng.choice(
        [
            row(b"F", f"{name}:uint64_t timestamp;{fields}".encode()),
            row(b"F", f"{name}:{fields}".encode()),
            row(b"A", struct.pack("<BH", 0, number) + name.encode()),
            row(b"I", bytes([len(typed)]) + typed + value),
            row(b"M", bytes([1, len(typed)]) + typed + value),
            row(b"P", bytes([len(typed)]) + typed + value),
            row(b"D", struct.pack("<H", number) + rng.randbytes(rng.randint(0, 30))),
            row(b"B", rng.randbytes(40)),
            row(b"B", bytes(8) + b"\1" + bytes(7) + rng.randbytes(24)),
            row(b"C", b"\1" + rng.randbytes(12)),
            row(b"S", rng.randbytes(8)),
            row(b"O", rng.randbytes(2)),
        ]
    )


def spoilt_trial(ulog: bytes) -> Callable[[random.Random], bytes]:
    rows = rows_of(ulog)

    def one(rng: random.Random) -> bytes:
        if rng.random() < 0.3:
            return flip(rng, ulog)
        mixed = list(rows)
        for _ in range(rng.randint(1, 6)):
            at = rng.randrange(min(len(mixed), rng.choice([20, 60, 10_000])))
            choice = rng.randrange(4)
            if choice == 0:
                mixed.insert(at, made_up_row(rng))
            elif choice == 1:
                mixed[at] = made_up_row(rng)
            elif choice == 2:
                old = mixed[at]
                mixed[at] = row(old[2:3], flip(rng, old[3:]))
            else:
                mixed.insert(at, rng.choice(mixed))
        return ulog[:HEADER] + b"".join(mixed)

    return one


def read_whole_trial(tmp_path: Path) -> Read:
    def read(data: bytes) -> None:
        trial = parse_trial(data)
        assert 1 <= len(trial.beats.samples) <= 512
        assert trial.end
        trial.max_abs_error_m_s(), trial.rms_error_m_s(), trial.slots.table()
        beats_csv(trial, tmp_path / "beats.csv")

    return read


def test_trial_files(ulog: bytes, tmp_path: Path) -> None:
    must_read(read_whole_trial(tmp_path), inputs(spoilt_trial(ulog), 120))


def test_formats_that_nest_or_repeat_are_not_unfolded(ulog: bytes, tmp_path: Path) -> None:
    nested = b"".join(
        row(b"F", f"{name}:{inner}[65000] x;".encode())
        for name, inner in [("a", "b"), ("b", "c"), ("c", "uint8_t")]
    )
    ring = row(b"F", b"a:b x;") + row(b"F", b"b:a x;")
    wide = row(b"F", b"a:" + b"uint8_t x;" * 6000)
    asked = row(b"A", struct.pack("<BH", 0, 77) + b"a")
    bombs = [nested + asked, ring + asked, wide + asked * 40_000]
    must_read(read_whole_trial(tmp_path), (ulog[:HEADER] + bomb for bomb in bombs))


def sealed(record: bytes) -> bytes:
    """With the CRC that fits."""
    crc = records.crc32(record[12:], records.crc32(record[:8]))
    return record[:8] + struct.pack("<I", crc) + record[12:]


def some_records() -> list[bytes]:
    speeds = [0.01, float("nan"), 0.03]
    crash_records = [
        b"TBCR" + struct.pack("<HH", version, 2) + bytes(4) + bytes(fixed) + bytes(8)
        for version, fixed in ((1, 174), (2, 270))
    ]
    return [
        records.encode_reference(1.0, [0.01, 0.02, 0.03]),
        records.encode_speeds(3, speeds, 0.001),
        records.encode_amplitudes(77, speeds),
        *map(sealed, crash_records),
    ]


def spoilt_record(rng: random.Random) -> bytes:
    record = rng.choice(some_records())
    if rng.random() < 0.5:
        return flip(rng, record)
    body = bytearray(record)
    for _ in range(rng.randint(1, 4)):
        body[rng.randrange(6, len(body))] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)])
    return sealed(bytes(body))


def read_as_each(data: bytes) -> None:
    """Every decoder gets it; each must refuse or give something."""
    refused = None
    decoders: list[Callable[[bytes], object]] = [
        records.decode_reference,
        records.decode_past,
        records.decode_learned,
        records.record_crc,
        memory.decode_crash,
    ]
    for decoder in decoders:
        try:
            decoder(data)
        except TailbeatError as error:
            refused = error
            assert error.remedy
    if refused is not None:
        raise refused


def test_records() -> None:
    must_read(read_as_each, inputs(spoilt_record, 1500))


def sensor_frame(rng: random.Random) -> bytes:
    """Any layout, its CRC right."""
    groups = rng.choice([0x01, 0x11, 0x04, rng.randrange(1, 64)])
    head = bytes([groups]) + rng.randbytes(2 * groups.bit_count())
    body = head + rng.randbytes(rng.choice([12, 56, 100]))
    crc = 0
    for byte in body:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return b"\xfa" + body + struct.pack(">H", crc)


def sensor_line(rng: random.Random) -> bytes:
    kind = rng.choice(["VNYMR", "VNYPR", "VNRRG,01", "VNERR", "VNIMU", "VNQMR", "VNXYZ"])
    values = ["+1.5", "-000.2", "9" * 30, "", "x", "1e9", "nan", "12", "\x7f"]
    text = ",".join([kind, *(rng.choice(values) for _ in range(rng.randint(0, 14)))])
    check = 0
    for byte in text.encode():
        check ^= byte
    return f"${text}*{check:02X}\r\n".encode()


def sensor_bytes(rng: random.Random) -> bytes:
    pieces = [rng.choice([sensor_frame, sensor_line])(rng) for _ in range(rng.randint(1, 8))]
    data = b"".join(pieces)
    return data if rng.random() < 0.7 else flip(rng, data)


def read_recording(data: bytes) -> None:
    for message in decode(data):
        assert data[message.offset :][: len(message.data)] == message.data
        assert message.kind
        assert all(isinstance(value, int | float) for value in message.values.values())


def test_recordings() -> None:
    must_read(read_recording, inputs(sensor_bytes, 250))
