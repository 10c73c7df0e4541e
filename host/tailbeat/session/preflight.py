"""The preflight checks: what must be so before a trial. ``CHECKS`` is the table of them.

Each check reports its progress; one that fails raises NotReady with what to do. A check that needs
a missing sensor is reported as skipped, never as passed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary, WeakSet

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.faults import BATTERY_SENSE, TRIAL_PENDING, fault_info
from tailbeat.core.speed_source import Camera, Frame
from tailbeat.core.trial_file import parse_trial
from tailbeat.experiment.library import library_of
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
from tailbeat.session.preflight_step import BatteryLow, NotReady, PreflightLimits, PreflightStep
from tailbeat.session.travel import travel_next

_HEAD_BYTES = 1024  # of a trial's file, with when it began and how long its beats are


class _TrialEndListener:
    """Sees swims end while this process is connected, so that no log is read for them."""

    def __init__(self) -> None:
        self.trial: int | None = None
        self.ended_s: float | None = None  # None: it swims, as far as was heard
        self._time_s = -math.inf

    def hear(self, message: Message) -> None:
        """A TAILBEAT_STATUS of the board's."""
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
        fish.link.subscribe(seen.hear, ["TAILBEAT_STATUS"])


def rested_s(fish: Fish, status: BoardStatus) -> float | None:
    """How long it has rested at ``status``, at least; None = it has never executed. Of a board that
    has restarted since only how long it is up is known, of one whose log is gone nothing: 0."""
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
    step: PreflightStep, rest_s: float, status: BoardStatus, view: CameraPose | None
) -> None:
    """Waits until ``rest_s`` after the last trial's end. ``status``: of now."""
    if rest_s <= 0:
        return
    step.tell("asks the board when its last trial was")
    asked_s = step.elapsed_s
    rested = rested_s(step.fish, status)
    if rested is None:
        step.tell("it has not executed yet", ok=True)
        return
    while (left_s := rest_s - rested - (step.elapsed_s - asked_s)) > 0:
        step.tell("the water rests", left_s=left_s)
        step.wait()
        if view is not None:
            view.look(step)
    step.tell("rested", ok=True, left_s=0.0)


_REPORT_FROM_S = 2.0  # over less a camera's noise of 1 mm is more than what is looked for
_BLOCKS = 10
_FRAMES_MIN = 12
_IMU_LOOK_S = 0.5


def wait_until_still(
    step: PreflightStep, limits: PreflightLimits, view: CameraPose | None, imu: ImuPose | None
) -> Drift | None:
    """Waits until it has been still for ``still_s``. None when nothing can tell, or nobody asked.
    Raises NotReady and what the step and the camera raise."""
    if limits.still_s <= 0:
        return None
    if view is not None:
        return _wait_by_camera(step, limits, view)
    if imu is not None:
        return _wait_by_imu(step, limits, imu)
    step.notice("not checked: whether water and fish are still, without camera and IMU")
    return None


def _wait_by_camera(step: PreflightStep, limits: PreflightLimits, view: CameraPose) -> Drift:
    while True:
        view.look(step)
        drift = drift_now(view, limits.still_s)
        covered_s = 0.0 if drift is None else drift.over_s
        whole = covered_s >= limits.still_s
        if drift is not None and whole and _passes(drift, limits):
            step.tell(_words(drift), ok=True)
            return drift
        words = _how_it_moves(view, drift, limits)
        if step.is_late:
            if not view.frames:
                raise step.refuse(words, view.blind_remedy())
            raise step.refuse(f"water and fish do not come to rest: {words}")
        step.tell(words, left_s=None if whole else limits.still_s - covered_s)
        step.wait()


def _passes(drift: Drift, limits: PreflightLimits) -> bool:
    return drift.speed_m_s + drift.sigma_m_s < limits.drift_max_m_s


def drift_now(view: CameraPose, still_s: float) -> Drift | None:
    """Over the last ``still_s``, or what of it was seen; None = too few frames. ``over_s`` is
    ``still_s`` only when the fish was seen from before the window's begin on."""
    frames = view.last(still_s)
    if len(frames) < _FRAMES_MIN:
        return None
    from_before = view.frames[0].t_s <= frames[-1].t_s - still_s
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


