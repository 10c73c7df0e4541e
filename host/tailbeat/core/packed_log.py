"""Logs as the board packs them, and the ULog that they hold (docs/protocol.md, packed logs)."""

from __future__ import annotations

from tailbeat.core.native import ffi, lib

_MAGIC = b"ULz1"


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
    if content[: len(_MAGIC)] != _MAGIC:
        return content
    room = lib.NATIVE_PACKED_GAIN_MAX * len(content)
    ulog = ffi.new("uint8_t[]", room)
    length = lib.unpacker_all(content, len(content), ulog, room, ffi.new("bool *"))
    return bytes(ffi.buffer(ulog, length))
