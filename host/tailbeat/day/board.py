"""The board between swims: stopped, settling, made safe."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError
from tailbeat.faults import REBOOT, TILT
from tailbeat.results import SPEED_SOURCES

if TYPE_CHECKING:
    from tailbeat.faults import FaultInfo
    from tailbeat.fish import Fish
    from tailbeat.results import BoardStatus

STOPPED = ("ABORTED", "FAULT")
_BUSY = ("BOOT", "RUNNING", "SETTLING", "LEARNING")
_IMU_REST_S = 30.0  # of board time: so long it waits for the fish to rest after a swim
_MARGIN_S = 2.0
_LOOK_S = 0.25
_SAFE_TRIES = 3


def dangerous(fault: FaultInfo) -> bool:
    """Whether somebody has to look at the fish before it swims again: the board stopped by a rule
    of its own (battery, tilt, late tick, restart), not because the link or a person said so."""
    return fault.kind == "fault" or fault.number in (TILT, REBOOT)


def stop_words(status: BoardStatus) -> str:
    """Why the board is stopped, and what to do about it."""
    fault = status.fault
    return f"the board stopped ({fault.name}): {fault.meaning}. {fault.remedy}"


def make_safe(fish: Fish) -> None:
    """The tail still and nothing armed, as far as the board can be reached; another Ctrl-C does
    not hinder it."""
    for _ in range(_SAFE_TRIES):
        try:
            with contextlib.suppress(TailbeatError):
                _make_safe(fish)
            return
        except KeyboardInterrupt:
            continue


def _make_safe(fish: Fish) -> None:
    status = fish.status()
    if status.state == "RUNNING":
        fish.abort()
    elif status.state == "ARMED":
        fish.disarm()


def require_still(fish: Fish) -> None:
    """Raises TailbeatError when the tail beats: somebody else swims this fish."""
    if fish.status().state == "RUNNING":
        raise TailbeatError("the fish swims already", "Wait, or stop it: tailbeat trial abort")


def settled(fish: Fish, expected: int | None = None) -> BoardStatus:
    """The status once the last swim is over for the board, too. ``expected``: a trial that may yet
    become pending after it was cut."""
    rate = max(fish.clock.rate, 1.0)
    wait_s = fish.params.get("SETTLE_S").value + _MARGIN_S
    if SPEED_SOURCES[round(fish.params.get("SPD_SOURCE").value)] == "imu":
        wait_s += _IMU_REST_S
    end_s = fish.transport.now_s() + wait_s / rate
    while True:
        status = fish.status()
        waits = status.state in STOPPED and status.pending_trial is None
        waits = waits and expected is not None and status.trial == expected
        if (status.state not in _BUSY and not waits) or fish.transport.now_s() >= end_s:
            return status
        fish.link.run(_LOOK_S / rate)
