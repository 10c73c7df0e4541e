"""The small binary files of docs/reference/protocol.md, through the firmware's own encoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, TypeVar

from tailbeat.core.errors import InputError
from tailbeat.core.faults import fault_info
from tailbeat.core.lazy_arrays import F32, ArrayLike, NDArray, np
from tailbeat.core.native import ffi, lib

T = TypeVar("T")

FILE_REFERENCE = 0
FILE_AMPLITUDES = 1
FILE_SPEEDS = 2
FILE_LEARNED = 3
PATHS = {
    FILE_REFERENCE: "/in/reference.bin",
    FILE_AMPLITUDES: "/in/amplitudes.bin",
    FILE_SPEEDS: "/in/speeds.bin",
    FILE_LEARNED: "/in/learned.bin",
}

PAST_FILES = 8

INPUT_FIRST, INPUT_UPLOADED, INPUT_RESTORED = 1, 2, 3  # memory_input_t; 0: learned from a trial

_HEADER_BYTES = 12
_UNVISITED = b"\1\0"  # version of a learned record without visits
_INPUT = slice(26, 28)  # of a learned record: what made its amplitudes
_FIXED_BYTES = 128  # more than the header and fixed fields of any record

_PACKED_MAGIC = b"ULz1"


@dataclass(frozen=True)
class ReferenceRecord:
    """A decoded reference. ``speed_m_s``: float32, shape (beats,)."""

    beat_s: float
    speed_m_s: F32
    crc: int


@dataclass(frozen=True)
class LearnedRecord:
    """What was learned along the reference with ``reference_crc``. ``amplitude_rad`` swims next
    (unsaturated), ``best_rad`` is the best as swum, if ``best_iteration`` is not 0. ``input``: what
    made the next ones, memory_input_t. Arrays: float32, shape (beats,)."""

    reference_crc: int
    iteration: int
    best_iteration: int
    input: int
    best_max_abs_error_m_s: float
    amplitude_rad: F32
    best_rad: F32


@dataclass(frozen=True)
class Amplitudes:
    """The stored (unsaturated) amplitudes that swim next. ``values``: float32, (beats,), rad."""

    iteration: int
    beats: int
    reference_crc: int
    values: F32
    input: int | None = None  # what made those that swim next, memory_input_t; None: not told


class LearningStatus(Protocol):
    """What a board's status says of learning, see ``link.messages.BoardStatus``."""

    @property
    def last_learned_trial(self) -> int | None: ...
    @property
    def best_iteration(self) -> int | None: ...
    @property
    def best_max_abs_error_m_s(self) -> float | None: ...
    @property
    def worse_streak(self) -> int: ...


@dataclass(frozen=True)
class PastRecord:
    """A decoded past trial, or the mean of ``trials`` (``kind`` 2 or 1, ILC_KIND). Arrays: float32,
    shape (beats,); an error NaN = not measured. ``previous_crc`` 0: the average begins with it."""

    crc: int
    learned_crc: int
    previous_crc: int
    kind: int
    trials: int
    amplitude_rad: F32
    error_m_s: F32


def crc32(data: bytes, crc: int = 0) -> int:
    """CRC-32 of MAVLink FTP (``b"123456789"`` gives 0x2DFD2D88); ``crc`` goes on from a piece."""
    return int(lib.crc32_update(crc, ffi.from_buffer(data), len(data)))


def record_crc(record: bytes) -> int:
    """The CRC a record carries; for a reference this is its identity."""
    if len(record) < _HEADER_BYTES:
        raise InputError("the record is too short", "Encode it again.")
    return int.from_bytes(record[8:12], "little")


def encode_reference(beat_s: float, speed_m_s: ArrayLike) -> bytes:
    """The file that, uploaded and committed, becomes the reference."""
    speeds = _beats(speed_m_s, "speed")
    struct = ffi.new("reference_t *")
    struct.beats = len(speeds)
    struct.beat_s = beat_s
    _fill(struct.speed_m_s, speeds)
    return _encode(lib.record_encode_reference, struct, 1, len(speeds))


