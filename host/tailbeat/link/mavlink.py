"""The MAVLink conversation with one board: framing, heartbeats, requests with retries."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from tailbeat.core.errors import LinkLostError, Refused, TailbeatError
from tailbeat.core.faults import NOT_FRESH, NOT_SIGNED, UNKNOWN_COMMAND, WRONG_STATE, refusal
from tailbeat.core.printable import printable
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.signing import Signing
from tailbeat.link.transport import RoundTrip, Transport

Message = Any  # pymavlink's message classes carry their fields dynamically
Where = Callable[[Message], bool]

HOST_SYSTEM = 255
HOST_COMPONENT = 190
BOARD_SYSTEM = 1
BOARD_COMPONENT = 1

HEARTBEAT_PERIOD_S = 1.0  # of board time
REPLY_TIMEOUT_S = 0.5
TRIES = 16  # one try in three fails where a fifth of the frames is lost each way
_TRIES_MIN = 6
_DEAD_S = 6.0  # a board that says nothing at all for so long is not asked so often
_HEARD_S = 3.0
_BACKOFF = 1.3
_TIMEOUT_MAX_S = 2.0
_INBOX_MAX = 8192
_PROGRESS_MAX = 100  # of "in progress" before a command is said again
_THINK_S = 0.1
_SIGNED_TRIES = 3
_COMES_WITHIN_S = {"TAILBEAT_STATUS": 4.0, "TAILBEAT_HEALTH": 12.0}
_FTP_OPCODE = 3  # in the payload
_FTP_CHANGES = range(6, 14)  # create, write, remove, folders, open to write, truncate, rename


@dataclass(frozen=True, eq=False)
class _Listener:
    """Who gets the messages of ``kinds``; None = all."""

    callback: Callable[[Message], None]
    kinds: frozenset[str] | None


class Link:
    """One board behind one transport.

    Every wait keeps the board's heartbeat rule satisfied, whatever is being waited for. ``rate`` is
    how many seconds pass on the board per second of the transport's clock; BoardClock keeps it, and
    tells ``round_trip`` what it sees.
    With a board that has a key everything sent is signed, and what it has not signed is dropped.
    """

    def __init__(
        self,
        transport: Transport,
        system: int = HOST_SYSTEM,
        component: int = HOST_COMPONENT,
        signing: Signing | None = None,
    ) -> None:
        self.transport = transport
        self.signing = Signing() if signing is None else signing
        self.rate = 1.0
        self.round_trip = RoundTrip()
        self.heartbeat_period_s = HEARTBEAT_PERIOD_S
        self.said = 0  # how often the last command was
        self.last_heard_s = transport.now_s()
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.framer = Framer(mavlink.MAVLink(None))
        self._inbox: deque[Message] = deque(maxlen=_INBOX_MAX)
        self._listeners: list[_Listener] = []
        self.wanted: frozenset[str] | None = frozenset()  # kinds somebody listens to; None = all
        self.last_heartbeat_s = -math.inf
        self._distrusted: Refused | None = None
        self._more_tries = 0

    def close(self) -> None:
        """Ends the conversation."""
        self.signing.save()
        self.transport.close()

    def reopen(self) -> None:
        """Connects anew after a loss; half-read bytes and old messages go. Raises ConnectError."""
        self.transport.reopen()
        self.framer = Framer(mavlink.MAVLink(None))
        self._inbox.clear()
        self.last_heartbeat_s = -math.inf

    def subscribe(
        self, callback: Callable[[Message], None], kinds: Iterable[str] | None = None
    ) -> Callable[[], None]:
        """Calls back for every message from the board, or those of ``kinds`` (names); call the
        result to stop that."""
        listener = _Listener(callback, None if kinds is None else frozenset(kinds))
        self._listeners.append(listener)
        self._note_wanted()

        def unsubscribe() -> None:
            with contextlib.suppress(ValueError):
                self._listeners.remove(listener)
            self._note_wanted()

        return unsubscribe

    def _note_wanted(self) -> None:
        kinds = [listener.kinds for listener in self._listeners]
        named = frozenset[str]().union(*filter(None, kinds))
        self.wanted = None if None in kinds else named

    def send(self, message: Message) -> None:
        """Packs and sends one message, signed when the board wants that. Raises Refused when it
        would be of no use, and the board cannot say so in its answer."""
        mav = self.mav
        if self.signing.locked and _needs_trust(message):
            raise refusal(NOT_SIGNED)
        data = self.signing.pack(message, mav, self.transport.now_s(), self.rate)
        self.transport.write(data)
        mav.seq = (mav.seq + 1) & 0xFF

    def pump(self) -> None:
        """Takes in what has arrived and sends the heartbeat if it is due. Never blocks."""
        now = self.transport.now_s()
        if now >= self._heartbeat_due_s():
            self._send_heartbeat(now)
        data = self.transport.read()
        if data:
            self.take(data, now)

    def take(self, data: bytes, now_s: float) -> None:
        """Takes in what has arrived from the board by ``now_s``."""
        self._dispatch(self.framer.push(data), now_s)

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

    def forget(self) -> None:
        """As ``flush``, of what has been taken in."""
        self._inbox.clear()

    def begin(self) -> None:
        """Before a question: forgets what came before it."""
        self._distrusted = None
        self._more_tries = _SIGNED_TRIES
        self.flush()

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
        """Timeouts of successive tries; raises LinkLostError when they are used up, or Refused
        when the board answered but did not believe."""
        begin = self.transport.now_s()
        asked = 0
        while asked < tries:
            asked += 1
            yield self.patient(timeout_s)
            timeout_s = min(timeout_s * _BACKOFF, max(timeout_s, _TIMEOUT_MAX_S))
            silent_s = self.transport.now_s() - max(begin, self.last_heard_s)
            if asked >= _TRIES_MIN and silent_s > self.patient(_DEAD_S):
                break
        raise self._distrusted or self.lost(asked, self.transport.now_s() - begin)

    def lost(self, tries: int, waited_s: float) -> LinkLostError:
        """The error for a board that does not answer, or is not believed."""
        if why := self.signing.why_silent():
            return LinkLostError(
                f"the board on {self.transport.name} is rejected: {why}",
                "Look with 'tailbeat board key status' what is there; connect again.",
            )
        asked = f"(asked {tries} times in {waited_s:.1f} s)"
        silent_s = self.transport.now_s() - self.last_heard_s
        if silent_s < min(waited_s, self.patient(_HEARD_S)):
            return LinkLostError(
                f"the board on {self.transport.name} is heard but does not answer {asked}",
                "Messages do not reach it. Check the wire from the Bluetooth module's TX to the"
                " board, move closer to the fish, then connect again.",
            )
        return LinkLostError(
            f"the board does not answer on {self.transport.name} {asked}",
            "Check power, cable and Bluetooth (antenna out of the water); connect again.",
        )

    def command(
        self, command: int, *params: float, tries: int = TRIES, timeout_s: float = REPLY_TIMEOUT_S
    ) -> Message:
        """COMMAND_LONG with the same content until acknowledged. Raises Refused."""
        values = list(params) + [0.0] * (7 - len(params))
        self.begin()
        for attempt, patience_s in enumerate(self.attempts(tries, timeout_s)):
            self.send(self._command_long(command, values, attempt))
            self.said = attempt + 1
            if (ack := self._acknowledged(command, patience_s)) is not None:
                return ack
        raise AssertionError("attempts always raises at its end")

    def command_int(self, command: int, param1: float, x: int, y: int) -> Message:
        """COMMAND_INT until acknowledged; ``x`` and ``y`` are int32. Raises Refused."""
        message = mavlink.MAVLink_command_int_message(
            BOARD_SYSTEM, BOARD_COMPONENT, 0, command, 0, 0, param1, 0.0, 0.0, 0.0, x, y, 0.0
        )
        self.begin()
        for attempt, patience_s in enumerate(self.attempts()):
            self.send(message)
            self.said = attempt + 1
            if (ack := self._acknowledged(command, patience_s)) is not None:
                return ack
        raise AssertionError("attempts always raises at its end")

    def request(
        self, kind: str, *params: float, where: Where | None = None, tries: int = TRIES
    ) -> Message:
        """Asks for a message by name and returns it; ``params`` from param2 on. Raises Refused.

        From a board that does not obey us we take it when it comes by itself."""
        if self.signing.locked and kind in _COMES_WITHIN_S:
            message = self.recv(kind, self.patient(_COMES_WITHIN_S[kind]), where)
            if message is None:
                raise self.lost(1, _COMES_WITHIN_S[kind])
            return message
        number = message_id(kind)
        command = mavlink.MAV_CMD_REQUEST_MESSAGE
        values = [float(v) for v in (number, *params)] + [0.0] * (6 - len(params))

        def fits(message: Message) -> bool:
            if message.get_type() == kind:
                return where is None or where(message)
            return message.command == command and _denied(message)

        self.begin()
        for attempt, patience_s in enumerate(self.attempts(tries)):
            sent_s = self.transport.now_s()
            self.send(self._command_long(command, values, attempt))
            message = self.recv((kind, "COMMAND_ACK"), patience_s, fits)
            if message is None:
                continue
            self.round_trip.heard(self.transport.now_s() - sent_s, attempt + 1)
            if message.get_type() == "COMMAND_ACK":
                self._turned_down(message)
                continue
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
        if ack is not None and self.said > 1:
            self.pass_by()
        if ack is not None and _denied(ack):
            self._turned_down(ack)
            return None
        return ack

    def accepted(self, ack: Message) -> bool:
        """Whether a COMMAND_ACK is a yes; not when it is to be said again. Raises Refused."""
        if _denied(ack):
            self._turned_down(ack)
            return False
        return bool(ack.result == mavlink.MAV_RESULT_ACCEPTED)

    def pass_by(self) -> None:
        """Lets answers pass that may still come to what was said more than once. The line keeps the
        order: what is asked now is answered behind them."""
        for patience_s in self.attempts():
            stamp = int(self.transport.now_s() * 1e9) + 1
            self.send(mavlink.MAVLink_timesync_message(0, stamp))
            if self.recv("TIMESYNC", patience_s, _has_stamp(stamp)) is not None:
                return

    def _turned_down(self, ack: Message) -> None:
        """Raises Refused, unless it was only the signature and we can do better now: from the
        answer we know the board's time."""
        refused = _refused(ack)
        if refused.number not in (NOT_SIGNED, NOT_FRESH) or not self.once_more():
            raise refused
        self._distrusted = refused

    def once_more(self) -> bool:
        """Whether to ask again after a refusal that may have been of the signature: its time was
        old if the board has restarted, and is not any more now that it has answered."""
        self._more_tries -= 1
        if self.signing.key is None or self._more_tries < 0:
            return False
        self.run(_THINK_S)  # it may have to store how far time has come
        return True

    def _heartbeat_due_s(self) -> float:
        return self.last_heartbeat_s + self.heartbeat_period_s / max(self.rate, 1e-3)

    def _send_heartbeat(self, now: float) -> None:
        self.last_heartbeat_s = now
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
            if not self.signing.admit(message.get_msgbuf(), now):
                continue
            self.last_heard_s = now
            self._inbox.append(message)
            kind = message.get_type()
            for listener in tuple(self._listeners):
                if listener.kinds is None or kind in listener.kinds:
                    listener.callback(message)


