"""Frames out of bytes, packed and read as the generated module does, in a third of the time.

A trial sends a speed for every picture of the camera, and a board reports ten times a second.
Signed frames go the generated way, as their signature takes longer than all else, and so do
messages with arrays.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from tailbeat.link import _dialect as mavlink

_MARKER = 0xFD
_HEADER_BYTES, _CRC_BYTES, _SIGNATURE_BYTES = 10, 2, 13
_HEAD = struct.Struct("<BBBBBBBHB")  # of MAVLink 2
_CRC = struct.Struct("<H")
_PAYLOAD_FROM = 6  # where the generated module takes the payload of a message to begin
_generated = mavlink.MAVLink_message._pack


def _pack(
    message: Any, mav: Any, crc_extra: int, payload: bytes, force_mavlink1: bool = False
) -> bytes:
    crc_of = mavlink.mcrf4xx
    if force_mavlink1 or mav.signing.sign_outgoing:
        return bytes(_generated(message, mav, crc_extra, payload, force_mavlink1))
    payload = payload.rstrip(b"\0") or payload[:1]
    number = message._header.msgId
    source = mav.seq, mav.srcSystem, mav.srcComponent
    head = _HEAD.pack(0xFD, len(payload), 0, 0, *source, number & 0xFFFF, number >> 16)
    checked = head[1:] + payload
    return b"\xfd" + checked + _CRC.pack(crc_of(checked + bytes((crc_extra,))))


mavlink.MAVLink_message._pack = _pack


@cache
def _has_arrays(kind: Any) -> bool:
    return bool(sum(kind.lengths) != len(kind.lengths))


def decode(mav: Any, frame: bytearray) -> Any:
    """The message in a whole frame of a known kind. Raises whatever damaged bytes provoke."""
    kind = mavlink.mavlink_map[int.from_bytes(frame[7:_HEADER_BYTES], "little")]
    crc_of, end = mavlink.mcrf4xx, len(frame) - _CRC_BYTES
    if frame[2] or _has_arrays(kind):
        return mav.decode(frame)
    (crc,) = _CRC.unpack_from(frame, end)
    if crc != crc_of(bytes(frame[1:end]) + bytes((kind.crc_extra,))):
        raise mavlink.MAVError("wrong CRC")
    values = kind.unpacker.unpack(frame[_HEADER_BYTES:end].ljust(kind.unpacker.size, b"\0"))
    ordered = [values[place] for place in kind.orders]
    if "s" in kind.unpacker.format:
        ordered = [v.rstrip(b"\0") if isinstance(v, bytes) else v for v in ordered]
    message = kind(*ordered)
    message._msgbuf, message._payload, message._crc = frame, frame[_PAYLOAD_FROM:end], crc
    header = message._header
    header.mlen, header.seq, header.srcSystem, header.srcComponent = frame[1], *frame[4:7]
    header.compat_flags = frame[3]
    return message


class Framer:
    """Bytes to messages. Behind the marker of a damaged frame the search goes on."""

    def __init__(self, mav: Any) -> None:
        self._mav = mav
        self._buffer = bytearray()
        self.bad_frames = 0

    def pull(self) -> bytes:
        """Gives back the begin of a frame that waits for its rest."""
        begun = bytes(self._buffer)
        self._buffer.clear()
        return begun

    def push(self, data: bytes) -> list[Any]:
        """Messages completed by ``data``. Never raises, whatever the bytes are."""
        buffer = self._buffer
        buffer += data
        messages: list[Any] = []
        at = 0
        while True:
            at = buffer.find(_MARKER, at)
            if at < 0:
                buffer.clear()
                return messages
            if len(buffer) - at < _HEADER_BYTES:
                break
            length = self.frame_length(buffer, at)
            if length > len(buffer) - at:
                break
            message = self._decode(buffer[at : at + length]) if length else None
            if message is None:
                at += 1
            else:
                messages.append(message)
                at += length
        del buffer[:at]
        return messages

    @staticmethod
    def frame_length(buffer: bytearray, at: int) -> int:
        """Whole length of the frame at ``at``; 0 when this cannot be one."""
        flags = buffer[at + 2]
        kind = mavlink.mavlink_map.get(int.from_bytes(buffer[at + 7 : at + 10], "little"))
        if flags & ~1 or kind is None or buffer[at + 1] > kind.unpacker.size:
            return 0
        tail = _CRC_BYTES + (_SIGNATURE_BYTES if flags & 1 else 0)
        return _HEADER_BYTES + int(buffer[at + 1]) + tail

    def _decode(self, frame: bytearray) -> Any:
        try:
            return decode(self._mav, frame)
        except Exception:  # whatever damaged bytes provoke in generated code is a bad frame
            self.bad_frames += 1
            return None
