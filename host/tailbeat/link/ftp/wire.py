"""MAVLink FTP on the wire: operations, errors, payloads."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tailbeat.core.errors import TransferError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import (
    BOARD_COMPONENT,
    BOARD_SYSTEM,
    HOST_COMPONENT,
    HOST_SYSTEM,
    Message,
)

DATA_BYTES = 239  # most that one frame carries
TERMINATE, RESET = 1, 2
LIST, OPEN_READ, READ, CREATE, WRITE, REMOVE = 3, 4, 5, 6, 7, 8
CRC32, BURST = 14, 15
ACK, NAK = 128, 129
INVALID_SESSION, NO_SESSION, END_OF_FILE, NOT_FOUND = 4, 5, 6, 10

_HEADER = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES = 251
_MEANINGS = {
    1: "it failed",
    2: "its file system failed",
    3: "the request had a bad size",
    4: "the transfer session ended",
    5: "another client holds the only transfer session",
    6: "end of file",
    7: "it does not know the request",
    8: "the file exists already",
    9: "the file is protected",
    10: "there is no such file",
}
_REMEDIES = {
    4: "Run the same command again; a pull goes on where it stopped.",
    5: "Close the other program, or wait five seconds after its last word, and try again.",
    9: "Wait until no trial runs, or see what is there: tailbeat trial list.",
    10: "See what is there: tailbeat trial list.",
}


class FtpError(TransferError):
    """The board's own refusal; ``code`` is that of MAVLink FTP."""

    def __init__(self, code: int, path: str) -> None:
        meaning = _MEANINGS.get(code, f"error {code}")
        super().__init__(f"the board refused {path}: {meaning}", _REMEDIES.get(code, "Try again."))
        self.code = code


@dataclass(frozen=True)
class Request:
    """One payload to the board. ``size``: bytes asked for, where ``data`` does not say it."""

    seq: int
    session: int
    opcode: int
    offset: int = 0
    data: bytes = b""
    size: int | None = None

    def message(self) -> Message:
        """As FILE_TRANSFER_PROTOCOL to the board."""
        length = len(self.data) if self.size is None else self.size
        head = _HEADER.pack(self.seq, self.session, self.opcode, length, 0, 0, 0, self.offset)
        payload = (head + self.data).ljust(_PAYLOAD_BYTES, b"\0")
        return mavlink.MAVLink_file_transfer_protocol_message(
            0, BOARD_SYSTEM, BOARD_COMPONENT, payload
        )


@dataclass(frozen=True)
class Reply:
    """One payload from the board. ``request``: the operation it answers."""

    seq: int
    session: int
    opcode: int
    request: int
    complete: bool
    offset: int
    data: bytes

    @property
    def error(self) -> int:
        """The refusal's code; 0 when it is none."""
        if self.opcode == ACK:
            return 0
        return self.data[0] if self.data and self.data[0] else 1


def parse(message: Message) -> Reply:
    """What a FILE_TRANSFER_PROTOCOL message says."""
    payload = bytes(message.payload)
    seq, session, opcode, size, request, complete, _, offset = _HEADER.unpack_from(payload)
    data = payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)]
    return Reply(seq, session, opcode, request, bool(complete), offset, data)


def is_for_us(message: Message) -> bool:
    """Whether this host was addressed."""
    system_ok = message.target_system in (0, HOST_SYSTEM)
    return system_ok and message.target_component in (0, HOST_COMPONENT)
