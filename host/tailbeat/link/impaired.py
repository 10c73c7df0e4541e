"""A bad line in front of any transport: faults, one behind the other, from one seed."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from random import Random
from typing import Protocol

from tailbeat.core.errors import ConnectError, InputError, LinkLostError
from tailbeat.link.frames import Framer
from tailbeat.link.transport import InFront, Transport

_MARKER = 0xFD
_HEADER_BYTES = 10
_ORDER_GAP_S = 1e-6  # between pieces that arrive together and must not change places


@dataclass(frozen=True)
class Piece:
    """A whole MAVLink frame, or the bytes between two, and when it arrives (transport's clock)."""

    due_s: float
    data: bytes


class Fault(Protocol):
    """One thing that a line does to what passes. It may remember what passed before."""

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """What becomes of ``piece``: nothing, itself changed or later, or several."""


@dataclass
class Drop:
    """Loses this fraction of the frames; with ``where`` only of those it holds for."""

    fraction: float
    where: Callable[[bytes], bool] | None = None

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """Nothing, or the piece."""
        meant = self.where is None or self.where(piece.data)
        return () if meant and dice.random() < self.fraction else (piece,)


@dataclass
class Corrupt:
    """Changes each byte with this probability."""

    per_byte: float
    _left: int = -1

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece, with some bytes that are not what they were."""
        if self.per_byte <= 0:
            return (piece,)
        data = bytearray(piece.data)
        at = self._gap(dice) if self._left < 0 else self._left
        while at < len(data):
            data[at] ^= dice.randrange(1, 256)
            at += 1 + self._gap(dice)
        self._left = at - len(data)
        return (replace(piece, data=bytes(data)),)

    def _gap(self, dice: Random) -> int:
        """Good bytes before the next bad one: a geometric draw."""
        return int(math.log(1.0 - dice.random()) / math.log1p(-min(self.per_byte, 0.999999)))


@dataclass
class Duplicate:
    """Brings this fraction of the frames twice."""

    fraction: float

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece once or twice."""
        return (piece, piece) if dice.random() < self.fraction else (piece,)


@dataclass
class Truncate:
    """Cuts this fraction of the frames short, anywhere."""

    fraction: float

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece or its beginning."""
        if dice.random() >= self.fraction or not piece.data:
            return (piece,)
        return (replace(piece, data=piece.data[: dice.randrange(len(piece.data))]),)


@dataclass
class Delay:
    """``low_s`` to ``high_s``, and now and then, with probability ``tail``, up to ``tail_s``. The
    order stays."""

    low_s: float
    high_s: float
    tail: float = 0.0
    tail_s: tuple[float, float] = (0.0, 0.0)
    _last_s: float = -math.inf

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece, later."""
        low_s, high_s = self.tail_s if dice.random() < self.tail else (self.low_s, self.high_s)
        self._last_s = max(piece.due_s + dice.uniform(low_s, high_s), self._last_s + _ORDER_GAP_S)
        return (replace(piece, due_s=self._last_s),)


def hc05() -> Delay:
    """The delay of a Bluetooth serial module, one way: 20 to 50 ms, one frame in a hundred 100 to
    400 ms, and all behind it wait too. Half the echo times measured with an HC-05, with their
    spread."""
    return Delay(0.02, 0.05, tail=0.01, tail_s=(0.1, 0.4))


@dataclass
class Standstill:
    """Holds everything for the last ``length_s`` of every ``every_s``; then it comes all at once,
    with ``shuffle`` in any order."""

    every_s: float
    length_s: float
    shuffle: bool = False

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece, at the end of the stall it fell into."""
        end_s = (piece.due_s // self.every_s + 1.0) * self.every_s
        if piece.due_s < end_s - self.length_s:
            return (piece,)
        spread_s = dice.uniform(0.0, _ORDER_GAP_S) if self.shuffle else 0.0
        return (replace(piece, due_s=end_s + spread_s),)


@dataclass
class HalfOpen:
    """This direction is dead from ``begin_s`` to ``end_s``."""

    begin_s: float
    end_s: float = math.inf

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """Nothing while it is dead."""
        return () if self.begin_s <= piece.due_s < self.end_s else (piece,)


class _Broken(Exception):
    """The line is gone; ``until_s`` is when it can be opened again."""

    def __init__(self, until_s: float) -> None:
        super().__init__(until_s)
        self.until_s = until_s


@dataclass
class Cut:
    """Breaks the connection, both ways, once: with the first piece behind ``at_s`` or behind
    ``at_bytes`` that passed here. It can be opened again ``closed_s`` later."""

    at_s: float = math.inf
    at_bytes: float = math.inf
    closed_s: float = 0.0
    _passed: int = 0
    _done: bool = False

    def take(self, piece: Piece, dice: Random) -> Iterable[Piece]:
        """The piece, until the cut."""
        self._passed += len(piece.data)
        if not self._done and (piece.due_s >= self.at_s or self._passed > self.at_bytes):
            self._done = True
            raise _Broken(piece.due_s + self.closed_s)
        return (piece,)


@dataclass
class _Way:
    """One direction: bytes in, pieces out when they are due."""

    faults: Sequence[Fault]
    dice: Random
    _buffer: bytearray = field(default_factory=bytearray)
    _queue: list[tuple[float, int, bytes]] = field(default_factory=list)
    _count: itertools.count[int] = field(default_factory=itertools.count)

    def put(self, data: bytes, now_s: float) -> None:
        self._buffer += data
        for piece in self._split():
            pieces: list[Piece] = [Piece(now_s, piece)]
            for fault in self.faults:
                pieces = [out for p in pieces for out in fault.take(p, self.dice)]
            for out in pieces:
                heapq.heappush(self._queue, (out.due_s, next(self._count), out.data))

    def _split(self) -> Iterable[bytes]:
        """Whole frames, and what lies between them; a frame that is still coming stays."""
        buffer = self._buffer
        while buffer:
            length = buffer.find(_MARKER) if buffer[0] != _MARKER else self._frame_length()
            if length < 0:
                length = len(buffer)
            if length == 0 or length > len(buffer):
                return
            yield bytes(buffer[:length])
            del buffer[:length]

    def _frame_length(self) -> int:
        """0: not known yet. A marker that begins no frame passes alone."""
        if len(self._buffer) < _HEADER_BYTES:
            return 0
        return Framer.frame_length(self._buffer, 0) or 1

    def next_s(self) -> float:
        return self._queue[0][0] if self._queue else math.inf

    def due(self, now_s: float) -> bytes:
        taken = []
        while self._queue and self._queue[0][0] <= now_s:
            taken.append(heapq.heappop(self._queue)[2])
        return b"".join(taken)

    def clear(self) -> None:
        self._buffer.clear()
        self._queue.clear()


class ImpairedLine(InFront):
    """``inner`` with faults: ``up`` to the board, ``down`` from it, each in the order given.

    Same seed and same calls, same faults. A frame passes when it is whole. Over a transport in
    virtual time a piece arrives exactly when it is due, over others when somebody waits or reads.
    """

    def __init__(
        self, inner: Transport, up: Sequence[Fault] = (), down: Sequence[Fault] = (), seed: int = 1
    ) -> None:
        self.inner = inner
        self.name = inner.name
        self._up = _Way(up, Random(2 * seed))
        self._down = _Way(down, Random(2 * seed + 1))
        self._broken: _Broken | None = None

    def read(self) -> bytes:
        """What has come through."""
        self._move()
        return self._down.due(self.now_s())

    def write(self, data: bytes) -> None:
        """Bytes into the line."""
        self._check()
        with self._breaking():
            self._up.put(data, self.now_s())
        self._move()

    def wait(self, timeout_s: float) -> None:
        """Until something has come through or the time is over. Time passes over a cut line too."""
        end_s = self.now_s() + timeout_s
        while self._broken is not None and self.now_s() < end_s:
            self.inner.read()  # into the void
            self.inner.wait(end_s - self.now_s())
        if self._broken is not None:
            return
        self._move()
        while (begin_s := self.now_s()) < min(end_s, self._down.next_s()):
            until_s = min(end_s, self._up.next_s(), self._down.next_s())
            self.inner.wait(until_s - begin_s)
            self._move()
            if self.now_s() < until_s:  # bytes, or whatever else the one inside wakes for
                return

    def now_s(self) -> float:
        """The clock of the one inside."""
        return self.inner.now_s()

    def reopen(self) -> None:
        """Opens anew after a cut; what was on the way is lost."""
        if self._broken is not None and self.now_s() < self._broken.until_s:
            raise ConnectError(f"{self.name} is gone", "Wait; it comes back.")
        self.inner.reopen()
        self._broken = None
        self._up.clear()
        self._down.clear()
        self.inner.read()

    def close(self) -> None:
        """Closes the one inside."""
        self.inner.close()

    def _move(self) -> None:
        """From the board into the line, and to the board what is due there."""
        self._check()
        data = self.inner.read()
        with self._breaking():
            self._down.put(data, self.now_s())
        if data := self._up.due(self.now_s()):
            self.inner.write(data)

    @contextlib.contextmanager
    def _breaking(self) -> Iterator[None]:
        try:
            yield
        except _Broken as broken:
            self._broken = broken
            self._check()

    def _check(self) -> None:
        if self._broken is not None:
            raise LinkLostError(f"the connection to {self.name} broke", "Connect again.")


def faults_of(text: str) -> tuple[list[Fault], list[Fault]]:
    """Faults (up, down), each way its own, from words like ``drop=0.2,errors=1e-3,delay=hc05``."""
    words = [word for word in text.split(",") if word]
    return [_fault(word) for word in words], [_fault(word) for word in words]


def _fault(word: str) -> Fault:
    name, _, value = word.partition("=")
    try:
        if value == "hc05" and name == "delay":
            return hc05()
        if name == "delay":
            low_s, high_s = _numbers(value, 2)
            if low_s <= high_s:
                return Delay(low_s, high_s)
        elif name == "stall":
            every_s, length_s = _numbers(value, 2)
            if length_s < every_s:
                return Standstill(every_s, length_s)
        elif 0 <= (fraction := _numbers(value, 1)[0]) <= 1:
            return _FRACTIONS[name](fraction)
    except (KeyError, ValueError):
        pass
    raise InputError(
        f"a line cannot have '{word}'",
        "It has drop=, errors= (of the bytes), twice= and short= with a fraction. It also has"
        " delay=hc05, delay=LOW:HIGH and stall=EVERY:LENGTH in s. Put commas between them.",
    )


def _numbers(text: str, count: int) -> list[float]:
    values = [float(part) for part in text.split(":")]
    if len(values) != count or not all(0 <= value < math.inf for value in values):
        raise ValueError(text)
    return values


_FRACTIONS: dict[str, Callable[[float], Fault]] = {
    "drop": Drop,
    "errors": Corrupt,
    "twice": Duplicate,
    "short": Truncate,
}
