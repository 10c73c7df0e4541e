"""Stops the tail before the fish meets a wall."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.base import Afresh, CameraGone, Frame, Unseen
from tailbeat.results import BeatEvent

if TYPE_CHECKING:
    from tailbeat.camera.tank.calibration import Calibration

Floats = NDArray[np.float64]

CRUISE_M_S = 0.08
STOP_S = 0.5  # before the tail rests: picture, radio, and thrust that is under way
KAPPA_PER_M = 10.0
TOUCH_M_S = 0.01  # what comes slower than this does no harm
NOSE_M = 0.20  # from the marker's centre to the tip of the head of a 36 cm fish
LENGTH_M = 0.36
HIT = "wall:"

_WINDOW_S = 1.0  # or the nearest number of whole beats
_WINDOW_MIN_S = 0.5
_WHOLE = 0.9  # of the window, from which on the body's sway can be told from a speed
_FRAMES_MIN = 6
_SWIM_MAX_M_S = 0.5  # the nose, too, which sways at 0.25 m/s
_JUMP_M = 0.05
_AGREEING = 3
_UNSEEN_S = 1.0
_BLIND_S = 2.0


def glide_m(speed_m_s: float, kappa_per_m: float) -> float:
    """How far a fish goes on after its last thrust until it does no harm any more: drag takes the
    speed down by exp(-kappa * way)."""
    return max(math.log(max(speed_m_s, TOUCH_M_S) / TOUCH_M_S) / kappa_per_m, 0.0)


def stopping_m(speed_m_s: float, kappa_per_m: float) -> float:
    """How far it comes from the picture that shows it."""
    return STOP_S * max(speed_m_s, 0.0) + glide_m(speed_m_s, kappa_per_m)


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
    gone (CameraGone), or has never seen the fish within 2 s, is a reason of its own. Afresh begins
    anew.
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
        self._doubted: list[Frame] = []
        self._velocity = np.zeros(2)
        self._reference_m_s = 0.0  # of the last beat
        self._since_s = math.nan  # the first moment there is word of
        self._reckoned_s = 0.0  # how far in time, and where to since it was seen
        self._ahead_m = np.zeros(2)

    def __call__(self, what: object) -> str | None:
        """The reason to abort, starting with HIT when it is a wall, or None. ``what``: a Frame,
        Unseen, a BeatEvent, Afresh, CameraGone; all else is ignored."""
        if self._walls is None:
            return None
        if isinstance(what, Frame):
            return self._look(what)
        if isinstance(what, Unseen):
            return self._reckon(what.t_s)
        if isinstance(what, BeatEvent):
            self._reference_m_s = what.reference_m_s
        if isinstance(what, Afresh):
            self._begin()
        if isinstance(what, CameraGone):
            return "the camera that guards the walls is gone"
        return None

    def _look(self, frame: Frame) -> str | None:
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
        if seen and not self._within_reach(seen[-1], frame):
            if self._doubted and not self._within_reach(self._doubted[-1], frame):
                self._doubted.clear()
            self._doubted.append(frame)
            if len(self._doubted) < _AGREEING:
                return False
            seen.clear()
            seen.extend(self._doubted[:-1])
        self._doubted.clear()
        seen.append(frame)
        while frame.t_s - seen[0].t_s > self._window_s * 1.001:
            seen.popleft()
        return True

    def _within_reach(self, before: Frame, after: Frame) -> bool:
        """Also by the ends: a marker that is read back to front stays where it is."""
        moved = np.abs(self._place(after) - self._place(before)).max()
        return bool(moved <= _SWIM_MAX_M_S * (after.t_s - before.t_s) + _JUMP_M)

    def _fitted(self) -> Floats:
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
        velocity: Floats = (t @ xy @ along) / (t @ t) * along
        gaps_s = np.diff(t)
        whole = span_s >= _WHOLE * self._window_s and gaps_s.max() <= self._beat_s / 4
        if whole and len(t) >= _FRAMES_MIN:
            across = np.array([-along[1], along[0]])
            velocity += _beside_sway(t, xy @ across, self._beat_s) * across
        return velocity

    def _reckon(self, now_s: float) -> str | None:
        """Where a fish that is not seen has come to."""
        if not math.isfinite(now_s):
            return None
        if not self._seen:
            self._since_s = now_s if math.isnan(self._since_s) else self._since_s
            blind = now_s - self._since_s > _BLIND_S
            return "the camera that guards the walls does not see the fish" if blind else None
        last = self._seen[-1]
        if now_s <= self._reckoned_s:
            return None
        long_ago = now_s - last.t_s > _UNSEEN_S
        velocity = self._supposed(last) if long_ago else self._velocity
        self._ahead_m = self._ahead_m + velocity * (now_s - self._reckoned_s)
        self._reckoned_s = now_s
        how = ", not seen any more" if long_ago else ""
        return self._judge(self._place(last) + self._ahead_m, velocity, how)

    def _supposed(self, last: Frame) -> Floats:
        """Velocity of a fish that nobody sees."""
        speed = float(np.hypot(*self._velocity))
        along = np.array([math.cos(last.heading_rad), math.sin(last.heading_rad)])
        if speed > 2 * TOUCH_M_S:
            along = self._velocity / speed
        supposed: Floats = max(speed, self._reference_m_s) * along
        return supposed

    def _place(self, frame: Frame) -> Floats:
        """Nose and end of the tail, (2, 2)."""
        along = np.array([math.cos(frame.heading_rad), math.sin(frame.heading_rad)])
        place: Floats = np.array([frame.x_m, frame.y_m]) + self._ends_m[:, None] * along
        return place

    def _zone_m(self, towards_m_s: Floats) -> Floats:
        """How near is too near, for each wall."""
        if self._zone_s is not None:
            return self._zone_s * towards_m_s
        return np.array([stopping_m(float(v), self._kappa_per_m) for v in towards_m_s])

    def _judge(self, place: Floats, velocity: Floats, how: str) -> str | None:
        assert self._walls is not None
        inward, offset = self._walls
        left_m = (place @ inward.T - offset).min(axis=0)
        towards_m_s = -(inward @ velocity)
        near = (towards_m_s >= TOUCH_M_S) & (left_m < self._zone_m(towards_m_s))
        if not near.any():
            return None
        worst = int(np.argmin(np.where(near, left_m, np.inf)))
        return f"{HIT} {max(left_m[worst], 0):.2f} m away at {towards_m_s[worst]:.3f} m/s{how}"


def _beside_sway(t_s: Floats, y_m: Floats, beat_s: float) -> float:
    """Slope of a line, were it not for an oscillation of one period per beat: a line alone, over
    one beat, would take up to 6/pi of its amplitude for a way."""
    phase = math.tau * t_s / beat_s
    terms = np.stack([t_s, np.ones_like(t_s), np.sin(phase), np.cos(phase)], axis=1)
    return float(np.linalg.lstsq(terms, y_m, rcond=None)[0][0])


def _inward(corners: Floats) -> tuple[Floats, Floats]:
    """Of each edge the unit vector into the area, (n, 2), and ``offset``: a point p is
    inward @ p - offset away from it, inside positive."""
    along = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    offset = (inward * corners).sum(axis=1)
    if (corners.mean(axis=0) @ inward.T < offset).any():
        inward, offset = -inward, -offset
    return inward, offset
