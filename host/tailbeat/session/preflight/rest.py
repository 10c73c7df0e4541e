"""How long ago the fish swam last, by the board's own clock: nobody has to remember."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from tailbeat.core.errors import InputError
from tailbeat.core.trial_file import parse_trial
from tailbeat.link.ftp.wire import FtpError
from tailbeat.link.messages import BoardStatus

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish
    from tailbeat.link.mavlink import Message
    from tailbeat.session.preflight.pose import Sight
    from tailbeat.session.preflight.step import Step

_HEAD_BYTES = 1024  # of a trial's file, with when it began and how long its beats are


class _Watch:
    """Sees swims end while this process is connected, so that no log is read for them."""

    def __init__(self) -> None:
        self.trial: int | None = None
        self.ended_s: float | None = None  # None: it swims, as far as was heard
        self._time_s = -math.inf

    def hear(self, message: Message) -> None:
        """Any message of the board's."""
        if message.get_type() != "TAILBEAT_STATUS":
            return
        status = BoardStatus.of(message)
        if status.time_s < self._time_s:
            self.trial = None  # it has restarted
        self._time_s = status.time_s
        if status.state == "RUNNING":
            self.trial, self.ended_s = status.trial, None
        elif self.trial == status.trial and self.ended_s is None:
            self.ended_s = status.time_s


_watches: WeakKeyDictionary[Fish, _Watch] = WeakKeyDictionary()


def watch(fish: Fish) -> None:
    """From now on this process sees swims end by itself."""
    if fish not in _watches:
        _watches[fish] = seen = _Watch()
        fish.link.subscribe(seen.hear)


def rested_s(fish: Fish, status: BoardStatus) -> float | None:
    """How long it has rested at ``status``, at least; None = it has never swum. Of a board that has
    restarted since only how long it is up is known, of one whose log is gone nothing: 0."""
    if status.trial is None:
        return None
    seen = _watches.get(fish)
    if seen is not None and seen.trial == status.trial and seen.ended_s is not None:
        return max(0.0, status.time_s - seen.ended_s)
    return _by_log(fish, status, status.trial)


def _by_log(fish: Fish, status: BoardStatus, trial: int) -> float:
    """The beats it swam are in the status: the log's end need not be read."""
    try:
        head = fish.ftp.head(f"/trials/{trial:04d}.ulg", _HEAD_BYTES)
        log = parse_trial(head)
    except (FtpError, InputError):
        return 0.0
    beats = status.beat + (1 if status.beat < status.beats else 0)  # one may have been cut
    rested = status.time_s - (log.start_us * 1e-6 + beats * log.beat_s)
    return rested if rested >= 0 else status.time_s  # a time to come is one of an earlier boot


def wait_for_rest(step: Step, rest_s: float, status: BoardStatus, sight: Sight | None) -> None:
    """Waits until ``rest_s`` after the last swim's end. ``status``: of now."""
    if rest_s <= 0:
        return
    step.tell("asks the board when it swam last")
    asked_s = step.elapsed_s
    rested = rested_s(step.fish, status)
    if rested is None:
        step.tell("it has not swum yet", ok=True)
        return
    while (left_s := rest_s - rested - (step.elapsed_s - asked_s)) > 0:
        step.tell("the water rests", left_s=left_s)
        step.wait()
        if sight is not None:
            sight.look(step)
    step.tell("rested", ok=True, left_s=0.0)
