"""Whether the fish lies on the start line with its nose along the tank, and what to do if not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tailbeat.day.feel import mean_angle, wrapped_deg
from tailbeat.day.wanted import Pose, Wanted

if TYPE_CHECKING:
    from tailbeat.camera.base import Frame
    from tailbeat.day.feel import Attitude, Feel
    from tailbeat.day.sight import Sight
    from tailbeat.day.step import Step

_OVER_S = 1.0  # of board time
_LEAST_S = 0.8
_FRAMES_MIN = 6
_AGREE_MIN = 0.95  # of the headings: they scatter by less than 18 degrees
_TURNED_MAX_RAD = math.radians(3.0)
_LEVEL_DEG = 10.0
_FELT_WAIT_S = 4.0


def wait_for_pose(
    step: Step, wanted: Wanted, sight: Sight | None, feel: Feel | None
) -> Pose | None:
    """Waits until it lies right. None when nothing can tell. Raises NotReady and what the step and
    the camera raise."""
    if sight is None and feel is None:
        text = "the start pose is not checked: there is no camera and no IMU"
        step.notice(text)
        return None
    while True:
        if sight is not None:
            sight.look(step)
        pose = pose_now(sight, feel)
        wrong = _unknown(sight) if pose is None else what_to_do(pose, wanted)
        if pose is not None and wrong is None and _has_felt(step, feel):
            _tell_right(step, pose, wanted, feel)
            return pose
        wrong = wrong or "asks the IMU, too"
        if step.is_late:
            if sight is not None and not sight.frames:
                raise step.refuse(wrong, sight.blind_remedy())
            raise step.refuse(f"the fish does not lie as it should: {wrong}", _REMEDY)
        step.tell(wrong)
        step.wait()


_REMEDY = "Put it on the start line with its nose along the tank, and begin again."


def pose_now(sight: Sight | None, feel: Feel | None) -> Pose | None:
    """Mean over the last second; None when too little is known."""
    attitude = feel.attitude() if feel is not None else None
    yaw_deg = attitude.yaw_deg if attitude is not None else None
    if sight is None:
        return None if yaw_deg is None else Pose("imu", yaw_deg=yaw_deg)
    frames = sight.last(_OVER_S)
    if len(frames) < _FRAMES_MIN or frames[-1].t_s - frames[0].t_s < _LEAST_S:
        return None
    heading_rad, agree = mean_angle(frame.heading_rad for frame in frames)
    if agree < _AGREE_MIN or _turned_rad(frames) > _TURNED_MAX_RAD:
        return None
    x_m = math.fsum(frame.x_m for frame in frames) / len(frames)
    y_m = math.fsum(frame.y_m for frame in frames) / len(frames)
    return Pose("camera", x_m, y_m, heading_rad, yaw_deg)


def _turned_rad(frames: Sequence[Frame]) -> float:
    """From the first half to the second: somebody's hand is still at it."""
    half = len(frames) // 2
    first, _ = mean_angle(frame.heading_rad for frame in frames[:half])
    second, _ = mean_angle(frame.heading_rad for frame in frames[half:])
    return abs(math.remainder(second - first, math.tau))


def what_to_do(pose: Pose, wanted: Wanted) -> str | None:
    """In words for who stands behind the fish; None when it lies right. Without a camera its yaw is
    compared with that of an earlier start, if there was one."""
    if pose.source == "camera":
        assert pose.heading_rad is not None and pose.y_m is not None
        wrong = [_turn(pose.heading_rad, wanted), _aside(pose.y_m, wanted)]
    elif wanted.start_yaw_deg is not None:
        assert pose.yaw_deg is not None
        off_rad = math.radians(wrapped_deg(pose.yaw_deg - wanted.start_yaw_deg))
        wrong = [_turn(off_rad, wanted)]
    else:
        wrong = []
    return "; ".join(words for words in wrong if words) or None


def _turn(heading_rad: float, wanted: Wanted) -> str | None:
    """Headings count clockwise from above."""
    if abs(heading_rad) <= wanted.heading_max_rad:
        return None
    side = "left" if heading_rad > 0 else "right"
    return f"turn the nose {math.degrees(abs(heading_rad)):.0f} degrees to the {side}"


def _aside(y_m: float, wanted: Wanted) -> str | None:
    if abs(y_m) <= wanted.aside_max_m:
        return None
    return f"it lies {abs(y_m):.2f} m to the {'right' if y_m > 0 else 'left'} of the line"


def _unknown(sight: Sight | None) -> str:
    if sight is None:
        return "the IMU has not told its yaw yet"
    return "looks where the fish lies" if sight.frames else sight.blind_words()


def _has_felt(step: Step, feel: Feel | None) -> bool:
    """An IMU that streams is heard a second later than a camera; on a bad radio it may never be."""
    return feel is None or feel.attitude() is not None or step.elapsed_s > _FELT_WAIT_S


def _tell_right(step: Step, pose: Pose, wanted: Wanted, feel: Feel | None) -> None:
    attitude = feel.attitude() if feel is not None else None
    if attitude is not None:
        _tell_tilt(step, attitude)
    if pose.heading_rad is not None and pose.y_m is not None:
        heading_deg = math.degrees(pose.heading_rad)
        step.tell(f"nose {heading_deg:+.0f} degrees, {pose.y_m:+.2f} m from the line", ok=True)
    elif wanted.start_yaw_deg is not None:
        step.tell("the nose points as at the earlier start, by the IMU", ok=True)
    else:
        step.notice("the start pose is not checked: there is no camera and no earlier start")


def _tell_tilt(step: Step, attitude: Attitude) -> None:
    for name, angle_deg in (("pitch", attitude.pitch_deg), ("roll", attitude.roll_deg)):
        if abs(angle_deg) > _LEVEL_DEG:
            step.notice(f"the fish does not lie level: {name} {angle_deg:+.0f} degrees")
