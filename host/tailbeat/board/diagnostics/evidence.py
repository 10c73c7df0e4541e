"""What one check found.

How good the link is, and how the two clocks run: a few seconds of questions and answers.

The way to the board: the port, and whether a board is heard there.

All that the checks look at, asked from the board once. What it does not say is None.
"""

from __future__ import annotations

import contextlib
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

from tailbeat.board.connect import LISTEN_S, find_board, hear_board, open_transport
from tailbeat.board.fish import Fish
from tailbeat.board.memory import CrashReport
from tailbeat.board.provision import MISSING, KeyStatus, key_status, trust_of
from tailbeat.core.errors import ConnectError, LinkLostError, Refused, TailbeatError
from tailbeat.core.faults import NOT_SIGNED
from tailbeat.link import _dialect as mavlink
from tailbeat.link import messages as results
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Link, Message
from tailbeat.link.messages import BoardStatus, ImuInfo
from tailbeat.link.serial import CLOSE_IT, SerialTransport, holders, is_radio
from tailbeat.link.timesync import ClockSample
from tailbeat.link.transport import Hearing, Transport
from tailbeat.sim.board import in_process

OK, WARNING, PROBLEM = "ok", "warning", "problem"

Figure = float | int | str | bool | None
Figures = dict[str, Figure]


@dataclass(frozen=True)
class Finding:
    """One check's result.

    Attributes
    ----------
    name : str
        Of the check.
    status : str
        ``OK``, ``WARNING`` or ``PROBLEM``.
    text : str
        What was found, in words.
    remedy : str
        What to do about it; empty when there is nothing to do.
    measured : mapping
        The figures behind it, by name; units in the names.
    """

    name: str
    status: str
    text: str
    remedy: str = ""
    measured: Mapping[str, Figure] = field(default_factory=dict)

    @property
    def line(self) -> str:
        """What it says and what to do, in one line."""
        return f"{self.text}. {self.remedy}" if self.remedy else self.text


def worst(findings: list[Finding]) -> str:
    """Find the worst status among findings.

    Parameters
    ----------
    findings : list of Finding
        Any number of them.

    Returns
    -------
    str
        ``PROBLEM``, ``WARNING`` or ``OK``.
    """
    found = {finding.status for finding in findings}
    return next((status for status in (PROBLEM, WARNING) if status in found), OK)


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


def reach(url: str | None) -> tuple[list[Finding], Transport | None]:
    """Opens and listens; no transport when that fails."""
    try:
        transport = find_board() if url is None else open_transport(url)
    except ConnectError as error:
        return [Finding("port", PROBLEM, error.message, error.remedy)], None
    port = _port(transport)
    board = Finding("board", OK, "a tailbeat board is heard")
    if url is not None:
        board = _listen(transport)
    if board.status == OK:
        return [port, board], transport
    transport.close()
    return [port, board], None


def by_radio(transport: Transport) -> bool:
    """Whether the way to the board is known to be its radio."""
    return isinstance(transport, SerialTransport) and is_radio(transport.name)


def _port(transport: Transport) -> Finding:
    users = holders(transport.name) if isinstance(transport, SerialTransport) else []
    if users:
        text = f"{transport.name} opens, but it is in use by {', '.join(users)}, too"
        return Finding("port", PROBLEM, text, CLOSE_IT)
    return Finding("port", OK, _what(transport))


def _what(transport: Transport) -> str:
    if in_process(transport) is not None:
        return f"{transport.name}, a board in this process"
    if isinstance(transport, SerialTransport):
        kind = "the radio" if by_radio(transport) else "a serial port"
        return f"{transport.name} opens, {kind}"
    return f"{transport.name} opens"


def _listen(transport: Transport) -> Finding:
    hearing = Hearing(transport.name)
    begin_s = transport.now_s()
    try:
        heard = hear_board(transport, LISTEN_S, hearing) is not None
    except TailbeatError as error:
        return Finding("board", PROBLEM, error.message, error.remedy)
    measured: Figures = {
        "bytes": hearing.count,
        "heard": "board" if heard else hearing.kind,
        "after_s": round(transport.now_s() - begin_s, 3),
    }
    if heard:
        return Finding("board", OK, "a tailbeat board is heard", "", measured)
    return Finding("board", PROBLEM, *hearing.words(), measured)


