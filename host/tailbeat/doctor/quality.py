"""How good the link is, and how the two clocks run: a few seconds of questions and answers."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

from tailbeat import _dialect as mavlink
from tailbeat.boardclock import ClockSample
from tailbeat.link import BOARD_COMPONENT, BOARD_SYSTEM, Link, Message

_PINGS_PER_S = 10
_LATE_S = 2.5  # an HC-05 holds an answer for 0.4 s at most, a buffer in between for longer
_SILENCE_S = 0.5  # after which a list has ended
_SPAN_MIN_S = 0.02  # what comes quicker has no speed to speak of


@dataclass(frozen=True)
class ClockReading:
    """The board's clock by ours: ``board_s`` at ``host_s``, give or take ``sigma_s``; it runs
    ``rate`` times as fast, give or take ``rate_error``."""

    host_s: float
    board_s: float
    sigma_s: float
    rate: float
    rate_error: float


@dataclass(frozen=True)
class Pings:
    """``samples``: those answered, in the order sent."""

    asked: int
    samples: list[ClockSample]

    @property
    def lost(self) -> int:
        """Unanswered."""
        return self.asked - len(self.samples)

    @property
    def median_s(self) -> float:
        """Round trip."""
        return statistics.median(s.round_trip_s for s in self.samples)

    @property
    def max_s(self) -> float:
        """Longest round trip."""
        return max(s.round_trip_s for s in self.samples)

    def clock(self) -> ClockReading | None:
        """By the quickest answers of the beginning and of the end."""
        third = len(self.samples) // 3
        if third == 0:
            return None
        quickest = [
            min(part, key=lambda s: s.round_trip_s)
            for part in (self.samples[:third], self.samples[-third:])
        ]
        first, last = quickest
        span_s = last.host_s - first.host_s
        if span_s <= 0:
            return None
        error = (first.round_trip_s + last.round_trip_s) / 2 / span_s
        rate = (last.board_s - first.board_s) / span_s
        return ClockReading(last.host_s, last.board_s, last.round_trip_s / 2, rate, error)


@dataclass(frozen=True)
class Burst:
    """A list that the board sends as fast as the line takes it. ``bytes_per_s``: None when it was
    too quick to tell."""

    frames: int
    missing: int
    bytes_per_s: float | None


def ping(link: Link, duration_s: float) -> Pings:
    """TIMESYNC at an even pace for ``duration_s`` of the transport's clock."""
    transport = link.transport
    sent: dict[int, float] = {}
    samples: list[ClockSample] = []

    def hear(message: Message) -> None:
        if message.get_type() == "TIMESYNC" and message.tc1 and message.ts1 in sent:
            sent_s, now_s = sent.pop(message.ts1), transport.now_s()
            samples.append(ClockSample((sent_s + now_s) / 2, message.tc1 * 1e-9, now_s - sent_s))

    count = max(3, round(duration_s * _PINGS_PER_S))
    stop = link.subscribe(hear)
    try:
        begin_s = transport.now_s()
        for number in range(1, count + 1):
            sent[number] = transport.now_s()
            link.send(mavlink.MAVLink_timesync_message(0, number))
            link.run(max(0.0, begin_s + number / _PINGS_PER_S - transport.now_s()))
        deadline = transport.now_s() + link.patient(_LATE_S)
        while sent and (left := deadline - transport.now_s()) > 0:
            link.idle(left)
    finally:
        stop()
    return Pings(count, samples)


def burst(link: Link) -> tuple[Burst, dict[str, float]]:
    """The parameters in one go: how fast, how many got lost, and what came."""
    values: dict[str, float] = {}
    arrived: list[tuple[float, int]] = []
    count = 0
    link.flush()
    link.send(mavlink.MAVLink_param_request_list_message(BOARD_SYSTEM, BOARD_COMPONENT))
    silence_s = link.patient(_SILENCE_S)
    while count == 0 or len(values) < count:
        message = link.recv("PARAM_VALUE", silence_s)
        if message is None:
            break
        count = message.param_count
        values[message.param_id] = message.param_value
        arrived.append((link.transport.now_s(), len(message.get_msgbuf())))
    return Burst(len(values), count - len(values), _bytes_per_s(arrived)), values


def _bytes_per_s(arrived: list[tuple[float, int]]) -> float | None:
    """Of all but the first that came: that one's time on the line is not known."""
    if not arrived:
        return None
    begin_s, end_s = arrived[0][0], arrived[-1][0]
    later = sum(size for time_s, size in arrived if time_s > begin_s)
    return later / (end_s - begin_s) if end_s - begin_s >= _SPAN_MIN_S else None
