"""How long ago the fish swam last, by the board's own clock: nobody has to remember.

Whether water and fish are still: a fish that drifts at 2 mm/s brings 2 mm/s into every beat.

What must be so before a swim: rest, room, start pose, still water and a still fish; then the
countdown.

Each step is told as it goes (operator.Event ``step``); one that cannot be made raises NotReady with
what to do. One that is not there (no camera, no IMU) is told as a notice and left out, never taken
for passed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from weakref import WeakKeyDictionary, WeakSet

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.faults import BATTERY_SENSE, TRIAL_PENDING, fault_info
from tailbeat.core.frames import Camera, Frame
from tailbeat.core.trial_file import parse_trial
from tailbeat.experiment.library import logbook_of
from tailbeat.link.ftp.wire import FtpError
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import BoardStatus
from tailbeat.session.events import Operator
from tailbeat.session.outcome import Drift, Pose, Ready, Travel
from tailbeat.session.preflight_pose import (
    CameraPose,
    ImuPose,
    pose_correction,
    pose_now,
    wait_for_pose,
)
from tailbeat.session.preflight_step import (
    BatteryLow,
    NotReady,
    PreflightLimits,
    PreflightStep,
)
from tailbeat.session.travel import travel_next

_HEAD_BYTES = 1024  # of a trial's file, with when it began and how long its beats are


class _TrialEndListener:
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


_watches: WeakKeyDictionary[Fish, _TrialEndListener] = WeakKeyDictionary()


def watch(fish: Fish) -> None:
    """From now on this process sees swims end by itself."""
    if fish not in _watches:
        _watches[fish] = seen = _TrialEndListener()
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


def wait_for_rest(
    step: PreflightStep, rest_s: float, status: BoardStatus, sight: CameraPose | None
) -> None:
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


_TOLD_FROM_S = 2.0  # over less a camera's noise of 1 mm is more than what is looked for
_BLOCKS = 10
_FRAMES_MIN = 12
_FELT_LOOK_S = 0.5
_REMEDY = (
    "Switch off pumps, let the water calm down, let go of the fish only when it lies still;"
    " then begin again."
)


def wait_until_still(
    step: PreflightStep, wanted: PreflightLimits, sight: CameraPose | None, feel: ImuPose | None
) -> Drift | None:
    """Waits until it has been still for ``still_s``. None when nothing can tell, or nobody asked.
    Raises NotReady and what the step and the camera raise."""
    if wanted.still_s <= 0:
        return None
    if sight is not None:
        return _wait_by_camera(step, wanted, sight)
    if feel is not None:
        return _wait_by_imu(step, wanted, feel)
    step.notice("nobody knows whether water and fish are still: there is no camera and no IMU")
    return None


def _wait_by_camera(step: PreflightStep, wanted: PreflightLimits, sight: CameraPose) -> Drift:
    while True:
        sight.look(step)
        drift = drift_now(sight, wanted.still_s)
        covered_s = 0.0 if drift is None else drift.over_s
        whole = covered_s >= wanted.still_s
        if drift is not None and whole and _passes(drift, wanted):
            step.tell(_words(drift), ok=True)
            return drift
        words = _how_it_moves(sight, drift, wanted)
        if step.is_late:
            if not sight.frames:
                raise step.refuse(words, sight.blind_remedy())
            raise step.refuse(f"water and fish do not come to rest: {words}", _REMEDY)
        step.tell(words, left_s=None if whole else wanted.still_s - covered_s)
        step.wait()


def _passes(drift: Drift, wanted: PreflightLimits) -> bool:
    return drift.speed_m_s + drift.sigma_m_s < wanted.drift_max_m_s


def drift_now(sight: CameraPose, still_s: float) -> Drift | None:
    """Over the last ``still_s``, or what of it was seen; None = too few frames. ``over_s`` is
    ``still_s`` only when the fish was seen from before the window's begin on."""
    frames = sight.last(still_s)
    if len(frames) < _FRAMES_MIN:
        return None
    from_before = sight.frames[0].t_s <= frames[-1].t_s - still_s
    over_s = still_s if from_before else frames[-1].t_s - frames[0].t_s
    return drift_of(frames, over_s)


