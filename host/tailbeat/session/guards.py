"""Guards stop the tail before the fish meets a wall; ``GUARDS`` lists those of every trial.

A guard sees what happens and returns the reason to stop, or None.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.speed_source import CameraGone, Frame, TrackReset, Unseen
from tailbeat.link.messages import BeatEvent
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.session.outcome import BY_HAND, StopKind, StopReason

Guard = Callable[[object], StopReason | None]
"""Sees every Frame, Unseen, TrackReset, CameraGone and BeatEvent as they come (ignore what you do
not know); a reason aborts the trial."""

CRUISE_M_S = 0.08
STOP_S = 0.5  # before the tail rests: picture, radio, and thrust that is under way
KAPPA_PER_M = 10.0
TOUCH_M_S = 0.01  # what comes slower than this does no harm
NOSE_M = 0.20  # from the marker's centre to the tip of the head of a 36 cm fish
LENGTH_M = 0.36

_WINDOW_S = 1.0  # or the nearest number of whole beats
_WINDOW_MIN_S = 0.5
_WHOLE = 0.9  # of the window, from which on the body's sway can be told from a speed
_FRAMES_MIN = 6
_SWIM_MAX_M_S = 0.5  # the nose, too, which sways at 0.25 m/s
_JUMP_M = 0.05
_AGREEING = 3
_UNSEEN_S = 1.0
_BLIND_S = 2.0


def coast_m(speed_m_s: float, kappa_per_m: float) -> float:
    """How far a fish goes on after its last thrust until it does no harm any more: drag takes the
    speed down by exp(-kappa * way)."""
    return max(math.log(max(speed_m_s, TOUCH_M_S) / TOUCH_M_S) / kappa_per_m, 0.0)


def stopping_m(speed_m_s: float, kappa_per_m: float) -> float:
    """How far it comes from the picture that shows it."""
    return STOP_S * max(speed_m_s, 0.0) + coast_m(speed_m_s, kappa_per_m)


class JumpFilter:
    """A lone frame that shows the fish elsewhere is a wrong detection; three that agree are not.
    ``is_near``: whether the fish can have come from one frame to the next."""

    def __init__(self, is_near: Callable[[Frame, Frame], bool]) -> None:
        self._is_near = is_near
        self._doubted: list[Frame] = []

    def accepted(self, last: Frame | None, frame: Frame) -> list[Frame]:
        """What follows ``last``: the frame; nothing while it is doubted; or all frames of a jump,
        which replace what was seen before."""
        doubted = self._doubted
        if last is None or self._is_near(last, frame):
            doubted.clear()
            return [frame]
        if doubted and not self._is_near(doubted[-1], frame):
            doubted.clear()
        doubted.append(frame)
        if len(doubted) < _AGREEING:
            return []
        self._doubted = []
        return doubted


class WallGuard:
    """A guard for run_trial: sees frames, gives a reason to abort.

    The fish's nose and tail keep away from the edges of ``calibration.area_m``: from each edge by
    the way the fish needs to stop, at the speed it comes towards it (``stopping_m``; with
    ``kappa_per_m`` 10, 0.25 m at 0.08 m/s). So a reference of 2.2 m fits into a tank of 3 m, since
    a fish that slows down may come closer. ``zone_m``: instead, so far at 0.08 m/s, in proportion
    to the speed otherwise. An edge that it does not come closer to at 0.01 m/s
    or more does not count: the wall behind it at the start, one that it swims along. Without an
    area, or with ``zone_m`` 0, it never aborts.

    Its velocity is the mean over whole beats of ``beat_s``: the body's sway is not a speed. While
    less is known only what goes along its heading counts.

    A jump that no fish can swim (a wrong detection) is not believed before the third picture says
    the same. A fish that is not seen (Unseen, or a picture that is not believed) is taken to go on
    as it did, after a second as fast as then or as it should, whichever is more. A camera that is
    gone (CameraGone), or has never seen the fish within 2 s, is a reason of its own. TrackReset
    begins anew.
    """

    def __init__(
        self,
        calibration: Calibration,
        zone_m: float | None = None,
        nose_m: float = NOSE_M,
        beat_s: float = 1.0,
        kappa_per_m: float = KAPPA_PER_M,
    ) -> None:
        area = calibration.area_m if zone_m is None or zone_m > 0 else None
        self._walls = None if area is None else _inward(np.asarray(area, dtype=np.float64))
        self._zone_s = None if zone_m is None else zone_m / CRUISE_M_S
        self._kappa_per_m = kappa_per_m
        self._ends_m = np.array([nose_m, nose_m - LENGTH_M])
        self._beat_s = beat_s
        self._window_s = beat_s * max(1, round(_WINDOW_S / beat_s))
        self._begin()

    def _begin(self) -> None:
        self._seen: deque[Frame] = deque()
        self._jumps = JumpFilter(self._within_reach)
        self._velocity = np.zeros(2)
        self._reference_m_s = 0.0  # of the last beat
        self._since_s = math.nan  # the first moment there is word of
        self._reckoned_s = 0.0  # how far in time, and where to since it was seen
        self._ahead_m = np.zeros(2)

    def __call__(self, what: object) -> StopReason | None:
        """The reason to abort, or None. ``what``: a Frame,
        Unseen, a BeatEvent, TrackReset, CameraGone; all else is ignored."""
        if self._walls is None:
            return None
        if isinstance(what, Frame):
            return self._look(what)
        if isinstance(what, Unseen):
            return self._reckon(what.t_s)
        if isinstance(what, BeatEvent):
            self._reference_m_s = what.reference_m_s
        if isinstance(what, TrackReset):
            self._begin()
        if isinstance(what, CameraGone):
            return StopReason(StopKind.CAMERA, "the camera that guards the walls is gone")
        return None

    def _look(self, frame: Frame) -> StopReason | None:
        if not self._believed(frame):
            return self._reckon(frame.t_s)
        self._velocity = self._fitted()
        self._reckoned_s, self._ahead_m = frame.t_s, np.zeros(2)
        return self._judge(self._place(frame), self._velocity, "")

    def _believed(self, frame: Frame) -> bool:
        """Takes a frame into what was seen; not one before or far from the last."""
        if not all(map(math.isfinite, (frame.t_s, frame.x_m, frame.y_m, frame.heading_rad))):
            return False
        seen = self._seen
        if seen and frame.t_s <= seen[-1].t_s:
            return False
        accepted = self._jumps.accepted(seen[-1] if seen else None, frame)
        if not accepted:
            return False
        if len(accepted) > 1:
            seen.clear()
        seen.extend(accepted)
        while frame.t_s - seen[0].t_s > self._window_s * 1.001:
            seen.popleft()
        return True

    def _within_reach(self, before: Frame, after: Frame) -> bool:
        """Also by the ends: a marker that is read back to front stays where it is."""
        moved = np.abs(self._place(after) - self._place(before)).max()
        return bool(moved <= _SWIM_MAX_M_S * (after.t_s - before.t_s) + _JUMP_M)

    def _fitted(self) -> F64:
        """Velocity by a line through what was seen, across the heading by one that also follows the
        body's sway; nothing across it before that was seen for whole beats. The last one known
        while not even the line is long enough."""
        t = np.array([f.t_s for f in self._seen])
        span_s = t[-1] - t[0]
        if span_s < min(_WINDOW_MIN_S, _WHOLE * self._window_s):
            return self._velocity
        t -= t.mean()
        xy = np.array([(f.x_m, f.y_m) for f in self._seen])
        headings = np.array([f.heading_rad for f in self._seen])
        mean_rad = math.atan2(np.sin(headings).sum(), np.cos(headings).sum())
        along = np.array([math.cos(mean_rad), math.sin(mean_rad)])
        velocity: F64 = (t @ xy @ along) / (t @ t) * along
        gaps_s = np.diff(t)
        whole = span_s >= _WHOLE * self._window_s and gaps_s.max() <= self._beat_s / 4
        if whole and len(t) >= _FRAMES_MIN:
            across = np.array([-along[1], along[0]])
            velocity += _beside_sway(t, xy @ across, self._beat_s) * across
        return velocity

    def _reckon(self, now_s: float) -> StopReason | None:
        """Where a fish that is not seen has come to."""
        if not math.isfinite(now_s):
            return None
        if not self._seen:
            self._since_s = now_s if math.isnan(self._since_s) else self._since_s
            blind = now_s - self._since_s > _BLIND_S
            text = "the camera that guards the walls does not see the fish"
            return StopReason(StopKind.CAMERA, text) if blind else None
        last = self._seen[-1]
        if now_s <= self._reckoned_s:
            return None
        long_ago = now_s - last.t_s > _UNSEEN_S
        velocity = self._supposed(last) if long_ago else self._velocity
        self._ahead_m = self._ahead_m + velocity * (now_s - self._reckoned_s)
        self._reckoned_s = now_s
        how = ", not seen any more" if long_ago else ""
        return self._judge(self._place(last) + self._ahead_m, velocity, how)

    def _supposed(self, last: Frame) -> F64:
        """Velocity of a fish that nobody sees."""
        speed = float(np.hypot(*self._velocity))
        along = np.array([math.cos(last.heading_rad), math.sin(last.heading_rad)])
        if speed > 2 * TOUCH_M_S:
            along = self._velocity / speed
        supposed: F64 = max(speed, self._reference_m_s) * along
        return supposed

    def _place(self, frame: Frame) -> F64:
        """Nose and end of the tail, (2, 2)."""
        along = np.array([math.cos(frame.heading_rad), math.sin(frame.heading_rad)])
        place: F64 = np.array([frame.x_m, frame.y_m]) + self._ends_m[:, None] * along
        return place

    def _zone_m(self, towards_m_s: F64) -> F64:
        """How near is too near, for each wall."""
        if self._zone_s is not None:
            return self._zone_s * towards_m_s
        return np.array([stopping_m(float(v), self._kappa_per_m) for v in towards_m_s])

    def _judge(self, place: F64, velocity: F64, how: str) -> StopReason | None:
        assert self._walls is not None
        inward, offset = self._walls
        left_m = (place @ inward.T - offset).min(axis=0)
        towards_m_s = -(inward @ velocity)
        near = (towards_m_s >= TOUCH_M_S) & (left_m < self._zone_m(towards_m_s))
        if not near.any():
            return None
        worst = int(np.argmin(np.where(near, left_m, np.inf)))
        text = f"wall: {max(left_m[worst], 0):.2f} m away at {towards_m_s[worst]:.3f} m/s{how}"
        return StopReason(StopKind.WALL, text)


def _beside_sway(t_s: F64, y_m: F64, beat_s: float) -> float:
    """Slope of a line, were it not for an oscillation of one period per beat: a line alone, over
    one beat, would take up to 6/pi of its amplitude for a way."""
    phase = math.tau * t_s / beat_s
    terms = np.stack([t_s, np.ones_like(t_s), np.sin(phase), np.cos(phase)], axis=1)
    return float(np.linalg.lstsq(terms, y_m, rcond=None)[0][0])


def _inward(corners: F64) -> tuple[F64, F64]:
    """Of each edge the unit vector into the area, (n, 2), and ``offset``: a point p is
    inward @ p - offset away from it, inside positive."""
    along = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    offset = (inward * corners).sum(axis=1)
    if (corners.mean(axis=0) @ inward.T < offset).any():
        inward, offset = -inward, -offset
    return inward, offset


_LATE_S = 2.0  # SPD_LATE_S + SPD_GAP_S as they are by default
_STOP_S = 0.5  # radio, the coast to the centre, thrust that is under way
_LOOK_BACK = 4  # beats
_PLANNED_M = 0.1  # less is too little to tell by how much a fish differs from what was planned
_RATIO = (0.25, 4.0)


@dataclass
class DistanceGuard:
    """Stops a fish that has swum as far as the tank allows, less the way it coasts on: by the sums
    of its beats' speeds, which come ``late_s`` after their ends. ``room_m`` 0 or infinite: never.

    ``planned_m_s``: the speeds that are expected, per beat and for the coast after the last one.
    A fish that will come to rest in time if it goes on differing from them as it did is let swim;
    without them it is stopped where it could just still be. A beat without a speed counts as fast
    as the last one, or as planned. ``way_m``: so far, up to the end of the last beat heard of.
    """

    room_m: float
    beat_s: float = 1.0
    kappa_per_m: float = 10.0
    planned_m_s: ArrayLike | None = None
    late_s: float = _LATE_S
    way_m: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        planned = () if self.planned_m_s is None else self.planned_m_s
        self._planned = np.asarray(planned, dtype=np.float64)
        self._begin()

    @classmethod
    def of(cls, trial: GuardedTrial) -> DistanceGuard:
        """For a board with the trial's parameters."""
        params, kappa = trial.params, trial.kappa_per_m
        tank_m = params["TANK_LEN_M"]
        room_m = max(tank_m - params["FISH_LEN_M"], 0.01) if tank_m > 0 else math.inf
        late_s = params["SPD_LATE_S"] + params["SPD_GAP_S"]
        kappa = params["MDL_KAPPA"] if kappa is None else kappa
        return cls(room_m, trial.beat_s, kappa, trial.planned_m_s, late_s)

    def _begin(self) -> None:
        self.way_m = 0.0
        self._speeds: list[float] = []
        self._measured: list[bool] = []

    def __call__(self, seen: object) -> StopReason | None:
        """Looks at results.BeatEvent, and at TrackReset, which begins anew."""
        if isinstance(seen, TrackReset):
            self._begin()
        if not isinstance(seen, BeatEvent) or self.room_m <= 0 or math.isinf(self.room_m):
            return None
        if seen.beat < len(self._speeds):
            return None
        while len(self._speeds) < seen.beat:
            self._take(None)
        self._take(seen.speed_m_s)
        return self._judge()

    def _take(self, speed_m_s: float | None) -> None:
        known = speed_m_s is not None and math.isfinite(speed_m_s)
        speed = float(speed_m_s) if known and speed_m_s is not None else self._supposed()
        self._speeds.append(speed)
        self._measured.append(known)
        self.way_m += speed * self.beat_s

    def _supposed(self) -> float:
        """Speed of the next beat, which nobody measured."""
        last = self._speeds[-1] if self._speeds else 0.0
        beat = len(self._speeds)
        return self._ratio() * float(self._planned[beat]) if beat < len(self._planned) else last

    def _judge(self) -> StopReason | None:
        """Whether now is the last moment: a beat later, with what is under way, would be too late
        to stop."""
        at_m_s = max(self._ahead_m_s(), 0.0)
        under_way_m = at_m_s * (self.late_s + self.beat_s + _STOP_S)
        reach_m = self.way_m + under_way_m + coast_m(at_m_s, self.kappa_per_m)
        if reach_m < self.room_m or self._will_rest_in_time():
            return None
        return StopReason(
            StopKind.DISTANCE,
            f"room: travel {self.way_m:.2f} m, stopping point "
            f"{min(reach_m, 9.99):.2f} m, clearance {self.room_m:.2f} m",
        )

    def _ahead_m_s(self) -> float:
        """The fastest it may be until a stop takes hold: as fast as it was, and faster by as much
        as is planned."""
        last = self._speeds[-1]
        beat = len(self._speeds)
        soon = self._planned[beat : beat + math.ceil(self.late_s / self.beat_s) + 2]
        return max(last, self._ratio() * float(soon.max())) if soon.size else last

    def _ratio(self) -> float:
        """How much faster than planned it swims: of all its beats or the last few, which is more;
        1 while too little is known."""
        count = min(len(self._speeds), len(self._planned))
        known = np.array(self._measured[:count], dtype=bool)
        speed, planned = np.array(self._speeds[:count]), self._planned[:count]
        ratios = []
        for part in (slice(0, count), slice(max(count - _LOOK_BACK, 0), count)):
            seen = known[part]
            expected = float(planned[part][seen].sum())
            if expected * self.beat_s >= _PLANNED_M:
                ratios.append(float(speed[part][seen].sum()) / expected)
        return min(max(max(ratios, default=1.0), _RATIO[0]), _RATIO[1])

    def _will_rest_in_time(self) -> bool:
        """By what is planned, if the rest of it differs as what is known did."""
        beat = len(self._speeds)
        if not len(self._planned) or beat > len(self._planned):
            return False
        left_m = float(self._planned[beat:].sum()) * self.beat_s
        return self.way_m + self._ratio() * left_m < self.room_m