def _how_it_moves(view: CameraPose, drift: Drift | None, limits: PreflightLimits) -> str:
    if not view.frames:
        return view.blind_words()
    if drift is None or drift.over_s < _REPORT_FROM_S:
        return "watches whether it drifts"
    if _passes(drift, limits):
        return f"drifts {drift.speed_m_s * 1e3:.1f} mm/s"
    unsure = drift.speed_m_s < limits.drift_max_m_s
    spread = f" +- {drift.sigma_m_s * 1e3:.1f}" if unsure else ""
    most = f"must be below {limits.drift_max_m_s * 1e3:.3g}"
    return f"drifts {drift.speed_m_s * 1e3:.1f}{spread} mm/s, {most}"


def _wait_by_imu(step: PreflightStep, limits: PreflightLimits, imu: ImuPose) -> Drift:
    """An IMU feels a push, not a steady drift of the fish with the water."""
    looked_s = -math.inf
    while True:
        if step.elapsed_s - looked_s >= _IMU_LOOK_S:
            looked_s = step.elapsed_s
            still_s = imu.still_s()
            if still_s >= limits.still_s:
                step.tell(f"nothing has moved it for {still_s:.0f} s, by the IMU", ok=True)
                step.notice("a slow drift cannot be felt by the IMU: look whether it lies still")
                return Drift("imu", math.nan, math.nan, limits.still_s)
            moves = still_s <= 0
            words = "something moves it" if moves else "nothing moves it, by the IMU"
            if step.is_late:
                raise step.refuse("the fish does not come to rest, by the IMU")
            step.tell(words, left_s=limits.still_s - still_s)
        step.wait()


_ROUNDS = 3  # a fish that turns while the water calms down is put right again
_BATTERY_RISE_V = 0.2  # once it was too low, by the board's rule (supervisor/battery.h)

_found_low: WeakSet[Fish] = WeakSet()


@dataclass
class Preflight:
    """What the checks of one trial share, and what they have found so far."""

    fish: Fish
    limits: PreflightLimits
    camera: Camera | None
    operator: Operator
    status: BoardStatus | None = None
    travel: Travel | None = None
    view: CameraPose | None = None
    imu: ImuPose | None = None
    pose: Pose | None = None
    drift: Drift | None = None

    def step(self, check: Check) -> PreflightStep:
        """The progress of a check, from now on."""
        patience_s = self.limits.patience_s if check.is_waiting else math.inf
        return PreflightStep(self.fish, self.operator, check.name, patience_s, check.remedy)


def check_board(at: Preflight, step: PreflightStep) -> None:
    """IDLE, with nothing pending and enough battery; an armed board is disarmed."""
    fish, before = at.fish, at.status
    at.status = status = fish.status()
    if status.state == "ARMED":
        fish.disarm()
        step.notice("the board was armed; it is disarmed until the countdown")
        at.status = status = fish.status()
    if status.state in ("ABORTED", "FAULT"):
        fault = status.fault
        what = f"the board is stopped ({fault.name}): {fault.meaning}"
        raise step.refuse(what, f"{fault.remedy} To clear it: tailbeat board clear")
    if status.state != "IDLE":
        raise step.refuse(f"the board is busy ({status.state})")
    if status.pending_trial is not None:
        pending = fault_info(TRIAL_PENDING)
        raise step.refuse(f"{pending.meaning} (trial {status.pending_trial})", pending.remedy)
    _check_battery(fish, step, status)
    step.tell(f"idle, battery {status.battery_v:.2f} V", ok=True)
    if before is not None and status.time_s < before.time_s:
        raise NotReady("the board has restarted meanwhile", "Look at the battery; begin again.")


def _check_battery(fish: Fish, step: PreflightStep, status: BoardStatus) -> None:
    """By the rule by which the board refuses to arm. The board does not report what it remembers
    of an earlier connection, hence the notice."""
    low_v = fish.params.get("BATT_LOW_V").value
    least_v = low_v + _BATTERY_RISE_V if fish in _found_low else low_v
    if low_v <= 0:
        return
    if status.battery_at_limit:
        sense = fault_info(BATTERY_SENSE)
        raise step.refuse(sense.meaning, sense.remedy)
    if round(status.battery_v * 1e3) < round(least_v * 1e3):
        _found_low.add(fish)
        raise step.refuse(
            f"the battery has {status.battery_v:.2f} V, a trial needs {least_v:.2f} V to begin"
            " with",
            "Swap the battery, then begin again.",
            BatteryLow,
        )
    _found_low.discard(fish)
    if status.battery_v < low_v + _BATTERY_RISE_V:
        step.notice(f"the battery is nearly empty: {status.battery_v:.2f} V; have a full one ready")