def drift_of(frames: Sequence[Frame], over_s: float) -> Drift:
    """A straight line through x and y each. The sigma comes from the scatter about the lines: of
    the frames, or, when that is more, of means over a tenth of the time, in which a swaying fish
    or a wave shows that frame by frame looks like a small scatter of many independent ones."""
    t_s = np.array([frame.t_s for frame in frames])
    x_slope, x_sigma = _slope(t_s, np.array([frame.x_m for frame in frames]))
    y_slope, y_sigma = _slope(t_s, np.array([frame.y_m for frame in frames]))
    return Drift("camera", math.hypot(x_slope, y_slope), max(x_sigma, y_sigma), over_s)


def _slope(t_s: F64, way_m: F64) -> tuple[float, float]:
    since_s = t_s - t_s.mean()
    slope, sigma = _line(since_s, way_m)
    edges = np.linspace(since_s[0], since_s[-1], _BLOCKS + 1)[1:-1]
    block = np.searchsorted(edges, since_s, side="right")
    count = np.bincount(block, minlength=_BLOCKS)
    held = count > 0
    if np.count_nonzero(held) < _BLOCKS // 2:
        return slope, math.inf  # seen now and then only
    means = [np.bincount(block, part, _BLOCKS)[held] / count[held] for part in (since_s, way_m)]
    return slope, max(sigma, _line(*means)[1])


def _line(t_s: F64, way_m: F64) -> tuple[float, float]:
    """Slope and its sigma, from the scatter about the line."""
    since_s = t_s - t_s.mean()
    spread = float(since_s @ since_s)
    slope = float(since_s @ way_m) / spread
    rest = way_m - way_m.mean() - slope * since_s
    return slope, math.sqrt(float(rest @ rest) / (len(t_s) - 2) / spread)


def _words(drift: Drift) -> str:
    return f"{drift.speed_m_s * 1e3:.1f} mm/s over {drift.over_s:.0f} s"


def _how_it_moves(sight: CameraPose, drift: Drift | None, wanted: PreflightLimits) -> str:
    if not sight.frames:
        return sight.blind_words()
    if drift is None or drift.over_s < _TOLD_FROM_S:
        return "watches whether it drifts"
    if _passes(drift, wanted):
        return f"drifts {drift.speed_m_s * 1e3:.1f} mm/s"
    unsure = drift.speed_m_s < wanted.drift_max_m_s
    spread = f" +- {drift.sigma_m_s * 1e3:.1f}" if unsure else ""
    most = f"must be below {wanted.drift_max_m_s * 1e3:.3g}"
    return f"drifts {drift.speed_m_s * 1e3:.1f}{spread} mm/s, {most}"


def _wait_by_imu(step: PreflightStep, wanted: PreflightLimits, feel: ImuPose) -> Drift:
    """An IMU feels a push, not a steady drift of the fish with the water."""
    looked_s = -math.inf
    while True:
        if step.elapsed_s - looked_s >= _FELT_LOOK_S:
            looked_s = step.elapsed_s
            still_s = feel.still_s()
            if still_s >= wanted.still_s:
                step.tell(f"nothing has moved it for {still_s:.0f} s, by the IMU", ok=True)
                step.notice("a slow drift cannot be felt by the IMU: look whether it lies still")
                return Drift("imu", math.nan, math.nan, wanted.still_s)
            moves = still_s <= 0
            words = "something moves it" if moves else "nothing moves it, by the IMU"
            if step.is_late:
                raise step.refuse("the fish does not come to rest, by the IMU", _REMEDY)
            step.tell(words, left_s=wanted.still_s - still_s)
        step.wait()


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
    sight = CameraPose(fish, camera, wanted.still_s) if camera is not None else None
    step = PreflightStep(fish, operator, "rest")
    wait_for_rest(step, wanted.rest_s, fish.status(), sight)
    feel = ImuPose.of(fish, PreflightStep(fish, operator, "pose"))
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
    fish: Fish,
    wanted: PreflightLimits,
    operator: Operator,
    sight: CameraPose | None,
    feel: ImuPose | None,
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
            wrong = pose_correction(now, wanted)
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
    travel = travel_next(fish, logbook_of(fish))
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