def decode_reference(record: bytes) -> ReferenceRecord:
    """Raises InputError when ``record`` is not a sound reference."""
    struct = _decoded("reference_t *", lib.record_decode_reference, record, "reference")
    return _record(ReferenceRecord, struct)


def encode_speeds(trial: int, speed_m_s: ArrayLike, sigma_m_s: ArrayLike) -> bytes:
    """Speeds of the pending trial, one per beat; NaN = not measured."""
    speeds = _beats(speed_m_s, "speed")
    sigmas = np.broadcast_to(np.asarray(sigma_m_s, dtype=np.float32), speeds.shape)
    struct = ffi.new("speed_upload_t *")
    struct.trial = trial
    struct.beats = len(speeds)
    _fill(struct.speed_m_s, speeds)
    _fill(struct.sigma_m_s, np.ascontiguousarray(sigmas))
    return _encode(lib.record_encode_speeds, struct, 2, len(speeds))


def encode_amplitudes(reference_crc: int, amplitude_rad: ArrayLike) -> bytes:
    """Amplitudes the host computed itself, one per beat of the reference."""
    amplitudes = _beats(amplitude_rad, "amplitude")
    struct = ffi.new("amplitudes_upload_t *")
    struct.reference_crc = reference_crc
    struct.beats = len(amplitudes)
    _fill(struct.amplitude_rad, amplitudes)
    return _encode(lib.record_encode_amplitudes, struct, 1, len(amplitudes))


def past_path(iteration: int) -> str:
    """Where the board keeps the past trial of ``iteration``, or the mean up to it."""
    return f"/past{iteration % PAST_FILES}.bin"


def decode_past(record: bytes) -> PastRecord:
    """Raises InputError when ``record`` is not sound."""
    return _record(PastRecord, _decoded("past_t *", lib.record_decode_past, record, "past trial"))


def encode_learned(
    status: LearningStatus,
    now: Amplitudes,
    best: Amplitudes | None,
    visits: NDArray[np.uint8] | None,
    peaks: F32 | None = None,
) -> bytes:
    """All that a board has learned, from what it reports. ``visits`` None: it does not count them.
    ``peaks``: the best's largest errors, m/s, 0 at other beats; None: the board does not
    keep them. It gets the form of the record that it knows."""
    struct = ffi.new("memory_t *")
    struct.reference_crc = now.reference_crc
    struct.last_trial = status.last_learned_trial or 0
    struct.beats = now.beats
    struct.iteration = now.iteration
    struct.worse_streak = status.worse_streak
    struct.input = now.input or lib.MEMORY_INPUT_LAW  # unknown: they stay as they are
    _fill(struct.amplitude_rad, now.values)
    if best is not None:
        struct.best_iteration = status.best_iteration or 0
        struct.best_max_abs_error_m_s = status.best_max_abs_error_m_s or 0.0
        _fill(struct.best_rad, best.values)
    if visits is not None:
        ffi.memmove(struct.visits, visits.tobytes(), visits.size)
    if peaks is not None:
        fill_peaks(struct.peaks, peaks)
    record = _encode(lib.record_encode_memory, struct, 3, now.beats)
    return without_visits(record) if visits is None else record


def decode_learned(record: bytes) -> LearnedRecord:
    """Raises InputError when ``record`` is not sound."""
    return _record(LearnedRecord, _memory(record))


def fill_peaks(peaks: Any, error_m_s: F32) -> None:
    """The C code's judge_peaks_t from its errors at the beats of the peaks and 0 at all others."""
    listed = [(beat, error) for beat, error in enumerate(error_m_s.tolist()) if error]
    largest = sorted(listed, key=lambda peak: -abs(peak[1]))
    peaks.count = min(len(largest), len(peaks.beat))
    for at, (beat, error) in enumerate(largest[: peaks.count]):
        peaks.beat[at], peaks.error_m_s[at] = beat, error