# The version last: a line of text with the build follows it.
ASKED = ("TAILBEAT_STATUS", "TAILBEAT_HEALTH", "TAILBEAT_IMU_INFO", "AUTOPILOT_VERSION")
PARAMETERS = ("BATT_LOW_V", "BATT_CRIT_V", "SPD_SOURCE", "IMU_TIMEOUT_S")
_TRIES, _TRIES_LOSSY = 4, 12
_REPLY_S = 0.7
_BUSY = ("RUNNING", "SETTLING", "LEARNING")

Health = dict[str, int | str]


@dataclass
class BoardEvidence:
    """``unanswered``: messages the board did not give though it answered others. ``untold``: those
    it refused us, because it has a key and we have not."""

    by_radio: bool
    in_process: bool
    pings: Pings
    burst: Burst | None = None
    damaged_here: int = 0
    damaged_there: int = 0
    version: Message | None = None
    build_id: str | None = None
    status: BoardStatus | None = None
    health: Health | None = None
    imu: ImuInfo | None = None
    crash: CrashReport | None = None
    key: KeyStatus | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    unanswered: list[str] = field(default_factory=list)
    untold: list[str] = field(default_factory=list)

    @property
    def busy(self) -> bool:
        """A trial is under way: the link is not to be loaded."""
        return self.status is not None and self.status.state in _BUSY

    @property
    def kind(self) -> str:
        """Fish, simulated, emulated, or unknown."""
        number = None if self.version is None else self.version.board_version
        return results.BOARD_KINDS.get(number or 0, "unknown")


def gather(transport: Transport, measure_s: float) -> BoardEvidence:
    """Asks for everything. Raises LinkLostError when the board answers nothing at all."""
    fish = Fish(transport)
    fish.clock.sync()
    link = fish.link
    # An unauthenticated host would have to wait for it twice.
    damaged = link.framer.bad_frames
    board = BoardEvidence(by_radio(transport), in_process(transport) is not None, Pings(0, []))
    before = None if link.signing.locked else _ask(board, link, "TAILBEAT_HEALTH", _TRIES)
    board.unanswered.clear()
    board.pings = ping(link, measure_s)
    _read(board, link)
    if not board.busy:
        board.burst, board.parameters = burst(link)
    board.damaged_here = link.framer.bad_frames - damaged
    if before is not None and board.health is not None:
        there = int(board.health["link_bad_frames"]) - before.link_bad_frames
        board.damaged_there = max(0, there)
    _look_further(board, fish)
    return board


def of_connected(fish: Fish, measure_s: float) -> BoardEvidence:
    """What matters before a trial, of a fish that is connected: link, battery, IMU."""
    link = fish.link
    board = BoardEvidence(
        by_radio(fish.transport), in_process(fish.transport) is not None, ping(link, measure_s)
    )
    board.status = fish.status()
    board.health = fish.health()
    board.imu = fish.imu_verdict()
    board.parameters = fish.params.values(*PARAMETERS)
    return board


def _read(board: BoardEvidence, link: Link) -> None:
    tries = _TRIES_LOSSY if board.pings.lost else _TRIES
    answers = {kind: _ask(board, link, kind, tries) for kind in ASKED}
    if len(board.unanswered) == len(ASKED):
        raise link.lost(tries, tries * _REPLY_S)
    status, health, imu, version = (answers[kind] for kind in ASKED)
    if version is not None:
        board.version = version
        with contextlib.suppress(TailbeatError):
            board.build_id = results.build_id_of(link, version, _TRIES)
    board.status = None if status is None else BoardStatus.of(status)
    board.health = None if health is None else results.health_dict(health)
    board.imu = None if imu is None else ImuInfo.of(imu)


def _ask(board: BoardEvidence, link: Link, kind: str, tries: int) -> Message | None:
    """A message, or why there is none: it may be one that never comes."""
    try:
        return link.request(kind, tries=tries)
    except LinkLostError:
        board.unanswered.append(kind)
    except Refused as refused:
        untold = refused.number == NOT_SIGNED
        (board.untold if untold else board.unanswered).append(kind)
    return None


def _look_further(board: BoardEvidence, fish: Fish) -> None:
    for name in PARAMETERS:
        if name not in board.parameters:
            with contextlib.suppress(TailbeatError):
                board.parameters[name] = fish.params.get(name).value
    if board.imu is not None:
        board.imu = fish.imu_verdict()
    if not board.busy:
        with contextlib.suppress(TailbeatError):
            board.crash = fish.crash_report()
    told = board.version is not None and board.health is not None
    if told or trust_of(fish) == MISSING:
        board.key = key_status(fish, board.health or {})
