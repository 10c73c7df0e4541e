"""ULog records, version 1 (PX4's file format), read from bytes and made as bytes.

https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

HEADER_BYTES = 16
RECORD_TYPES = b"FIMPQARDSOLCB"
_RECORD_HEADER_BYTES = 3
_SYSTEM_DEFAULT = 1  # of the bits of a default parameter
SIZES = {
    "int8_t": 1, "uint8_t": 1, "bool": 1, "char": 1, "int16_t": 2, "uint16_t": 2,
    "int32_t": 4, "uint32_t": 4, "float": 4, "int64_t": 8, "uint64_t": 8, "double": 8,
}  # fmt: skip


@dataclass(frozen=True)
class Record:
    """One record of a file.

    Attributes
    ----------
    kind : bytes
        Its type, one letter.
    body : bytes
        What follows the length and the type.
    """

    kind: bytes
    body: bytes

    def content(self) -> bytes:
        """The record as it is in a file."""
        return struct.pack("<Hc", len(self.body), self.kind) + self.body


def records(ulog: bytes) -> Iterator[Record]:
    """Whole records behind the file header, up to the first that is damaged or cut off.

    Parameters
    ----------
    ulog : bytes
        A ULog file.

    Yields
    ------
    Record
        In the order of the file.
    """
    at = HEADER_BYTES
    while at + _RECORD_HEADER_BYTES <= len(ulog):
        size, kind = struct.unpack_from("<Hc", ulog, at)
        end = at + _RECORD_HEADER_BYTES + size
        if size == 0 or kind not in RECORD_TYPES or end > len(ulog):
            return
        yield Record(kind, ulog[at + _RECORD_HEADER_BYTES : end])
        at = end


def info(key: str, value: bytes) -> Record:
    """An information record; ``key`` is ``TYPE NAME``, ``value`` little-endian bytes."""
    return Record(b"I", bytes([len(key)]) + key.encode("ascii") + value)


def info_text(name: str, text: str) -> Record:
    """An information record that holds text."""
    value = text.encode()
    return info(f"char[{len(value)}] {name}", value)


def default_parameter(name: str, value: float) -> Record:
    """The system-wide default of a parameter of type float."""
    key = f"float {name}".encode("ascii")
    return Record(b"Q", bytes([_SYSTEM_DEFAULT, len(key)]) + key + struct.pack("<f", value))


def topic_format(topic: str, fields: dict[str, str]) -> Record:
    """The fields of a topic, name to type; the first is ``timestamp``."""
    text = "".join(f"{kind} {name};" for name, kind in fields.items())
    return Record(b"F", f"{topic}:{text}".encode("ascii"))


def subscription(message_id: int, topic: str) -> Record:
    """The number under which data of a topic follow."""
    return Record(b"A", struct.pack("<BH", 0, message_id) + topic.encode("ascii"))


def data(message_id: int, values: bytes) -> Record:
    """One message of a topic; ``values`` begin with the timestamp."""
    return Record(b"D", struct.pack("<H", message_id) + values)


def fields_of(description: bytes) -> tuple[str, dict[str, str]]:
    """(topic, field name to type) of a format record's body."""
    topic, _, rest = description.decode("ascii", "replace").partition(":")
    pairs = (one.partition(" ") for one in rest.split(";") if one)
    return topic, {name: kind for kind, _, name in pairs}


def offset_of(fields: dict[str, str], name: str) -> int | None:
    """Bytes before a field in a data record's body; None: there is no such field of known size."""
    at = 2
    for field, kind in fields.items():
        if field == name:
            return at
        if kind not in SIZES:
            return None
        at += SIZES[kind]
    return None