def _has_stamp(stamp: int) -> Where:
    return lambda message: bool(message.ts1 == stamp)


def text_of(field: bytes | str) -> str:
    """A char[] field as text: up to the first zero, damaged bytes replaced, controls as escapes."""
    if isinstance(field, bytes):
        field = field.decode("utf-8", "replace")
    return printable(field.split("\0", 1)[0])


def message_id(kind: str) -> int:
    """The number of a message by its name. Raises TailbeatError for one the dialect has not."""
    for number, message in mavlink.mavlink_map.items():
        if message.msgname == kind:
            return int(number)
    raise TailbeatError(f"there is no message {kind}", "Tool and dialect differ in version.")


def _needs_trust(message: Message) -> bool:
    """Whether it changes something, and is answered by a number that is not a fault's."""
    kind = message.get_type()
    if kind == "FILE_TRANSFER_PROTOCOL":
        return message.payload[_FTP_OPCODE] in _FTP_CHANGES
    return bool(kind == "PARAM_SET")


def _denied(ack: Message) -> bool:
    return ack.result not in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


def _refused(ack: Message) -> Refused:
    if ack.result_param2 > 0:
        return refusal(ack.result_param2)
    unsupported = ack.result == mavlink.MAV_RESULT_UNSUPPORTED
    return refusal(UNKNOWN_COMMAND if unsupported else WRONG_STATE)
