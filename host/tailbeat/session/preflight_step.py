"""The progress of one preflight check, the limits of the checks, their errors, and the
countdown."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, LinkLostError, Refused, TailbeatError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import BoardStatus
from tailbeat.session.events import Countdown, Notice, Operator, StepProgress


class NotReady(TailbeatError):
    """A trial may not begin; nothing on the board has changed."""


class BatteryLow(NotReady):
    """Before anything has swum; the board would not arm."""


class GivenUp(NotReady):
    """The operator did not want to wait any longer."""


@dataclass(frozen=True)
class PreflightLimits:
    """What is asked for. Times in s of board time. ``rest_s`` since the last trial's end.
    ``drift_max_m_s`` over ``still_s``; 0 s = not looked at. ``countdown_s``: 0 to 60.
    ``patience_s``: how long a step may take after the rest. ``start_yaw_deg``: of the IMU at an
    earlier start of the same series; None = not compared."""

    rest_s: float = 30.0
    still_s: float = 10.0
    drift_max_m_s: float = 0.002
    heading_max_rad: float = math.radians(10.0)
    aside_max_m: float = 0.10
    countdown_s: float = 5.0
    patience_s: float = 120.0
    start_yaw_deg: float | None = None


_LOOK_S = 0.1  # of board time; so often the operator is asked
_TELL_S = 0.5  # words that change all the time are told so often
_SILENT_S = 5.0  # of board time without a word from the board, after which it is asked


class PreflightStep:
    """``name`` as in operator.Event; times in s of board time, from when it was made."""

    def __init__(
        self,
        fish: Fish,
        operator: Operator,
        name: str,
        patience_s: float = math.inf,
        remedy: str = "",
    ) -> None:
        self.fish, self._remedy = fish, remedy
        self._operator, self._name, self._patience_s = operator, name, patience_s
        self._begin_s = fish.transport.now_s()
        self._reported: tuple[str, bool | None, int | None] | None = None
        self._reported_at_s = -math.inf

    @property
    def elapsed_s(self) -> float:
        """How long it has taken."""
        return (self.fish.transport.now_s() - self._begin_s) * self.fish.clock.rate

    @property
    def is_late(self) -> bool:
        """Whether the patience is used up."""
        return self.elapsed_s > self._patience_s

    def tell(self, text: str, ok: bool | None = None, left_s: float | None = None) -> None:
        """How it stands, unless that has just been said."""
        whole_s = None if left_s is None else math.ceil(max(left_s, 0.0))
        now = (text, ok, whole_s)
        same_second = self._reported is not None and now[1:] == self._reported[1:]
        if now == self._reported or (
            same_second and self.elapsed_s - self._reported_at_s < _TELL_S
        ):
            return
        self._reported, self._reported_at_s = now, self.elapsed_s
        self._operator.tell(StepProgress(self._name, text, ok, whole_s))

    def notice(self, text: str) -> None:
        """Something to know that stops nothing."""
        self._operator.tell(Notice(text))

    def refuse(self, what: str, remedy: str = "", error: type[NotReady] = NotReady) -> NotReady:
        """Reports that the check has failed; the error to raise. ``remedy`` empty: the check's."""
        self._reported = None
        self.tell(what, ok=False)
        return error(what, remedy or self._remedy)

    def wait(self) -> None:
        """A moment. Raises GivenUp when the operator gives up, LinkLostError when the board has
        gone."""
        fish = self.fish
        if self._operator.wants_abort():
            self.tell("given up", ok=False)
            raise GivenUp(
                f"given up at the step '{self._name}'",
                "No trial was started. Begin again when ready.",
            )
        fish.link.run(_LOOK_S / max(fish.clock.rate, 1.0))
        fish.clock.keep()
        silent_s = (fish.transport.now_s() - fish.link.last_heard_s) * fish.clock.rate
        if silent_s > _SILENT_S:
            fish.status()


COUNTDOWN_MAX_S = 60.0  # the LED blinks no longer

_HEARTBEAT_S = 0.3  # of board time; many of them may be lost before the board disarms
_DISARM_TRIES, _DISARM_S = 6, 0.3  # it cannot wait for long: somebody has pressed Ctrl-C


def countdown(fish: Fish, limits: PreflightLimits, operator: Operator) -> None:
    """Arms, lets the fish's LED blink and counts down; hands must be out at 0. Disarms and raises
    GivenUp when the operator wants it, or whatever else ends it. Returns ARMED."""
    if not 0 <= limits.countdown_s <= COUNTDOWN_MAX_S:
        raise InputError(
            f"a countdown of {limits.countdown_s:g} s is none",
            f"Give 0 to {COUNTDOWN_MAX_S:.0f} s.",
        )
    heard: list[BoardStatus] = []

    def hear(message: Message) -> None:
        heard.append(BoardStatus.of(message))

    stop_listening = fish.link.subscribe(hear, ["TAILBEAT_STATUS"])
    heartbeat_period_s = fish.link.heartbeat_period_s
    fish.link.heartbeat_period_s = _HEARTBEAT_S
    try:
        fish.arm(blink_s=limits.countdown_s)
        heard.clear()
        _count(fish, limits.countdown_s, operator, heard)
    except Refused:
        raise  # it is not armed; whoever else swims with it goes on
    except BaseException as error:
        stop_listening()
        _disarm(fish, operator, error)
        raise
    finally:
        stop_listening()
        fish.link.heartbeat_period_s = heartbeat_period_s


def _count(fish: Fish, countdown_s: float, operator: Operator, heard: list[BoardStatus]) -> None:
    begin_s = fish.transport.now_s()
    reported = -1
    while True:
        left_s = countdown_s - (fish.transport.now_s() - begin_s) * fish.clock.rate
        whole_s = max(0, math.ceil(left_s - 1e-6))
        if operator.wants_abort():
            raise GivenUp(
                "given up in the countdown", "No trial was started. Begin again when ready."
            )
        if whole_s == 0:
            _require_armed(fish.status())
        if whole_s != reported:
            reported = whole_s
            operator.tell(Countdown(whole_s))
        if whole_s == 0:
            return
        step_s = min(_LOOK_S, left_s) / max(fish.clock.rate, 1e-3)
        fish.link.run(min(step_s, _LOOK_S))
        for status in heard:
            _require_armed(status)
        heard.clear()


def _require_armed(status: BoardStatus) -> None:
    if status.state == "ARMED":
        return
    fault = status.fault
    if fault.number:
        raise NotReady(f"stopped in the countdown ({fault.name}): {fault.meaning}", fault.remedy)
    raise NotReady(
        f"the board is not armed any more ({status.state})",
        "Another host or a restart has disarmed it. Look with 'tailbeat info', and begin again.",
    )


def _disarm(fish: Fish, operator: Operator, error: BaseException) -> None:
    """Whatever comes meanwhile, what ended the countdown is what is raised."""
    tries = 1 if isinstance(error, LinkLostError) else _DISARM_TRIES
    try:
        fish.link.command(
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, tries=tries, timeout_s=_DISARM_S
        )
    except (TailbeatError, KeyboardInterrupt):
        text = (
            "the board may still be armed and does not answer: the LED shows it. It disarms by"
            " itself after LINK_TIMEOUT_S; if that is 0, switch it off"
        )
        with contextlib.suppress(Exception):
            operator.tell(Notice(text))