def check_room(at: Preflight, step: PreflightStep) -> None:
    """The expected travel fits into the tank. Raises InputError."""
    at.travel = travel = at.travel or travel_next(at.fish, library_of(at.fish))
    try:
        travel.require_room()
    except InputError as error:
        step.tell(error.message, ok=False)
        raise
    if travel.worst_m > travel.room_m:
        step.notice(
            f"tank clearance {travel.room_m:.2f} m; the expected travel is"
            f" {travel.expected_m:.2f} m, at worst {travel.worst_m:.2f}: be ready to catch the fish"
        )
    step.tell(travel.text(), ok=True)


def check_rest(at: Preflight, step: PreflightStep) -> None:
    """The water has rested since the end of the last trial."""
    if at.camera is not None:
        at.view = CameraPose(at.fish, at.camera, at.limits.still_s)
    wait_for_rest(step, at.limits.rest_s, at.fish.status(), at.view)


def check_pose(at: Preflight, step: PreflightStep) -> None:
    """The fish lies on the start line, its nose along the tank."""
    if at.imu is None:
        at.imu = ImuPose.of(at.fish, at.step(POSE))
    at.pose = wait_for_pose(step, at.limits, at.view, at.imu)


def check_stillness(at: Preflight, step: PreflightStep) -> None:
    """Water and fish are still, and the fish lies right at the same time."""
    for attempt in range(_ROUNDS):
        if attempt:
            check_pose(at, at.step(POSE))
            step = at.step(STILLNESS)
        at.drift = wait_until_still(step, at.limits, at.view, at.imu)
        now = pose_now(at.view, at.imu)
        if now is None and at.view is None:
            now = at.pose
        wrong = "it turns" if now is None and at.pose is not None else None
        if now is not None:
            wrong = pose_correction(now, at.limits)
        if wrong is None:
            at.pose = now
            return
        step.notice(f"the start pose has changed: {wrong}")
    raise at.step(POSE).refuse(
        f"the fish does not keep its start pose: {wrong}",
        "Look for a current that turns it, or trim its ballast; then begin again.",
    )


@dataclass(frozen=True)  # one row of CHECKS
class Check:
    """One preflight check. ``function`` raises NotReady (``step.refuse``) when the trial may not
    begin; ``remedy``: what to do then, unless the function gives another. ``is_waiting``: it ends
    after ``patience_s``."""

    name: str
    function: Callable[[Preflight, PreflightStep], None]
    remedy: str = ""
    is_waiting: bool = False


BOARD = Check("board", check_board, "Wait until it is idle: tailbeat info")
POSE = Check(
    "pose",
    check_pose,
    "Put it on the start line with its nose along the tank, and begin again.",
    is_waiting=True,
)
STILLNESS = Check(
    "still",
    check_stillness,
    "Switch off pumps and let the water calm down. Release the fish only when it lies still,"
    " then begin again.",
    is_waiting=True,
)
# In this order: what needs no waiting comes first. The board is checked again at the end.
CHECKS = (
    BOARD,
    Check("room", check_room),
    Check("rest", check_rest),
    POSE,
    STILLNESS,
    BOARD,
)


def prepare(
    fish: Fish,
    limits: PreflightLimits,
    camera: Camera | None,
    operator: Operator,
    travel: Travel | None = None,
) -> Ready:
    """Makes all CHECKS, up to the countdown; the board is IDLE and unarmed all the time.
    ``travel``: of a run that was planned; None: that of the board's next trial. Raises NotReady,
    GivenUp (operator.wants_abort), CameraGone, InputError (no room), Refused."""
    watch(fish)
    at = Preflight(fish, limits, camera, operator, travel=travel)
    try:
        for check in CHECKS:
            check.function(at, at.step(check))
    finally:
        if at.imu is not None:
            at.imu.close()
    assert at.status is not None and at.travel is not None
    rest_s = rested_s(fish, at.status)
    return Ready(at.travel, rest_s, at.pose, at.drift, at.status.battery_v)
