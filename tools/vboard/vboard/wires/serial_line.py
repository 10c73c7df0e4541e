"""A serial wire between a port of the chip and whatever a test puts at its other end.

Nothing happens per byte. Bytes for the chip wait in runs whose arrival times follow from the baud
rate; the port fetches those that have arrived whenever something looks at it. Bytes from the chip
come as chunks with the time of the last bit of each. All times are ticks of the board's clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Protocol

from vboard.core.clock import TICKS_PER_S, Clock

BITS_PER_BYTE = 10  # 8N1
BAUD_TOLERANCE = 0.03
LOOK_AHEAD_RUNS = 8  # that an event is planned from; with more to come it is planned anew
GARBLED = 0xA5  # XORed onto what is sampled at the wrong rate: wrong, and the same in each run


class ChipEnd(Protocol):
    """The port of the chip, as the wire needs it."""

    def sync(self) -> None:
        """Brings both directions up to the present."""

    def replan(self) -> None:
        """What is under way on the wire changed; the port's next event may be another."""

    def next_sent(self) -> int | None:
        """When the last bit of the byte now being sent leaves; None when idle."""

    def all_sent(self) -> int | None:
        """When the last bit of all the port knows it has to send leaves; None when idle."""


@dataclass(frozen=True)
class Chunk:
    """Bytes without a gap; ``first`` is when the last bit of the first one arrived."""

    first: int
    char_ticks: int
    data: bytes

    @property
    def last(self) -> int:
        """When the last bit of the last byte arrived."""
        return self.first + (len(self.data) - 1) * self.char_ticks

    def times(self) -> list[int]:
        """Arrival of each byte."""
        return [self.first + i * self.char_ticks for i in range(len(self.data))]


@dataclass(frozen=True)
class Piece:
    """Bytes that reached the chip, all good or a single one with a bad stop bit."""

    data: bytes
    first: int
    last: int
    baud: int
    framing: bool


