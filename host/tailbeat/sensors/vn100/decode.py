"""Bytes of a VN-100 to messages with named values, by the firmware's own reader."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from tailbeat.core.imu_fields import ASCII, BINARY, GROUP_NAMES, Field
from tailbeat.core.native import ffi, lib

Values = dict[str, float | int]

_CHUNK_BYTES = 65536
_FIELD_BITS = 16


@dataclass(frozen=True)
class Layout:
    """What a binary header announces. ``places``: offset in the frame, how to read it, names."""

    header: str
    places: tuple[tuple[int, Field, tuple[str, ...]], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all values, in the order of the wire."""
        return tuple(name for _, _, names in self.places for name in names)


@dataclass(frozen=True)
class Binary:
    """One checked binary frame.

    Attributes
    ----------
    offset : int
        Of its sync byte in the stream.
    data : bytes
        The whole frame, header and CRC included.
    """

    offset: int
    data: bytes

    @property
    def layout(self) -> Layout:
        """What is in it."""
        return layout_of(self.data[: header_bytes(self.data)])

    @property
    def kind(self) -> str:
        """Layouts that differ have different kinds."""
        return self.layout.header

    @property
    def check(self) -> int:
        """Its CRC as it was sent."""
        return int.from_bytes(self.data[-2:], "big")

    @cached_property
    def values(self) -> Values:
        """By name; fields of a group of the same name as one before get the group's name in front.
        Single precision as the sensor sends it."""
        found: Values = {}
        for offset, field, names in self.layout.places:
            found.update(zip(names, field.layout.unpack_from(self.data, offset), strict=True))
        return found


@dataclass(frozen=True)
class AsciiLine:
    """One checked ASCII line.

    Attributes
    ----------
    offset : int
        Of its first byte in the stream.
    data : bytes
        The whole line.
    fields : tuple of str
        The texts between the commas, the type first.
    check, check_bits : int
        Its checksum as it was sent, and how many bits that has: 8 or 16.
    values : dict of str to float or int
        By name, units in the names; empty when it is no measurement.
    error : int
        Code of a ``$VNERR`` line, otherwise 0.
    """

    offset: int
    data: bytes
    fields: tuple[str, ...]
    check: int
    check_bits: int
    values: Values
    error: int

    @property
    def kind(self) -> str:
        """Its type, with T or S behind it for the optional fields at its end."""
        return self.fields[0] + "".join(_SUFFIXES[n] for n in self.values if n in _SUFFIXES)

    @property
    def type(self) -> str:
        """VNYMR, VNRRG, …"""
        return self.fields[0]


Message = Binary | AsciiLine

_SUFFIXES = {"serial_count": "T", "vpe_status": "S"}


@dataclass(frozen=True)
class Counters:
    """The reader's: see firmware/imu/reader.h."""

    binary: int
    lines: int
    crc_failed: int
    checksum_failed: int
    header_rejects: int
    dropped: int
    skipped_bytes: int


def counters_of(reader: Any) -> Counters:
    """The counters of an ``imu_reader_t``."""
    c = reader.counters
    return Counters(*(int(getattr(c, name)) for name in Counters.__dataclass_fields__))


class Reader:
    """Takes bytes in chunks of any size and gives the messages in them, each once.

    Attributes
    ----------
    bytes : int
        Taken in so far.
    """

    def __init__(self) -> None:
        self.bytes = 0  # taken in so far
        self._reader = ffi.new("imu_reader_t *")
        self._message = ffi.new("imu_message_t *")
        self._got = ffi.new("bool *")
        self._handed_out = 0
        lib.imu_reader_init(self._reader, ffi.NULL, 0)

    def push(self, data: bytes) -> list[Message]:
        """Take bytes in.

        Parameters
        ----------
        data : bytes
            The next bytes of the stream, any number.

        Returns
        -------
        list of Message
            The messages that they complete.
        """
        found: list[Message] = []
        buffer = ffi.from_buffer("uint8_t[]", data)
        taken = 0
        self.bytes += len(data)
        while True:
            taken += lib.imu_reader_push(
                self._reader, buffer + taken, len(data) - taken, self._message, self._got
            )
            if self._got[0]:
                found.append(self._take())
            elif taken == len(data):
                return found

    def end(self) -> list[Message]:
        """The stream is silent or over: messages in what was held back."""
        found: list[Message] = []
        while lib.imu_reader_silence(self._reader, self._message):
            found.append(self._take())
        return found

    def count_anew(self) -> None:
        """Counters, bytes and offsets begin at zero; what is held back stays."""
        reader = self._reader
        self.bytes = int(reader.held - reader.taken)
        self._handed_out = 0
        reader.counters = ffi.new("imu_reader_counters_t *")[0]

    @property
    def counters(self) -> Counters:
        """What was read so far."""
        return counters_of(self._reader)

    def _take(self) -> Message:
        message = self._message
        data = bytes(ffi.buffer(message.bytes, message.length))
        offset = self._handed_out + int(self._reader.counters.skipped_bytes)
        self._handed_out += len(data)
        if message.kind == lib.IMU_BINARY:
            return Binary(offset, data)
        return _line(offset, data, message)


