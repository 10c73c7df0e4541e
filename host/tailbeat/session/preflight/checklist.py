"""What must be so before a swim: rest, room, start pose, still water and a still fish; then the
countdown.

Each step is told as it goes (operator.Event ``step``); one that cannot be made raises NotReady with
what to do. One that is not there (no camera, no IMU) is told as a notice and left out, never taken
for passed.
"""

from __future__ import annotations

from weakref import WeakSet

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.faults import BATTERY_SENSE, TRIAL_PENDING, fault_info
from tailbeat.core.frames import Camera
from tailbeat.experiment.library import library_of
from tailbeat.link.messages import BoardStatus
from tailbeat.session.operator import Operator
from tailbeat.session.outcome import Drift, Pose, Ready, Travel
from tailbeat.session.preflight.pose import Feel, Sight, pose_now, wait_for_pose, what_to_do
from tailbeat.session.preflight.step import (
    BatteryLow,
    GivenUp,
    NotReady,
    PreflightLimits,
    PreflightStep,
    countdown,
)
from tailbeat.session.preflight.stillness import rested_s, wait_for_rest, wait_until_still, watch
from tailbeat.session.travel import travel_next

__all__ = [
    "BatteryLow",
    "Drift",
    "GivenUp",
    "NotReady",
    "Pose",
    "PreflightLimits",
    "Ready",
    "countdown",
    "prepare",
]

_ROUNDS = 3  # a fish that turns while the water calms down is put right again
_RISE_V = 0.2  # once it was too low, by the board's rule (supervisor/battery.h)

_found_low: WeakSet[Fish] = WeakSet()


def prepare(
    fish: Fish, wanted: PreflightLimits, camera: Camera | None, operator: Operator
) -> Ready:
    """Goes through all of it up to the countdown, the board IDLE and unarmed all the time. Raises
    NotReady, GivenUp (operator.wants_abort), CameraGone, InputError (no room), Refused.

    What needs no waiting comes first: nobody rests for half a minute to hear of an empty battery. A
    board that is armed is disarmed."""
    watch(fish)
    status = _look_at_board(fish, operator)
    travel = _look_at_room(fish, operator)
    sight = Sight(fish, camera, wanted.still_s) if camera is not None else None
    step = PreflightStep(fish, operator, "rest")
    wait_for_rest(step, wanted.rest_s, fish.status(), sight)
    feel = Feel.of(fish, PreflightStep(fish, operator, "pose"))
    try:
        pose, drift = _lie_still(fish, wanted, operator, sight, feel)
    finally:
        if feel is not None:
            feel.close()
    last = _look_at_board(fish, operator)
    if last.time_s < status.time_s:
        raise NotReady("the board has restarted meanwhile", "Look at the battery; begin again.")
    return Ready(travel, rested_s(fish, last), pose, drift, last.battery_v)


def _lie_still(
    fish: Fish, wanted: PreflightLimits, operator: Operator, sight: Sight | None, feel: Feel | None
) -> tuple[Pose | None, Drift | None]:
    """Until it lies right and still at the same time."""
    for _ in range(_ROUNDS):
        step = PreflightStep(fish, operator, "pose", wanted.patience_s)
        pose = wait_for_pose(step, wanted, sight, feel)
        still = PreflightStep(fish, operator, "still", wanted.patience_s)
        drift = wait_until_still(still, wanted, sight, feel)
        now = pose_now(sight, feel)
        if now is None and sight is None:
            now = pose
        wrong = "it turns" if now is None and pose is not None else None
        if now is not None:
            wrong = what_to_do(now, wanted)
        if wrong is None:
            return now, drift
        step.notice(f"it does not lie right any more: {wrong}")
    raise step.refuse(
        f"the fish does not stay as it was put: {wrong}",
        "Look for a current that turns it, or trim its ballast; then begin again.",
    )


def _look_at_board(fish: Fish, operator: Operator) -> BoardStatus:
    """IDLE, with nothing pending and enough battery."""
    step = PreflightStep(fish, operator, "board")
    status = fish.status()
    if status.state == "ARMED":
        fish.disarm()
        step.notice("the board was armed; it is disarmed until the countdown")
        status = fish.status()
    if status.state in ("ABORTED", "FAULT"):
        fault = status.fault
        raise step.refuse(
            f"the board is stopped ({fault.name}): {fault.meaning}",
            f"{fault.remedy} To clear it: tailbeat board clear",
        )
    if status.state != "IDLE":
        raise step.refuse(
            f"the board is busy ({status.state})", "Wait until it is idle: tailbeat info"
        )
    if status.pending_trial is not None:
        pending = fault_info(TRIAL_PENDING)
        raise step.refuse(f"{pending.meaning} (trial {status.pending_trial})", pending.remedy)
    _look_at_battery(fish, step, status)
    step.tell(f"idle, battery {status.battery_v:.2f} V", ok=True)
    return status


def _look_at_battery(fish: Fish, step: PreflightStep, status: BoardStatus) -> None:
    """By the rule by which the board refuses to arm. What it remembers of an earlier connection it
    does not tell, hence the notice."""
    low_v = fish.params.get("BATT_LOW_V").value
    least_v = low_v + _RISE_V if fish in _found_low else low_v
    if low_v <= 0:
        return
    if status.battery_at_limit:
        sense = fault_info(BATTERY_SENSE)
        raise step.refuse(sense.meaning, sense.remedy)
    if round(status.battery_v * 1e3) < round(least_v * 1e3):
        _found_low.add(fish)
        refused = step.refuse(
            f"the battery has {status.battery_v:.2f} V, a swim needs {least_v:.2f} V to begin with",
            "Swap the battery, then begin again.",
        )
        raise BatteryLow(refused.message, refused.remedy)
    _found_low.discard(fish)
    if status.battery_v < low_v + _RISE_V:
        step.notice(f"the battery is nearly empty: {status.battery_v:.2f} V; have a full one ready")


def _look_at_room(fish: Fish, operator: Operator) -> Travel:
    step = PreflightStep(fish, operator, "room")
    travel = travel_next(fish, library_of(fish))
    try:
        travel.require_room()
    except InputError as error:
        step.tell(error.message, ok=False)
        raise
    if travel.worst_m > travel.room_m:
        step.notice(
            f"there is room for {travel.room_m:.2f} m and it comes about {travel.expected_m:.2f} m,"
            f" but at worst {travel.worst_m:.2f}: be ready to catch it"
        )
    step.tell(travel.text(), ok=True)
    return travel
