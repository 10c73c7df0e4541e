"""The MAVLink conversation with one board: framing, heartbeats, requests with retries."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from tailbeat import _dialect as mavlink
from tailbeat.errors import LinkLostError, Refused, TailbeatError
from tailbeat.faults import UNKNOWN_COMMAND, WRONG_STATE, refusal
from tailbeat.transport.base import Transport

Message = Any  # pymavlink's message classes carry their fields dynamically
Where = Callable[[Message], bool]

HOST_SYSTEM = 255
HOST_COMPONENT = 190
BOARD_SYSTEM = 1
BOARD_COMPONENT = 1

HEARTBEAT_PERIOD_S = 1.0  # of board time
REPLY_TIMEOUT_S = 0.7
TRIES = 6
_BACKOFF = 1.3
_TIMEOUT_MAX_S = 2.0
_INBOX_MAX = 8192
_PROGRESS_MAX = 100  # of "in progress" before a command is said again
_MARKER = 0xFD
_HEADER_BYTES = 10
_CRC_BYTES = 2
_SIGNATURE_BYTES = 13


class Framer:
    """Bytes to messages. Behind the marker of a damaged frame the search goes on."""

    def __init__(self, mav: Any) -> None:
        self._mav = mav
        self._buffer = bytearray()
        self.bad_frames = 0

    def push(self, data: bytes) -> list[Message]:
        """Messages completed by ``data``. Never raises, whatever the bytes are."""
        buffer = self._buffer
        buffer += data
        messages: list[Message] = []
        at = 0
        while True:
            at = buffer.find(_MARKER, at)
            if at < 0:
                buffer.clear()
                return messages
            if len(buffer) - at < _HEADER_BYTES:
                break
            length = self._frame_length(buffer, at)
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
    def _frame_length(buffer: bytearray, at: int) -> int:
        """Whole length of the frame at ``at``; 0 when this cannot be one."""
        flags = buffer[at + 2]
        kind = mavlink.mavlink_map.get(int.from_bytes(buffer[at + 7 : at + 10], "little"))
        if flags & ~1 or kind is None or buffer[at + 1] > kind.unpacker.size:
            return 0
        tail = _CRC_BYTES + (_SIGNATURE_BYTES if flags & 1 else 0)
        return _HEADER_BYTES + int(buffer[at + 1]) + tail

    def _decode(self, frame: bytearray) -> Message | None:
        try:
            return self._mav.decode(frame)
        except Exception:  # whatever damaged bytes provoke in generated code is a bad frame
            self.bad_frames += 1
            return None


class Link:
    """One board behind one transport.

    Every wait keeps the board's heartbeat rule satisfied, whatever is being waited for. ``rate`` is
    how many seconds pass on the board per second of the transport's clock; BoardClock keeps it.
    """

    def __init__(
        self, transport: Transport, system: int = HOST_SYSTEM, component: int = HOST_COMPONENT
    ) -> None:
        self.transport = transport
        self.rate = 1.0
        self.last_heard_s = transport.now_s()
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.framer = Framer(self.mav)
        self._inbox: deque[Message] = deque(maxlen=_INBOX_MAX)
        self._callbacks: list[Callable[[Message], None]] = []
        self._last_heartbeat_s = -math.inf

    def close(self) -> None:
        """Ends the conversation."""
        self.transport.close()

    def reopen(self) -> None:
        """Connects anew after a loss; half-read bytes and old messages go. Raises ConnectError."""
        self.transport.reopen()
        self.framer = Framer(self.mav)
        self._inbox.clear()
        self._last_heartbeat_s = -math.inf

    def subscribe(self, callback: Callable[[Message], None]) -> Callable[[], None]:
        """Calls back for every message from the board; call the result to stop that."""
        self._callbacks.append(callback)

        def unsubscribe() -> None:
            with contextlib.suppress(ValueError):
                self._callbacks.remove(callback)

        return unsubscribe

    def send(self, message: Message) -> None:
        """Packs and sends one message."""
        mav = self.mav
        self.transport.write(message.pack(mav))
        mav.seq = (mav.seq + 1) & 0xFF

    def pump(self) -> None:
        """Takes in what has arrived and sends the heartbeat if it is due. Never blocks."""
        now = self.transport.now_s()
        if now >= self._heartbeat_due_s():
            self._send_heartbeat(now)
        data = self.transport.read()
        if data:
            self._dispatch(self.framer.push(data), now)

    def idle(self, timeout_s: float) -> None:
        """Waits once, at most ``timeout_s`` and less when bytes or a heartbeat are due; pumps."""
        now = self.transport.now_s()
        self.transport.wait(max(0.0, min(timeout_s, self._heartbeat_due_s() - now)))
        self.pump()

    def run(self, duration_s: float) -> None:
        """Keeps the conversation going for ``duration_s``."""
        deadline = self.transport.now_s() + duration_s
        while (left := deadline - self.transport.now_s()) > 0:
            self.idle(left)
        self.flush()

    def flush(self) -> None:
        """Forgets messages that have arrived and were not asked for."""
        self.pump()
        self._inbox.clear()

    def patient(self, timeout_s: float) -> float:
        """``timeout_s``, stretched for a board that runs slower than the clock."""
        return timeout_s / min(1.0, max(self.rate, 1e-3))

    def recv(
        self, kinds: str | Iterable[str], timeout_s: float, where: Where | None = None
    ) -> Message | None:
        """The next message of one of ``kinds`` for which ``where`` holds; None after the timeout.

        Messages before it are dropped (subscribers have seen them), those behind it stay.
        """
        wanted = {kinds} if isinstance(kinds, str) else set(kinds)
        deadline = self.transport.now_s() + timeout_s
        self.pump()
        while True:
            while self._inbox:
                message = self._inbox.popleft()
                if message.get_type() in wanted and (where is None or where(message)):
                    return message
            left = deadline - self.transport.now_s()
            if left <= 0:
                return None
            self.idle(left)

    def attempts(self, tries: int = TRIES, timeout_s: float = REPLY_TIMEOUT_S) -> Iterator[float]:
        """Timeouts of successive tries; raises LinkLostError when they are used up."""
        begin = self.transport.now_s()
        for _ in range(tries):
            yield self.patient(timeout_s)
            timeout_s = min(timeout_s * _BACKOFF, max(timeout_s, _TIMEOUT_MAX_S))
        raise self.lost(tries, self.transport.now_s() - begin)

    def lost(self, tries: int, waited_s: float) -> LinkLostError:
        """The error for a board that does not answer."""
        return LinkLostError(
            f"the board does not answer on {self.transport.name}"
            f" (asked {tries} times in {waited_s:.1f} s)",
            "Check power, cable and radio (the antenna must be out of the water); connect again.",
        )

    def command(
        self, command: int, *params: float, tries: int = TRIES, timeout_s: float = REPLY_TIMEOUT_S
    ) -> Message:
        """COMMAND_LONG with the same content until acknowledged. Raises Refused."""
        values = list(params) + [0.0] * (7 - len(params))
        self.flush()
        for attempt, patience_s in enumerate(self.attempts(tries, timeout_s)):
            self.send(self._command_long(command, values, attempt))
            if (ack := self._acknowledged(command, patience_s)) is not None:
                return ack
        raise AssertionError("attempts always raises at its end")

    def command_int(self, command: int, param1: float, x: int, y: int) -> Message:
        """COMMAND_INT until acknowledged; ``x`` and ``y`` are int32. Raises Refused."""
        message = mavlink.MAVLink_command_int_message(
            BOARD_SYSTEM, BOARD_COMPONENT, 0, command, 0, 0, param1, 0.0, 0.0, 0.0, x, y, 0.0
        )
        self.flush()
        for patience_s in self.attempts():
            self.send(message)
            if (ack := self._acknowledged(command, patience_s)) is not None:
                return ack
        raise AssertionError("attempts always raises at its end")

    def request(self, kind: str, *params: float, where: Where | None = None) -> Message:
        """Asks for a message by name and returns it; ``params`` from param2 on. Raises Refused."""
        number = _message_id(kind)
        command = mavlink.MAV_CMD_REQUEST_MESSAGE
        values = [float(v) for v in (number, *params)] + [0.0] * (6 - len(params))

        def fits(message: Message) -> bool:
            if message.get_type() == kind:
                return where is None or where(message)
            return message.command == command and _denied(message)

        self.flush()
        for attempt, patience_s in enumerate(self.attempts()):
            self.send(self._command_long(command, values, attempt))
            message = self.recv((kind, "COMMAND_ACK"), patience_s, fits)
            if message is None:
                continue
            if message.get_type() == "COMMAND_ACK":
                raise _refused(message)
            return message
        raise AssertionError("attempts always raises at its end")

    @staticmethod
    def _command_long(command: int, values: list[float], attempt: int) -> Message:
        return mavlink.MAVLink_command_long_message(
            BOARD_SYSTEM, BOARD_COMPONENT, command, min(attempt, 255), *values
        )

    def _acknowledged(self, command: int, patience_s: float) -> Message | None:
        def fits(message: Message) -> bool:
            return bool(message.command == command)

        ack = self.recv("COMMAND_ACK", patience_s, fits)
        for _ in range(_PROGRESS_MAX):
            if ack is None or ack.result != mavlink.MAV_RESULT_IN_PROGRESS:
                break
            ack = self.recv("COMMAND_ACK", patience_s, fits)
        else:
            return None
        if ack is not None and _denied(ack):
            raise _refused(ack)
        return ack

    def _heartbeat_due_s(self) -> float:
        return self._last_heartbeat_s + HEARTBEAT_PERIOD_S / max(self.rate, 1e-3)

    def _send_heartbeat(self, now: float) -> None:
        self._last_heartbeat_s = now
        self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_GCS,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        )

    def _dispatch(self, messages: list[Message], now: float) -> None:
        for message in messages:
            header = message.get_header()
            if header.srcSystem != BOARD_SYSTEM or header.srcComponent != BOARD_COMPONENT:
                continue
            self.last_heard_s = now
            self._inbox.append(message)
            for callback in tuple(self._callbacks):
                callback(message)


def text_of(field: bytes | str) -> str:
    """A char[] field as text: up to the first zero, damaged bytes replaced."""
    if isinstance(field, bytes):
        field = field.decode("utf-8", "replace")
    return field.split("\0", 1)[0]


def _message_id(kind: str) -> int:
    for number, message in mavlink.mavlink_map.items():
        if message.msgname == kind:
            return int(number)
    raise TailbeatError(f"there is no message {kind}", "Tool and dialect differ in version.")


def _denied(ack: Message) -> bool:
    return ack.result not in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


def _refused(ack: Message) -> Refused:
    if ack.result_param2 > 0:
        return refusal(ack.result_param2)
    unsupported = ack.result == mavlink.MAV_RESULT_UNSUPPORTED
    return refusal(UNKNOWN_COMMAND if unsupported else WRONG_STATE)
