"""The countdown: armed, the LED blinks, hands out of the water."""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from tailbeat.core.errors import InputError, LinkLostError, Refused, TailbeatError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import BoardStatus
from tailbeat.session.events import Countdown, Notice
from tailbeat.session.preflight.step import GivenUp, NotReady, Wanted

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish
    from tailbeat.link.mavlink import Message
    from tailbeat.session.operator import Person

COUNTDOWN_MAX_S = 60.0  # the LED blinks no longer
_LOOK_S = 0.1
_HEARTBEAT_S = 0.3  # of board time; many of them may be lost before the board disarms
_DISARM_TRIES, _DISARM_S = 6, 0.3  # it cannot wait for long: somebody has pressed Ctrl-C


def countdown(fish: Fish, wanted: Wanted, person: Person) -> None:
    """Arms, lets the fish's LED blink and counts down; hands must be out at 0. Disarms and raises
    GivenUp when the person wants it, or whatever else ends it. Returns ARMED."""
    if not 0 <= wanted.countdown_s <= COUNTDOWN_MAX_S:
        raise InputError(
            f"a countdown of {wanted.countdown_s:g} s is none",
            f"Give 0 to {COUNTDOWN_MAX_S:.0f} s.",
        )
    heard: list[BoardStatus] = []

    def hear(message: Message) -> None:
        if message.get_type() == "TAILBEAT_STATUS":
            heard.append(BoardStatus.of(message))

    stop_listening = fish.link.subscribe(hear)
    heartbeat_period_s = fish.link.heartbeat_period_s
    fish.link.heartbeat_period_s = _HEARTBEAT_S
    try:
        fish.arm(blink_s=wanted.countdown_s)
        heard.clear()
        _count(fish, wanted.countdown_s, person, heard)
    except Refused:
        raise  # it is not armed; whoever else swims with it goes on
    except BaseException as error:
        stop_listening()
        _disarm(fish, person, error)
        raise
    finally:
        stop_listening()
        fish.link.heartbeat_period_s = heartbeat_period_s


def _count(fish: Fish, countdown_s: float, person: Person, heard: list[BoardStatus]) -> None:
    begin_s = fish.transport.now_s()
    told = -1
    while True:
        left_s = countdown_s - (fish.transport.now_s() - begin_s) * fish.clock.rate
        whole_s = max(0, math.ceil(left_s - 1e-6))
        if person.wants_abort():
            raise GivenUp("given up in the countdown", "Nothing has swum. Begin again when ready.")
        if whole_s == 0:
            _require_armed(fish.status())
        if whole_s != told:
            told = whole_s
            person.tell(Countdown(whole_s))
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


def _disarm(fish: Fish, person: Person, error: BaseException) -> None:
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
            person.tell(Notice(text))
