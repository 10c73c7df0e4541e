"""The interface of every link to a board, and what bytes mean that come from no board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tailbeat.link import _dialect as mavlink

# What the firmware sends on the console at every reset, before anything in it can hang.
START_LINE = b"tailbeat starts"
BLUETOOTH_SETUP = "tailbeat board bluetooth"
_KEPT_BYTES = 4096
_MARKER = 0xFD
_HEADER_BYTES = 10
_TEXT = frozenset(range(0x20, 0x7F)) | {0x09, 0x0A, 0x0D, 0x1B}
_WORDY = frozenset(b"0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz")
_TEXT_SHARE_MIN, _WORDY_SHARE_MIN, _TEXT_BYTES_MIN = 0.9, 0.4, 8
# Through a module at 9600 baud a heartbeat is one byte or two: three seconds may be three bytes.
_GARBAGE_BYTES_MIN = 2
_GARBAGE_SPAN_S = 0.5  # a crackle when the port opens is not a board that goes on talking

_FIRST_S, _LEAST_S, _MOST_S = 0.25, 0.08, 2.0
_BACKOFF = 1.5
_PATIENT_FROM = 3  # tries; two that are lost say little about the line


@dataclass
class Hearing:
    """Bytes that held no message of a board: how many, what they look like, since when."""

    name: str
    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    strangers: int = 0  # heartbeats of others
    kept: bytes = b""

    def add(self, data: bytes, now_s: float) -> None:
        """Takes in what was heard at ``now_s``."""
        if not data:
            return
        if self.count == 0:
            self.first_s = now_s
        self.last_s = now_s
        self.count += len(data)
        self.kept = (self.kept + data)[:_KEPT_BYTES]

    @property
    def kind(self) -> str:
        """silence, stranger (MAVLink of another), damaged (MAVLink of a board), text, garbage (of
        another speed), noise (too little to tell), or hung (the firmware starts and then says no
        more)."""
        if START_LINE in self.kept:
            return "hung"
        if self.strangers:
            return "stranger"
        if self.count == 0:
            return "silence"
        if _has_header(self.kept):
            return "damaged"
        if _is_text(self.kept):
            return "text"
        unreadable = self.count >= _TEXT_BYTES_MIN or not _TEXT.issuperset(self.kept)
        enough = self.count >= _GARBAGE_BYTES_MIN and unreadable
        return "garbage" if enough and self.last_s - self.first_s >= _GARBAGE_SPAN_S else "noise"

    def words(self) -> tuple[str, str]:
        """What is wrong, and what to do."""
        name = self.name
        return {
            "silence": (
                f"there is no tailbeat board on {name}",
                "Nothing was received. Check that it is switched on, that the Bluetooth module is"
                " paired and out of the water. Check the address.",
            ),
            "noise": (
                f"there is no tailbeat board on {name}",
                f"Of {self.count} bytes heard none is MAVLink. Check the cable, and that this is"
                " the right address.",
            ),
            "hung": (
                f"the firmware on {name} starts, but then does not answer",
                "Press RESET and try again. If that does not help, write the firmware again:"
                " 'tailbeat board flash'.",
            ),
            "stranger": (
                f"there is no tailbeat board on {name}, but another MAVLink system",
                "Check that this is the right address.",
            ),
            "damaged": (
                f"MAVLink comes on {name}, but every frame of it is damaged",
                "Check cable, ground and Bluetooth (the antenna must be out of the water). If it"
                " stays, tool and firmware differ in version.",
            ),
            "text": (
                f"there is no tailbeat board on {name}: what comes is text",
                "Another device or firmware is on that port. 'tailbeat board flash' writes ours.",
            ),
            "garbage": (
                f"bytes come on {name} but no MAVLink: the Bluetooth module is probably still at"
                " 9600 baud",
                f"Raise it with: {BLUETOOTH_SETUP}",
            ),
        }[self.kind]

    def short(self) -> str:
        """The same in a few words, for a list of places that were tried."""
        return {
            "garbage": "bytes come but no MAVLink",
            "damaged": "every frame is damaged",
        }.get(self.kind, "no tailbeat heartbeat")


def _is_text(data: bytes) -> bool:
    """Whether somebody may have meant it to be read; a slow receiver makes spaces and signs, too,
    but few letters and digits."""
    printable = sum(byte in _TEXT for byte in data)
    wordy = sum(byte in _WORDY for byte in data)
    return (
        len(data) >= _TEXT_BYTES_MIN
        and printable > _TEXT_SHARE_MIN * len(data)
        and wordy > _WORDY_SHARE_MIN * len(data)
    )


def _has_header(data: bytes) -> bool:
    """Whether a board's frame begins somewhere in it: of six bytes that are known before."""
    at = data.find(_MARKER)
    while 0 <= at <= len(data) - _HEADER_BYTES:
        kind = mavlink.mavlink_map.get(int.from_bytes(data[at + 7 : at + 10], "little"))
        known = kind is not None and data[at + 1] <= kind.unpacker.size
        if known and data[at + 2] <= 1 and data[at + 5 : at + 7] == b"\x01\x01":
            return True
        at = data.find(_MARKER, at + 1)
    return False


class Transport(Protocol):
    """A byte stream to a board, and the clock that its waits are measured with.

    For a real link the clock is the machine's monotonic one. For a board in this process it is the
    simulated time, and waiting is what makes that time pass.
    """

    name: str

    def read(self) -> bytes:
        """What has arrived; never blocks. Raises LinkLostError when the other end is gone."""

    def write(self, data: bytes) -> None:
        """Queues bytes for sending; never blocks. Raises LinkLostError as read does."""

    def wait(self, timeout_s: float) -> None:
        """Returns after ``timeout_s``, or earlier when there may be bytes to read."""

    def now_s(self) -> float:
        """The clock. Monotonic, any origin."""

    def reopen(self) -> None:
        """Tries once to establish the link again. Raises ConnectError."""

    def close(self) -> None:
        """Gives the link up; may be called twice."""


class InFront:
    """What stands in front of the transport ``inner``, as a bad line does."""

    inner: Transport


class RoundTrip:
    """How long an answer takes on this link: mean and spread, as TCP keeps them."""

    def __init__(self) -> None:
        self._mean_s = -1.0
        self._spread_s = 0.0

    def heard(self, took_s: float, tries: int = 1) -> None:
        """An answer came so long after the last of so many ``tries``; which of them it answers is
        not known, so that more than one tells something only as long as nothing is known."""
        if self._mean_s < 0:
            self._mean_s, self._spread_s = took_s, took_s / 2
        if tries > 1:
            return
        self._spread_s += (abs(took_s - self._mean_s) - self._spread_s) / 4
        self._mean_s += (took_s - self._mean_s) / 8

    def patience_s(self, tries: int) -> float:
        """How long to wait for the answer to the last of so many ``tries``."""
        wait_s = self._mean_s + 4 * self._spread_s if self._mean_s >= 0 else _FIRST_S
        wait_s = max(wait_s, _LEAST_S)
        for _ in range(_PATIENT_FROM, tries):
            wait_s = min(wait_s * _BACKOFF, max(wait_s, _MOST_S))
        return wait_s
