"""MAVLink FTP on the wire: operations, errors, payloads, and the requests under way."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from tailbeat.core.errors import LinkLostError, TransferError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import (
    BOARD_COMPONENT,
    BOARD_SYSTEM,
    HOST_COMPONENT,
    HOST_SYSTEM,
    Link,
    Message,
)

_STALLED_S = 25.0  # without anything new: some fifteen rounds
_DEAD_S = 12.0  # without a word from the board


@dataclass
class Asked:
    """A request that waits for its answer."""

    order: int
    sent_s: float
    due_s: float
    tries: int
    alone: bool  # nothing else on the line, so that its answer tells the round trip


class RequestWindow:
    """Requests under way, by file offset. The line keeps the order of what passes: an answer to a
    later request means that those before it are lost."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._round_trip = link.round_trip
        self._asked: dict[int, Asked] = {}
        self._order = 0

    def tries(self, offset: int) -> int:
        """How often that was asked."""
        return self._asked[offset].tries if offset in self._asked else 0

    def waits(self, offset: int) -> bool:
        """Whether its answer may still come."""
        asked = self._asked.get(offset)
        return asked is not None and self._link.transport.now_s() < asked.due_s

    def under_way(self) -> int:
        """How many answers may still come."""
        now_s = self._link.transport.now_s()
        return sum(now_s < asked.due_s for asked in self._asked.values())

    def next_due_s(self) -> float:
        """When the first answer is overdue; infinite without any."""
        now_s = self._link.transport.now_s()
        due = (asked.due_s for asked in self._asked.values() if asked.due_s > now_s)
        return min(due, default=float("inf"))

    def say(self, offset: int, least_s: float = 0.0) -> None:
        """It is being asked now; ``least_s``: the answer has other things before it."""
        now_s = self._link.transport.now_s()
        tries = self.tries(offset) + 1
        self._order += 1
        patience_s = self._link.patient(max(self._round_trip.patience_s(tries), least_s))
        self._asked[offset] = Asked(self._order, now_s, now_s + patience_s, tries, least_s == 0)

    def answered(self, offset: int) -> None:
        """Its answer has come."""
        asked = self._asked.pop(offset, None)
        if asked is None:
            return
        if asked.alone:
            took_s = self._link.transport.now_s() - asked.sent_s
            self._round_trip.heard(took_s, asked.tries)
        for earlier in self._asked.values():
            if earlier.order < asked.order:
                earlier.due_s = earlier.sent_s

    def forget(self) -> None:
        """None of them will be answered."""
        self._asked.clear()


class StallTimer:
    """Ends a transfer in which nothing new comes."""

    def __init__(self, link: Link, remedy: str) -> None:
        self._link = link
        self._remedy = remedy
        self._since_s = link.transport.now_s()

    def moved(self) -> None:
        """Something new has come."""
        self._since_s = self._link.transport.now_s()

    def check(self, what: str) -> None:
        """Raises LinkLostError, ``what`` being how far it came, when it has been too long."""
        link = self._link
        waited_s = link.transport.now_s() - self._since_s
        silent_s = min(waited_s, link.transport.now_s() - link.last_heard_s)
        if waited_s > link.patient(_STALLED_S) or silent_s > link.patient(_DEAD_S):
            raise LinkLostError(
                f"{what} and then nothing for {waited_s:.0f} s on {link.transport.name}",
                f"Check power, cable and Bluetooth, then {self._remedy}.",
            )


Progress = Callable[[int, int], None]
"""Told the bytes done and the total, while a file is carried."""

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
    5: "Close the other program, or wait five seconds after its last message, and try again.",
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
class FtpRequest:
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
class FtpReply:
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


def parse(message: Message) -> FtpReply:
    """What a FILE_TRANSFER_PROTOCOL message says."""
    payload = bytes(message.payload)
    seq, session, opcode, size, request, complete, _, offset = _HEADER.unpack_from(payload)
    data = payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)]
    return FtpReply(seq, session, opcode, request, bool(complete), offset, data)


def is_for_us(message: Message) -> bool:
    """Whether this host was addressed."""
    system_ok = message.target_system in (0, HOST_SYSTEM)
    return system_ok and message.target_component in (0, HOST_COMPONENT)
