"""Whether water and fish are still: a fish that drifts at 2 mm/s brings 2 mm/s into every beat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.session.preflight.step import Drift, Wanted

if TYPE_CHECKING:
    from tailbeat.core.frames import Frame
    from tailbeat.session.preflight.pose import Feel, Sight
    from tailbeat.session.preflight.step import Step


_TOLD_FROM_S = 2.0  # over less a camera's noise of 1 mm is more than what is looked for
_BLOCKS = 10
_FRAMES_MIN = 12
_FELT_LOOK_S = 0.5
_REMEDY = (
    "Switch off pumps, let the water calm down, let go of the fish only when it lies still;"
    " then begin again."
)


def wait_until_still(
    step: Step, wanted: Wanted, sight: Sight | None, feel: Feel | None
) -> Drift | None:
    """Waits until it has been still for ``still_s``. None when nothing can tell, or nobody asked.
    Raises NotReady and what the step and the camera raise."""
    if wanted.still_s <= 0:
        return None
    if sight is not None:
        return _watch(step, wanted, sight)
    if feel is not None:
        return _feel(step, wanted, feel)
    step.notice("nobody knows whether water and fish are still: there is no camera and no IMU")
    return None


def _watch(step: Step, wanted: Wanted, sight: Sight) -> Drift:
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


def _passes(drift: Drift, wanted: Wanted) -> bool:
    return drift.speed_m_s + drift.sigma_m_s < wanted.drift_max_m_s


def drift_now(sight: Sight, still_s: float) -> Drift | None:
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


def _how_it_moves(sight: Sight, drift: Drift | None, wanted: Wanted) -> str:
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


def _feel(step: Step, wanted: Wanted, feel: Feel) -> Drift:
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
