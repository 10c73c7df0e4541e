"""The board's clock as seen from the host, by TIMESYNC."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Link, Message

_SAMPLES = 8  # of one synchronisation, and of the window the best one is picked from
_SPACING_S = 0.02
_RESYNC_S = 2.0
_RATE_BASELINE_S = 0.1
# Crystals agree within 100 ppm: what is closer to 1 than this is a real-time board, and the rest is
# jitter of the radio.
_REAL_TIME_BAND = 0.02
_REANCHOR_S = 30.0
# How far the offset may run away per second: crystals, and boards paced by a busy machine.
_DRIFT_REAL, _DRIFT_VIRTUAL = 1e-4, 0.05


@dataclass(frozen=True)
class ClockSample:
    """One exchange: at ``host_s`` (its middle) the board's clock showed ``board_s``."""

    host_s: float
    board_s: float
    round_trip_s: float


class BoardClock:
    """Maps the transport's clock to seconds since the board booted.

    The offset comes from the exchange of the last few that is worth most: short round trip, not
    old. The rate comes from two that lie apart: a board in
    virtual time may run faster or slower than the wall clock.
    """

    def __init__(self, link: Link) -> None:
        self.rate = 1.0
        self._link = link
        self._recent: deque[ClockSample] = deque(maxlen=_SAMPLES)
        self._best: ClockSample | None = None
        self._anchor: ClockSample | None = None
        self._rate_error = float("inf")
        self._asked_s: dict[int, float] = {}
        self.next_s = 0.0  # of the transport's clock: when keep() asks again
        link.subscribe(self._hear, ["TIMESYNC"])

    @property
    def round_trip_s(self) -> float:
        """Round trip of the exchange in use; infinite before the first."""
        return self._best.round_trip_s if self._best else float("inf")

    def sync(self) -> None:
        """A fresh series of exchanges. Raises LinkLostError when the board does not answer."""
        self._recent.clear()
        self._best = self._anchor = None
        self._rate_error = float("inf")
        for patience_s in self._link.attempts():
            self._ask()
            if self._link.recv("TIMESYNC", patience_s, lambda _: bool(self._recent)):
                break
        for _ in range(_SAMPLES - 1):
            self._link.run(_SPACING_S)
            self._ask()
            self._link.recv("TIMESYNC", self._link.patient(0.2))
        self.next_s = self._link.transport.now_s() + _RESYNC_S

    def keep(self) -> None:
        """Asks again now and then; call it in long waits. Does not wait for the answer."""
        now = self._link.transport.now_s()
        if now >= self.next_s:
            self.next_s = now + _RESYNC_S / max(self.rate, 1.0)
            self._ask()

    @property
    def reading(self) -> ClockSample:
        """The exchange in use; the first one is made now."""
        if self._best is None:
            self.sync()
        assert self._best is not None
        return self._best

    def board_s(self, host_s: float) -> float:
        """Board time at ``host_s`` of the transport's clock."""
        best = self._best or self.reading
        return best.board_s + (host_s - best.host_s) * self.rate

    def now_s(self) -> float:
        """Board time now."""
        return self.board_s(self._link.transport.now_s())

    def add(self, sample: ClockSample) -> None:
        """Takes one exchange into account."""
        if self._recent and sample.board_s < self._recent[-1].board_s:
            self._recent.clear()  # the board has restarted
            self._anchor = None
        self._recent.append(sample)
        if self._anchor is None:
            self._anchor = sample
        self._update_rate(sample)
        drift = _DRIFT_REAL if self.rate == 1.0 else _DRIFT_VIRTUAL
        self._best = min(
            self._recent,
            key=lambda s: s.round_trip_s / 2 + (sample.host_s - s.host_s) * drift,
        )

    def _update_rate(self, sample: ClockSample) -> None:
        assert self._anchor is not None
        span_s = sample.host_s - self._anchor.host_s
        if span_s < _RATE_BASELINE_S:
            return
        error = (sample.round_trip_s + self._anchor.round_trip_s) / 2 / span_s
        if error > self._rate_error:
            return
        rate = (sample.board_s - self._anchor.board_s) / span_s
        real_time = abs(rate - 1.0) < _REAL_TIME_BAND + error
        self.rate = 1.0 if real_time else max(rate, 1e-3)
        self._link.rate = self.rate
        self._rate_error = error
        if span_s > _REANCHOR_S:  # a rate may change, so the baseline does not grow for ever
            self._anchor = sample
            self._rate_error = float("inf")

    def _ask(self) -> None:
        sent_s = self._link.transport.now_s()
        stamp = max(1, int(sent_s * 1e9))
        self._asked_s[stamp] = sent_s
        while len(self._asked_s) > 4 * _SAMPLES:
            del self._asked_s[next(iter(self._asked_s))]
        self._link.send(mavlink.MAVLink_timesync_message(0, stamp))

    def _hear(self, message: Message) -> None:
        if message.tc1 == 0:
            return
        sent_s = self._asked_s.pop(message.ts1, None)
        if sent_s is None:
            return
        now_s = self._link.transport.now_s()
        self._link.round_trip.heard(now_s - sent_s)
        self.add(ClockSample((sent_s + now_s) / 2, message.tc1 * 1e-9, now_s - sent_s))