def learned_visits(record: bytes) -> bytes:
    """How often each beat was corrected, by a learned record; empty in version 1."""
    beats = int.from_bytes(record[6:8], "little")
    return b"" if record[4:6] == _UNVISITED else record[-beats:]


def older_forms(record: bytes) -> list[bytes]:
    """The same learned record for older firmware, the newest form first."""
    flat = without_peaks(record)
    return [form for form in (flat, without_visits(flat)) if form != record]


def without_peaks(record: bytes) -> bytes:
    """Version 2 of a learned record: where the best's largest errors were is not in it. Raises
    InputError when ``record`` is not sound."""
    if record[4:6] == _UNVISITED:
        return record
    struct = _memory(record)
    struct.peaks.count = 0
    return _encode(lib.record_encode_memory, struct, 3, struct.beats)


def without_visits(record: bytes) -> bytes:
    """Version 1 of a learned record. A board that knows no other asks only whether the amplitudes
    are the first guess, which it makes anew."""
    record = without_peaks(record)
    if record[4:6] == _UNVISITED:
        return record
    first = record[_INPUT] == lib.MEMORY_INPUT_FIRST.to_bytes(2, "little")
    body = bytearray(record[_HEADER_BYTES : -len(learned_visits(record))])
    body[_INPUT.start - _HEADER_BYTES : _INPUT.stop - _HEADER_BYTES] = bytes([first, 0])
    head = record[:4] + b"\1\0" + record[6:8]
    return head + crc32(head + body).to_bytes(4, "little") + body


def _beats(values: ArrayLike | Sequence[float], what: str) -> F32:
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.ndim != 1 or not 1 <= array.size <= lib.NATIVE_BEATS_MAX:
        raise InputError(
            f"{array.size} {what}s given", f"Give one per beat, 1 to {lib.NATIVE_BEATS_MAX} in all."
        )
    return array


def _fill(target: Any, values: F32) -> None:
    ffi.memmove(target, values.tobytes(), values.nbytes)


def _array(source: Any, count: int) -> F32:
    return np.frombuffer(ffi.buffer(source), dtype=np.float32, count=count).copy()


def _encode(encoder: Any, struct: Any, arrays: int, beats: int) -> bytes:
    out = ffi.new("uint8_t[]", _FIXED_BYTES + 4 * arrays * beats)
    return bytes(ffi.buffer(out, encoder(struct, out)))


def _memory(record: bytes) -> Any:
    return _decoded("memory_t *", lib.record_decode_memory, record, "learned record")


def _decoded(kind: str, decoder: Any, record: bytes, what: str) -> Any:
    """The C struct of a record. Raises InputError."""
    struct = ffi.new(kind)
    if fault := int(decoder(ffi.from_buffer(record), len(record), struct)):
        raise InputError(f"not a sound {what}: {fault_info(fault).meaning}", "Make it again.")
    return struct


def _record(made: type[T], struct: Any) -> T:
    """A dataclass from the fields of the same names; its arrays have a value per beat."""
    values = {f.name: getattr(struct, f.name) for f in fields(made)}  # type: ignore[arg-type]
    arrays = {f.name for f in fields(made) if f.type == "F32"}  # type: ignore[arg-type]
    return made(**{n: _array(v, struct.beats) if n in arrays else v for n, v in values.items()})


def unpack_log(content: bytes) -> bytes:
    """Unpack a log of a trial, with the board's own code.

    Parameters
    ----------
    content : bytes
        The stored file. A log of earlier firmware is not packed.

    Returns
    -------
    bytes
        The ULog; ``content`` itself if it is not packed. Pieces that cannot be unpacked are zeros.
    """
    if content[: len(_PACKED_MAGIC)] != _PACKED_MAGIC:
        return content
    room = lib.NATIVE_PACKED_GAIN_MAX * len(content)
    ulog = ffi.new("uint8_t[]", room)
    length = lib.unpacker_all(content, len(content), ulog, room, ffi.new("bool *"))
    return bytes(ffi.buffer(ulog, length))
