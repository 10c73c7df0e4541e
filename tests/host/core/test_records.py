"""The small records, and that damaged ones are told apart."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.core.records import Amplitudes

speeds = st.lists(st.floats(0, 0.25, width=32), min_size=1, max_size=512)


def test_crc_vector() -> None:
    assert records.crc32(b"123456789") == 0x2DFD2D88
    assert records.crc32(b"6789", records.crc32(b"12345")) == 0x2DFD2D88
    assert records.crc32(b"") == 0


@given(speeds)
def test_reference_round_trip(values: list[float]) -> None:
    record = records.encode_reference(1.0, values)
    assert record[:4] == b"TBRF"
    assert len(record) == 12 + 4 + 4 * len(values)
    decoded = records.decode_reference(record)
    assert decoded.beat_s == 1.0
    assert decoded.speed_m_s.tolist() == values
    assert decoded.crc == records.record_crc(record)


def test_speeds_round_trip() -> None:
    record = records.encode_speeds(7, [0.1, float("nan"), 0.2], 0.001)
    decoded = ffi.new("speed_upload_t *")
    assert lib.record_decode_speeds(record, len(record), decoded) == 0
    assert (decoded.trial, decoded.beats) == (7, 3)
    np.testing.assert_array_equal(list(decoded.speed_m_s[0:3]), np.float32([0.1, np.nan, 0.2]))
    np.testing.assert_array_equal(list(decoded.sigma_m_s[0:3]), np.float32([0.001] * 3))


def test_amplitudes_round_trip() -> None:
    record = records.encode_amplitudes(0xDEADBEEF, [0.1, -0.2, 0.3])
    decoded = ffi.new("amplitudes_upload_t *")
    assert lib.record_decode_amplitudes(record, len(record), decoded) == 0
    assert (decoded.reference_crc, decoded.beats) == (0xDEADBEEF, 3)
    np.testing.assert_array_equal(list(decoded.amplitude_rad[0:3]), np.float32([0.1, -0.2, 0.3]))


@pytest.mark.parametrize("visits", [None, [0, 3, 255]])
def test_learned_records_have_the_documented_bytes(visits: list[int] | None) -> None:
    status = SimpleNamespace(
        last_learned_trial=9, worse_streak=1, best_iteration=4, best_max_abs_error_m_s=0.5
    )
    now = Amplitudes(5, 3, 0xABCD, np.float32([0.1, -0.2, 0.9]), input=2)
    best = Amplitudes(4, 3, 0xABCD, np.float32([0.3, 0.4, 0.5]))
    counts = None if visits is None else np.array(visits, dtype=np.uint8)
    record = records.encode_learned(status, now, best, counts)
    head = struct.pack("<4sHH", b"TBLI", 1 if visits is None else 2, 3)
    made_by = 0 if visits is None else 2  # version 1 knows the first guess (1) and all others
    body = struct.pack("<IIHHHHf", 0xABCD, 9, 5, 4, 1, made_by, 0.5)
    body += struct.pack("<6f", 0.1, -0.2, 0.9, 0.3, 0.4, 0.5) + bytes(visits or [])
    assert record == head + struct.pack("<I", records.crc32(head + body)) + body


def test_a_learned_record_with_peaks_and_its_older_forms() -> None:
    status = SimpleNamespace(
        last_learned_trial=9, worse_streak=0, best_iteration=4, best_max_abs_error_m_s=0.5
    )
    now = Amplitudes(5, 3, 0xABCD, np.float32([0.1, 0.2, 0.9]), input=0)
    best = Amplitudes(4, 3, 0xABCD, np.float32([0.3, 0.4, 0.5]))
    counts, peaks = np.array([1, 2, 3], dtype=np.uint8), np.float32([-0.25, 0.0, 0.5])
    record = records.encode_learned(status, now, best, counts, peaks)
    flat = records.encode_learned(status, now, best, counts)
    assert record[4:6] == b"\3\0"
    assert record[32:82] == struct.pack("<9H8f", 2, 2, 0, *[0] * 6, 0.5, -0.25, *[0.0] * 6)
    assert record[12:32] + record[82:] == flat[12:]
    assert records.learned_visits(record) == b"\1\2\3"
    assert records.without_peaks(record) == flat
    assert records.older_forms(record) == [flat, records.without_visits(flat)]
    assert records.older_forms(records.without_visits(flat)) == []
    assert records.decode_learned(record).best_rad.tobytes() == best.values.tobytes()


@pytest.mark.parametrize(("made_by", "older"), [(0, 0), (1, 1), (2, 0), (3, 0), (None, 0)])
def test_what_made_the_amplitudes_in_version_1(made_by: int | None, older: int) -> None:
    status = SimpleNamespace(last_learned_trial=0, worse_streak=0)
    now = Amplitudes(1, 2, 7, np.float32([0.1, 0.2]), input=made_by)
    newer = records.encode_learned(status, now, None, np.array([5, 6], dtype=np.uint8))
    assert newer[26:28] == bytes([made_by or 0, 0])
    assert records.learned_visits(newer) == b"\5\6"
    record = records.without_visits(newer)
    assert record[26:28] == bytes([older, 0])
    assert (record[12:26], record[28:]) == (newer[12:26], newer[28:-2])
    assert records.record_crc(record) == records.crc32(record[:8] + record[12:])
    assert records.without_visits(record) == record
    assert records.learned_visits(record) == b""


@pytest.mark.parametrize("at", range(0, 24))
def test_any_flipped_bit_is_noticed(at: int) -> None:
    record = bytearray(records.encode_reference(1.0, [0.05, 0.06]))
    record[at] ^= 1
    with pytest.raises(InputError):
        records.decode_reference(bytes(record))


@given(st.binary(max_size=80))
def test_noise_is_no_record(noise: bytes) -> None:
    for decode in (records.decode_reference, records.decode_past, records.decode_learned):
        with pytest.raises(InputError):
            decode(noise)


@pytest.mark.parametrize("values", [[], [[0.1]], [0.1] * 513])
def test_wrong_shapes(values: list) -> None:
    with pytest.raises(InputError):
        records.encode_reference(1.0, values)
