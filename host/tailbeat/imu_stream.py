"""The board's raw IMU frames, as they come, while somebody wants them."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator

from tailbeat import _dialect as mavlink
from tailbeat.boardclock import BoardClock
from tailbeat.errors import TailbeatError
from tailbeat.link import Link, Message
from tailbeat.results import ImuFrame

_ALL_FRAMES = 0.0
_OFF = -1.0
_WAIT_S = 0.5
_ASK_AGAIN_S = 2.0  # the board ends the stream when it has heard no host for a while
_US_WRAP = 1 << 32
_AXES = 3


def imu_frames(link: Link, clock: BoardClock, duration_s: float) -> Generator[ImuFrame, None, None]:
    """Every frame the board gets for so long, of board time; gaps show in ``sequence``."""
    wait_s = link.patient(_WAIT_S)
    now_s = link.transport.now_s()
    end_s = now_s + duration_s / clock.rate
    ask_s = now_s
    try:
        while (now_s := link.transport.now_s()) < end_s:
            if now_s >= ask_s:
                _want(link, _ALL_FRAMES)
                ask_s = link.transport.now_s() + link.patient(_ASK_AGAIN_S)
            message = link.recv("TAILBEAT_IMU", min(wait_s, end_s - now_s))
            clock.keep()
            if message is not None:
                ask_s = link.transport.now_s() + link.patient(_ASK_AGAIN_S)
                yield from _frames(message, clock.now_s())
    finally:
        with contextlib.suppress(TailbeatError):
            _want(link, _OFF)


def _want(link: Link, interval_us: float) -> None:
    number = float(mavlink.MAVLINK_MSG_ID_TAILBEAT_IMU)
    link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us)


def _frames(m: Message, board_s: float) -> Iterator[ImuFrame]:
    for i in range(min(m.count, len(m.time_us))):
        axes = slice(_AXES * i, _AXES * (i + 1))
        yield ImuFrame(
            sequence=m.sequence + i,
            time_s=unwrapped_s(m.time_us[i], board_s),
            accel_m_s2=tuple(m.accel_m_s2[axes]),
            rate_rad_s=tuple(m.rate_rad_s[axes]),
            ypr_deg=tuple(m.ypr_deg[axes]),
        )


def unwrapped_s(low_us: int, board_s: float) -> float:
    """The board time nearest to ``board_s`` whose low 32 bits, in microseconds, are ``low_us``."""
    wraps = round((board_s * 1e6 - low_us) / _US_WRAP)
    return (low_us + max(wraps, 0) * _US_WRAP) * 1e-6