def decode(data: bytes | Iterable[bytes], reader: Reader | None = None) -> Iterator[Message]:
    """Decode all messages of a recording.

    Parameters
    ----------
    data : bytes or iterable of bytes
        The recording, or the chunks it comes in.
    reader : Reader, optional
        Counts what was read; default: a new one.

    Yields
    ------
    Message
        In the order of the stream.
    """
    reader = reader or Reader()
    if isinstance(data, bytes):
        whole = data
        data = (whole[at : at + _CHUNK_BYTES] for at in range(0, len(whole), _CHUNK_BYTES))
    for chunk in data:
        yield from reader.push(chunk)
    yield from reader.end()


def header_bytes(frame: bytes) -> int:
    """Length of a binary frame's header."""
    return 2 + 2 * frame[1].bit_count()


@cache
def layout_of(header: bytes) -> Layout:
    """What ``header``, from the sync byte to the last field word, announces."""
    words = [header[at : at + 2] for at in range(2, len(header), 2)]
    text = ",".join(f"{int.from_bytes(word, 'little'):04X}" for word in words)
    seen: set[str] = set()
    places = []
    for group in (g for g in GROUP_NAMES if header[1] >> g & 1):
        for bit in range(_FIELD_BITS):
            place = _field_place(header, group, bit)
            if place is None:
                continue
            offset, field = place
            names = tuple(f"{GROUP_NAMES[group]}_{n}" if n in seen else n for n in field.names)
            seen.update(names)
            places.append((offset, field, names))
    return Layout(f"groups={header[1]:02X} fields={text}", tuple(places))


def _field_place(header: bytes, group: int, bit: int) -> tuple[int, Field] | None:
    offset, size = ffi.new("uint16_t *"), ffi.new("uint16_t *")
    present = lib.imu_layout_field(ffi.from_buffer("uint8_t[]", header), group, bit, offset, size)
    field = BINARY.get((group, bit))
    if not present or field is None or field.layout.size != size[0]:
        return None
    return int(offset[0]), field


def _line(offset: int, data: bytes, message: Any) -> AsciiLine:
    body = lib.imu_line_body(message)
    count = lib.imu_line_fields(body)
    texts = [lib.imu_line_field(body, number) for number in range(count)]
    fields = tuple(_chars(text) for text in texts)
    wide = lib.imu_line_check(message) == lib.IMU_CHECK_CRC16
    digits = data.rpartition(b"*")[2][: 4 if wide else 2]
    return AsciiLine(
        offset,
        data,
        fields,
        int(digits, 16),
        16 if wide else 8,
        _line_values(texts, fields),
        int(lib.imu_line_error(body)),
    )


def _chars(text: Any) -> str:
    return bytes(ffi.buffer(text.chars, text.length)).decode("ascii") if text.length else ""


def _line_values(texts: list[Any], fields: tuple[str, ...]) -> Values:
    """Empty when the fields are not those of the line's type."""
    names = ASCII.get(fields[0], ())
    if not names or len(fields) <= len(names):
        return {}
    found: Values = {}
    number = ffi.new("float *")
    for name, text, chars in zip(names, texts[1:], fields[1:], strict=False):
        if not lib.imu_text_float(text, number):
            return {}
        # Single precision keeps the digits of the line; this brings back exactly those.
        found[name] = round(number[0], len(chars.partition(".")[2]))
    for text, chars in zip(texts[1 + len(names) :], fields[1 + len(names) :], strict=True):
        name, value = _suffix(text, chars)
        if not name or name in found:
            return {}
        found[name] = value
    return found


def _suffix(text: Any, chars: str) -> tuple[str, int]:
    """The optional fields: a count or time behind T, the VPE status in hexadecimal behind S."""
    names = {letter: name for name, letter in _SUFFIXES.items()}
    name = names.get(chars[:1], "")
    value = ffi.new("uint32_t *")
    number = ffi.new("imu_text_t *", {"chars": text.chars + 1, "length": max(text.length, 1) - 1})
    if not lib.imu_text_unsigned(number[0], 16 if name == "vpe_status" else 10, value):
        return "", 0
    return name, int(value[0])
