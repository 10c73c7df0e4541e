"""Frames as the generated module packs and reads them, byte for byte, in a third of the time.

A trial sends a speed for every picture of the camera, and a board reports ten times a second.
Signed frames go the generated way, as their signature takes longer than all else, and so do
messages with arrays.
"""

from __future__ import annotations

import struct
from typing import Any

from tailbeat.link import _dialect as mavlink

HEADER_BYTES, CRC_BYTES = 10, 2
_HEAD = struct.Struct("<BBBBBBBHB")  # of MAVLink 2
_CRC = struct.Struct("<H")
_PAYLOAD_FROM = 6  # where the generated module takes the payload of a message to begin
_generated = mavlink.MAVLink_message._pack


def _pack(
    message: Any, mav: Any, crc_extra: int, payload: bytes, force_mavlink1: bool = False
) -> bytes:
    crc_of = mavlink.mcrf4xx
    if force_mavlink1 or mav.signing.sign_outgoing or crc_of is None:
        return bytes(_generated(message, mav, crc_extra, payload, force_mavlink1))
    payload = payload.rstrip(b"\0") or payload[:1]
    number = message._header.msgId
    source = mav.seq, mav.srcSystem, mav.srcComponent
    head = _HEAD.pack(0xFD, len(payload), 0, 0, *source, number & 0xFFFF, number >> 16)
    checked = head[1:] + payload
    return b"\xfd" + checked + _CRC.pack(crc_of(checked + bytes((crc_extra,))))


mavlink.MAVLink_message._pack = _pack


def decode(mav: Any, frame: bytearray) -> Any:
    """The message in a whole frame of a known kind. Raises whatever damaged bytes provoke."""
    kind = mavlink.mavlink_map[int.from_bytes(frame[7:HEADER_BYTES], "little")]
    crc_of, end = mavlink.mcrf4xx, len(frame) - CRC_BYTES
    if frame[2] or crc_of is None or sum(kind.lengths) != len(kind.lengths):
        return mav.decode(frame)
    (crc,) = _CRC.unpack_from(frame, end)
    if crc != crc_of(bytes(frame[1:end]) + bytes((kind.crc_extra,))):
        raise mavlink.MAVError("wrong CRC")
    values = kind.unpacker.unpack(frame[HEADER_BYTES:end].ljust(kind.unpacker.size, b"\0"))
    ordered = [values[place] for place in kind.orders]
    message = kind(*(v.rstrip(b"\0") if isinstance(v, bytes) else v for v in ordered))
    message._msgbuf, message._payload, message._crc = frame, frame[_PAYLOAD_FROM:end], crc
    header = message._header
    header.mlen, header.seq, header.srcSystem, header.srcComponent = frame[1], *frame[4:7]
    header.compat_flags = frame[3]
    return message