@dataclass
class Run:
    """Bytes under way to the chip.

    ``start``: when the first bit of the first one left; ``taken``: how many have arrived and were
    fetched; ``framing``: those with a bad stop bit.
    """

    start: int
    baud: int
    data: bytes
    framing: frozenset[int] = frozenset()
    taken: int = 0

    def arrival(self, index: int) -> int:
        """When the last bit of a byte arrives."""
        bits = (index + 1) * BITS_PER_BYTE * TICKS_PER_S
        return self.start - (-bits // self.baud)

    def arrived(self, now: int) -> int:
        """How many of its bytes are there."""
        count = (now - self.start) * self.baud // (BITS_PER_BYTE * TICKS_PER_S)
        return min(max(count, 0), len(self.data))


@dataclass
class Losses:
    """Bytes that did not make it, by reason."""

    cut_to_chip: int = 0
    cut_from_chip: int = 0
    receiver_off: int = 0
    overrun: int = 0
    garbled_to_chip: int = 0
    garbled_from_chip: int = 0
    in_flight_at_reset: int = 0


@dataclass
class _Damage:
    drop: set[int] = field(default_factory=set)
    framing: set[int] = field(default_factory=set)
    flip: dict[int, int] = field(default_factory=dict)


class SerialLine:
    """One wire, both directions, 8N1 at ``baud``; of the kind that goes with the clock."""

    def __new__(cls, clock: Clock, baud: int, name: str = "line") -> SerialLine:
        return super().__new__(clock.line_type or cls)

    def __init__(self, clock: Clock, baud: int, name: str = "line") -> None:
        self.clock, self.baud, self.name = clock, baud, name
        self._lost = Losses()
        self.sent_bytes = 0
        self.received_bytes = 0
        self._port: ChipEnd | None = None
        self._runs: deque[Run] = deque()
        self._chunks: deque[Chunk] = deque()
        self._plugged = True
        self._damage = _Damage()
        self._damage_back: dict[int, int | None] = {}

    @property
    def lost(self) -> Losses:
        """Bytes that did not make it, by reason."""
        return self._lost

    # The host's side.

    def send(self, data: bytes, at: int | None = None) -> int:
        """Sends towards the chip from ``at`` (default now), after what is already queued. Returns
        when the last bit arrives."""
        start = max(self.clock.now if at is None else at, self.clock.now)
        start = max(start, self._end() or 0)
        if not data:
            return start
        end = start
        for piece, framing, offset in self._damaged(data):
            late = Run(start, self.baud, b"").arrival(offset - 1)
            run = Run(late, self.baud, piece, framing)
            end = run.arrival(len(piece) - 1)
            self._push(run)
        self.sent_bytes += len(data)
        if self._port is not None:
            self._port.replan()
        return end

    def queued(self) -> int:
        """Bytes on their way to the chip."""
        self._sync()
        return sum(len(run.data) - run.taken for run in self._runs)

    def queue_end(self) -> int:
        """When the last bit of what is queued for the chip arrives; now when nothing is."""
        self._sync()
        end = self._end()
        return self.clock.now if end is None else end

    def take_timed(self) -> list[Chunk]:
        """What arrived from the chip since the last take, with times."""
        self._sync()
        chunks = list(self._chunks)
        self._chunks.clear()
        return chunks

    def take(self) -> bytes:
        """What arrived from the chip since the last take."""
        return b"".join(chunk.data for chunk in self.take_timed())

    def byte_due(self) -> int | None:
        """When the byte that the chip is sending now will have arrived; None when it sends none."""
        return self._port.next_sent() if self._port is not None else None

    def message_due(self) -> int | None:
        """When all that the chip has handed to its port will have arrived; None when idle."""
        return self._port.all_sent() if self._port is not None else None

    def set_baud(self, baud: int) -> None:
        """Rate of the host's end from the next byte on, both directions."""
        self._sync()
        self.baud = baud

    def cut(self) -> None:
        """Pulls the plug: bytes that end while it is out are lost, both ways."""
        self._sync()
        self._plugged = False

    def plug(self) -> None:
        """Puts the plug back."""
        self._sync()
        self._plugged = True
        if self._port is not None:
            self._port.replan()

    @property
    def connected(self) -> bool:
        """Whether the plug is in."""
        return self._plugged

    def drop(self, ahead: int = 0) -> None:
        """Loses the byte ``ahead`` bytes after the next one to be sent to the chip."""
        self._damage.drop.add(self.sent_bytes + ahead)

    def flip(self, mask: int, ahead: int = 0) -> None:
        """Inverts bits of the byte ``ahead`` bytes after the next one to be sent to the chip."""
        self._damage.flip[self.sent_bytes + ahead] = mask

    def break_stop_bit(self, ahead: int = 0) -> None:
        """Framing error on the byte ``ahead`` bytes after the next one to be sent to the chip."""
        self._damage.framing.add(self.sent_bytes + ahead)

    def damage_received(self, ahead: int = 0, mask: int | None = None) -> None:
        """Inverts bits of a byte from the chip, ``ahead`` bytes from now; mask None loses it."""
        self._sync()
        self._damage_back[self.received_bytes + ahead] = mask

    # The chip's side.

    def connect(self, port: ChipEnd) -> None:
        """Soldered to a port; to the new one after each power-on."""
        self._port = port

    def fetch(self, until: int) -> Iterator[Piece]:
        """Takes the bytes whose last bit arrived by ``until``, in order."""
        while self._runs:
            run = self._runs[0]
            count = run.arrived(until)
            yield from self._pieces(run, count)
            if run.taken < len(run.data):
                return
            self._runs.popleft()

    def arrival(self, number: int) -> int | None:
        """When the ``number``-th (from 0) byte not yet fetched arrives."""
        if not self._plugged:
            return None
        for run in self._runs:
            left = len(run.data) - run.taken
            if number < left:
                return run.arrival(run.taken + number)
            number -= left
        return None

    def bad_arrival(self, baud: float) -> int | None:
        """When the next byte arrives that a receiver at ``baud`` takes with a framing error. May be
        too early: time to ask again."""
        if not self._plugged:
            return None
        for run in islice(self._runs, LOOK_AHEAD_RUNS):
            if not _matches(run.baud, baud):
                return run.arrival(run.taken)
            bad = [index for index in run.framing if index >= run.taken]
            if bad:
                return run.arrival(min(bad))
        if len(self._runs) > LOOK_AHEAD_RUNS:
            return self._runs[LOOK_AHEAD_RUNS].arrival(0)
        return None

    def silence(self, since: int | None, ticks: int) -> int | None:
        """End of the first ``ticks`` without a byte: after ``since``, or after the next byte when
        it is None. None when there is no byte to count from. May be too early: time to ask
        again."""
        if self._plugged:
            for run in islice(self._runs, LOOK_AHEAD_RUNS):
                first = run.arrival(run.taken)
                if since is not None and first > since + ticks:
                    break
                since = run.arrival(len(run.data) - 1)
        return None if since is None else since + ticks

    def deliver(self, first: int, char_ticks: int, data: bytes) -> None:
        """Bytes from the chip; ``first``: the last bit of the first one."""
        baud = BITS_PER_BYTE * TICKS_PER_S / char_ticks
        if not self._plugged:
            self._lost.cut_from_chip += len(data)
        elif not _matches(self.baud, baud):
            self._lost.garbled_from_chip += len(data)
            self._chunks.append(Chunk(first, char_ticks, bytes(b ^ GARBLED for b in data)))
        else:
            self._chunks.extend(self._received(first, char_ticks, data))
        self.received_bytes += len(data)

    def _push(self, run: Run) -> None:
        self._runs.append(run)

    def _end(self) -> int | None:
        """When the last byte under way to the chip arrives."""
        if not self._runs:
            return None
        return self._runs[-1].arrival(len(self._runs[-1].data) - 1)

    def _received(self, first: int, char_ticks: int, data: bytes) -> Iterator[Chunk]:
        span = range(self.received_bytes, self.received_bytes + len(data))
        hit = [number for number in self._damage_back if number in span]
        start = 0
        changed = bytearray(data)
        for number in sorted(hit):
            index, mask = number - self.received_bytes, self._damage_back.pop(number)
            if mask is not None:
                changed[index] ^= mask
                continue
            if index > start:
                yield Chunk(first + start * char_ticks, char_ticks, bytes(changed[start:index]))
            start = index + 1
        if start < len(data):
            yield Chunk(first + start * char_ticks, char_ticks, bytes(changed[start:]))

    def _damaged(self, data: bytes) -> Iterator[tuple[bytes, frozenset[int], int]]:
        """Parts of ``data`` between dropped bytes: bytes, bad stop bits, place in ``data``."""
        base, harm = self.sent_bytes, self._damage
        if not (harm.drop or harm.framing or harm.flip):
            yield data, frozenset(), 0
            return
        changed = bytearray(data)
        for index in range(len(data)):
            changed[index] ^= harm.flip.pop(base + index, 0)
        start = 0
        for end in [*(i for i in range(len(data)) if base + i in harm.drop), len(data)]:
            harm.drop.discard(base + end)
            bad = frozenset(i - start for i in range(start, end) if base + i in harm.framing)
            if end > start:
                yield bytes(changed[start:end]), bad, start
            start = end + 1
        harm.framing -= set(range(base, base + len(data)))

    def _pieces(self, run: Run, until: int) -> Iterator[Piece]:
        while run.taken < until:
            first = run.taken
            bad = first in run.framing
            cuts = [index for index in run.framing if index > first] if run.framing else []
            last = first + 1 if bad else min([until, *cuts])
            run.taken = last
            if not self._plugged:
                self._lost.cut_to_chip += last - first
                continue
            yield Piece(
                run.data[first:last], run.arrival(first), run.arrival(last - 1), run.baud, bad
            )

    def _sync(self) -> None:
        if self._port is not None:
            self._port.sync()


def _matches(one: float, other: float) -> bool:
    return abs(other / one - 1) <= BAUD_TOLERANCE