def stop_when(wanted: Callable[[], bool], reason: StopReason) -> Guard:
    """Aborts with ``reason`` as soon as ``wanted()``."""
    return lambda _: reason if wanted() else None


@dataclass
class FrameRecorder:
    """Keeps every frame of the trial; stops nothing."""

    frames: list[Frame] = field(default_factory=list)

    def __call__(self, seen: object) -> None:
        """Takes frames, and forgets them on TrackReset."""
        if isinstance(seen, TrackReset):
            self.frames.clear()
        elif isinstance(seen, Frame):
            self.frames.append(seen)


@dataclass(frozen=True)
class GuardedTrial:
    """What the guards of a trial are made from. ``params``: of the board; ``planned_m_s``,
    ``kappa_per_m``: as DistanceGuard has them, None = MDL_KAPPA; ``caller``: a guard of the
    caller's, such as a WallGuard; ``abort_requested``: by the operator."""

    params: Mapping[str, float]
    planned_m_s: ArrayLike
    abort_requested: Callable[[], bool] = lambda: False
    caller: Guard | None = None
    beat_s: float = 1.0
    kappa_per_m: float | None = None


def caller_guard(trial: GuardedTrial) -> Guard | None:
    """The guard that the caller gave."""
    return trial.caller


def operator_guard(trial: GuardedTrial) -> Guard:
    """Stops the trial when the operator asks for it."""
    return stop_when(trial.abort_requested, BY_HAND)


# The guards of every trial; the first reason counts.
GUARDS: tuple[Callable[[GuardedTrial], Guard | None], ...] = (
    caller_guard,
    DistanceGuard.of,
    operator_guard,
)


def guards_of(trial: GuardedTrial, *recorders: Guard) -> Guard:
    """All GUARDS of a trial as one, with what else sees all that they see."""
    return all_guards(*(make(trial) for make in GUARDS), *recorders)


def all_guards(*guards: Guard | None) -> Guard:
    """Asks every guard (all see everything); the first reason counts."""
    there = [guard for guard in guards if guard is not None]

    def ask(seen: object) -> StopReason | None:
        reasons = [guard(seen) for guard in there]
        return next((reason for reason in reasons if reason), None)

    return ask
