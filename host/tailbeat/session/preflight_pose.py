"""Where the fish lies before a trial, as the camera and the IMU show it, and how to correct it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from tailbeat.core.faults import IMU_STARTING
from tailbeat.core.speed_source import Camera, CameraGone, Frame
from tailbeat.link.mavlink import Message
from tailbeat.sensors.camera.tracking.tracker import RepeatFilter
from tailbeat.session.guards import JumpFilter
from tailbeat.session.outcome import Pose
from tailbeat.session.preflight_step import PreflightLimits, PreflightStep

_OVER_S = 1.2  # of board time, so that two lines a second apart are in it
_LEAST_S = 0.8
_SILENT_S = 2.5  # board time without a line of it
_VERDICT_S = 6.0  # of board time, after which the board knows what IMU there is


@dataclass(frozen=True)
class Attitude:
    """Mean over a second, degrees."""

    yaw_deg: float
    pitch_deg: float
    roll_deg: float


class ImuPose:
    """Listens to TAILBEAT_LIVE and, for a board that sends none, ATTITUDE, until closed."""

    def __init__(self, fish: Fish) -> None:
        self._fish = fish
        self._lines: deque[tuple[float, float, float, float]] = deque(maxlen=256)
        self._heard_at_s = fish.transport.now_s()
        self.close = fish.link.subscribe(self._hear)

    @classmethod
    def of(cls, fish: Fish, step: PreflightStep) -> ImuPose | None:
        """None when the board has no IMU that streams; waits until it knows."""
        while (info := fish.imu_info()).problem.number == IMU_STARTING:
            if step.elapsed_s > _VERDICT_S:
                break
            step.tell("waits for the IMU")
            step.wait()
        return cls(fish) if info.state == "streaming" else None

    def attitude(self) -> Attitude | None:
        """None when too little has come lately."""
        silent_s = (self._fish.transport.now_s() - self._heard_at_s) * self._fish.clock.rate
        if not self._lines or silent_s > _SILENT_S:
            return None
        lines = [line for line in self._lines if line[0] >= self._lines[-1][0] - _OVER_S]
        if lines[-1][0] - lines[0][0] < _LEAST_S:
            return None
        yaw, pitch, roll = (mean_angle(line[i] for line in lines)[0] for i in (1, 2, 3))
        return Attitude(math.degrees(yaw), math.degrees(pitch), math.degrees(roll))

    def still_s(self) -> float:
        """How long nothing has moved the fish."""
        return float(self._fish.link.request("TAILBEAT_IMU_INFO").still_s)

    def _hear(self, message: Message) -> None:
        kind = message.get_type()
        if kind == "TAILBEAT_LIVE":
            angles = (message.yaw_rad, message.pitch_rad, message.roll_rad)
        elif kind == "ATTITUDE":
            angles = (message.yaw, message.pitch, message.roll)
        else:
            return
        if not all(map(math.isfinite, angles)):
            return
        time_s = message.time_boot_ms * 1e-3
        if self._lines and time_s < self._lines[-1][0] - _OVER_S:
            self._lines.clear()  # the board has restarted
        self._lines.append((time_s, *angles))
        self._heard_at_s = self._fish.transport.now_s()


def mean_angle(angles_rad: Iterable[float]) -> tuple[float, float]:
    """Circular mean, and how well they agree: 1 = all the same, 0 = none with another."""
    held = list(angles_rad)
    along = math.fsum(map(math.cos, held)) / len(held)
    across = math.fsum(map(math.sin, held)) / len(held)
    return math.atan2(across, along), math.hypot(along, across)


def wrapped_deg(angle_deg: float) -> float:
    """The same direction in -180 to 180."""
    return (angle_deg + 180.0) % 360.0 - 180.0


_OVER_S_POSE = 1.0  # of board time

_FRAMES_MIN = 6
_AGREE_MIN = 0.95  # of the headings: they scatter by less than 18 degrees
_TURNED_MAX_RAD = math.radians(3.0)
_LEVEL_DEG = 10.0
_IMU_WAIT_S = 4.0


def wait_for_pose(
    step: PreflightStep, limits: PreflightLimits, view: CameraPose | None, imu: ImuPose | None
) -> Pose | None:
    """Waits until it lies right. None when nothing can tell. Raises NotReady and what the step and
    the camera raise."""
    if view is None and imu is None:
        text = "the start pose is not checked: there is no camera and no IMU"
        step.notice(text)
        return None
    while True:
        if view is not None:
            view.look(step)
        pose = pose_now(view, imu)
        wrong = _unknown(view) if pose is None else pose_correction(pose, limits)
        if pose is not None and wrong is None and _has_imu_attitude(step, imu):
            _report_pose(step, pose, limits, imu)
            return pose
        wrong = wrong or "asks the IMU, too"
        if step.is_late:
            if view is not None and not view.frames:
                raise step.refuse(wrong, view.blind_remedy())
            raise step.refuse(f"the fish does not lie as it should: {wrong}")
        step.tell(wrong)
        step.wait()


def pose_now(view: CameraPose | None, imu: ImuPose | None) -> Pose | None:
    """Mean over the last second; None when too little is known."""
    attitude = imu.attitude() if imu is not None else None
    yaw_deg = attitude.yaw_deg if attitude is not None else None
    if view is None:
        return None if yaw_deg is None else Pose("imu", yaw_deg=yaw_deg)
    frames = view.last(_OVER_S_POSE)
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


def pose_correction(pose: Pose, limits: PreflightLimits) -> str | None:
    """In words for who stands behind the fish; None when it lies right. Without a camera its yaw is
    compared with that of an earlier start, if there was one."""
    if pose.source == "camera":
        assert pose.heading_rad is not None and pose.y_m is not None
        wrong = [_turn(pose.heading_rad, limits), _aside(pose.y_m, limits)]
    elif limits.start_yaw_deg is not None:
        assert pose.yaw_deg is not None
        off_rad = math.radians(wrapped_deg(pose.yaw_deg - limits.start_yaw_deg))
        wrong = [_turn(off_rad, limits)]
    else:
        wrong = []
    return "; ".join(words for words in wrong if words) or None


def _turn(heading_rad: float, limits: PreflightLimits) -> str | None:
    """Headings count clockwise from above."""
    if abs(heading_rad) <= limits.heading_max_rad:
        return None
    side = "left" if heading_rad > 0 else "right"
    return f"turn the nose {math.degrees(abs(heading_rad)):.0f} degrees to the {side}"


def _aside(y_m: float, limits: PreflightLimits) -> str | None:
    if abs(y_m) <= limits.aside_max_m:
        return None
    return f"it lies {abs(y_m):.2f} m to the {'right' if y_m > 0 else 'left'} of the line"


def _unknown(view: CameraPose | None) -> str:
    if view is None:
        return "the IMU has not reported its yaw yet"
    return "looks where the fish lies" if view.frames else view.blind_words()


def _has_imu_attitude(step: PreflightStep, imu: ImuPose | None) -> bool:
    """An IMU that streams is heard a second later than a camera; on a bad radio it may never be."""
    return imu is None or imu.attitude() is not None or step.elapsed_s > _IMU_WAIT_S


def _report_pose(
    step: PreflightStep, pose: Pose, limits: PreflightLimits, imu: ImuPose | None
) -> None:
    attitude = imu.attitude() if imu is not None else None
    if attitude is not None:
        _report_tilt(step, attitude)
    if pose.heading_rad is not None and pose.y_m is not None:
        heading_deg = math.degrees(pose.heading_rad)
        step.tell(f"nose {heading_deg:+.0f} degrees, {pose.y_m:+.2f} m from the line", ok=True)
    elif limits.start_yaw_deg is not None:
        step.tell("the nose points as at the earlier start, by the IMU", ok=True)
    else:
        step.notice("the start pose is not checked: there is no camera and no earlier start")


def _report_tilt(step: PreflightStep, attitude: Attitude) -> None:
    for name, angle_deg in (("pitch", attitude.pitch_deg), ("roll", attitude.roll_deg)):
        if abs(angle_deg) > _LEVEL_DEG:
            step.notice(f"the fish does not lie level: {name} {angle_deg:+.0f} degrees")


BLIND_S = 1.0  # without a frame that shows the fish, after which it counts as not seen
_JUMP_M = 0.05  # from one frame to the next; no water carries a fish so fast
_KEPT_MORE_S = 2.0
_LOOK = "Look at the camera, the light and the marker on the fish, then begin again."
_MOVE = (
    "Look at the camera: it sends the same picture again and again. Restart it, plug it in anew;"
    " then begin again."
)


class CameraPose:
    """``frames``: believed, oldest first, ``keep_s`` of them and a little more; their time in s of
    board time from some moment on. None is older than the last time the fish was carried (it
    jumped) or out of view for longer than BLIND_S. A picture that stands still to the last bit
    shows no fish: every camera has noise, but one that is simulated.
    """

    def __init__(self, fish: Fish, camera: Camera, keep_s: float) -> None:
        self.frames: deque[Frame] = deque()
        self._fish, self._camera = fish, camera
        self._keep_s = keep_s + _KEPT_MORE_S
        self._repeats = RepeatFilter(camera)
        self._jumps = JumpFilter(_is_near)
        self._seen_at_s = fish.transport.now_s()
        camera.frames()  # what it saw before does not count

    def look(self, step: PreflightStep) -> None:
        """Takes in what has come. Raises CameraGone, or what else the camera raises, told."""
        self._repeats.must_move()
        try:
            came = self._camera.frames()
        except TailbeatError as error:
            gone = isinstance(error, CameraGone)
            step.tell(f"the camera is gone: {error}" if gone else f"{error}", ok=False)
            raise
        for frame in self._repeats.new([self._scaled(frame) for frame in came]):
            if all(map(math.isfinite, (frame.t_s, frame.x_m, frame.y_m, frame.heading_rad))):
                self._take(frame)
        if self.blind_s > BLIND_S:
            self.frames.clear()

    @property
    def blind_s(self) -> float:
        """How long ago the newest frame came that shows the fish, in s of board time."""
        return (self._fish.transport.now_s() - self._seen_at_s) * self._fish.clock.rate

    def blind_words(self) -> str:
        """Why there is nothing to be seen."""
        if self._repeats.frozen:
            return "the camera's picture stands still"
        words = getattr(self._camera, "blind_words", "the camera does not see the fish")
        return str(words)

    def blind_remedy(self) -> str:
        """What to do about that."""
        return _MOVE if self._repeats.frozen else _LOOK

    def last(self, duration_s: float) -> list[Frame]:
        """The frames of that time before the newest one."""
        if not self.frames:
            return []
        since_s = self.frames[-1].t_s - duration_s - 1e-9
        return [frame for frame in self.frames if frame.t_s >= since_s]

    def _scaled(self, frame: Frame) -> Frame:
        rate = self._fish.clock.rate if self._camera.clock == "host" else 1.0
        return Frame(frame.t_s * rate, frame.x_m, frame.y_m, frame.heading_rad)

    def _take(self, frame: Frame) -> None:
        """A lone frame that shows the fish elsewhere is a wrong detection."""
        before = self.frames[-1] if self.frames else None
        if before is not None and frame.t_s <= before.t_s:
            return
        accepted = self._jumps.accepted(before, frame)
        if not accepted:
            return
        late = before is not None and frame.t_s - before.t_s > BLIND_S
        if late or len(accepted) > 1:
            self.frames.clear()
        self.frames.extend(accepted)
        self._seen_at_s = self._fish.transport.now_s()
        while self.frames[-1].t_s - self.frames[0].t_s > self._keep_s:
            self.frames.popleft()


def _is_near(one: Frame, other: Frame) -> bool:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) <= _JUMP_M
