"""Speed from positions: a line fitted over one beat, which takes the tail's own ripple out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

LOST_IN_A_ROW_MAX = 5
COVERAGE_MIN = 0.6
_SPAN_SLACK_FRAMES = 0.6
_SIGMA_MIN_M_S = 1e-5
_PLAUSIBLE_M_S = 1.0
_JUMP_M = 0.01  # ten times the noise of a good camera


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """Mean speed over a window of one beat whose middle is ``t_s``; ``sigma_m_s`` > 0."""

    t_s: float
    speed_m_s: float
    sigma_m_s: float


class BeatFit:
    """Feed it positions; it gives a speed for every frame that closes a whole beat.

    The window is one beat long by the frames' time stamps, both ends included (26 frames at
    25 frames/s), within 0.6 of a frame. Nothing comes out of a window with more than 5 frames
    missing in a row or with fewer than 60 % of its frames; a jump no fish can swim (somebody
    carried it back) begins a new window. With ``position_noise_m`` the standard
    deviation follows from it, otherwise from the scatter about the line.
    """

    def __init__(
        self, beat_s: float = 1.0, fps: float = 25.0, position_noise_m: float | None = None
    ) -> None:
        self._beat_s = beat_s
        self._frame_s = 1.0 / fps
        self._noise_m = position_noise_m
        self._frames_min = max(3, math.ceil(COVERAGE_MIN * (round(beat_s * fps) + 1)))
        self._window: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Forgets all positions."""
        self._window.clear()

    def add(self, t_s: float, x_m: float) -> SpeedSample | None:
        """Takes one position; frames that are not newer than the last are dropped."""
        window = self._window
        if not (math.isfinite(t_s) and math.isfinite(x_m)):
            return None
        if window and t_s <= window[-1][0]:
            return None
        if window and abs(x_m - window[-1][1]) > _PLAUSIBLE_M_S * (t_s - window[-1][0]) + _JUMP_M:
            window.clear()
        window.append((t_s, x_m))
        slack_s = _SPAN_SLACK_FRAMES * self._frame_s
        while t_s - window[0][0] > self._beat_s + slack_s:
            window.popleft()
        if len(window) < self._frames_min or t_s - window[0][0] < self._beat_s - slack_s:
            return None
        return self._fit()

    def _fit(self) -> SpeedSample | None:
        """Least squares about the middle; sums of about 26 terms are cheaper than keeping them."""
        window = self._window
        count = len(window)
        begin_s, x0 = window[0]
        gap_max_s = (LOST_IN_A_ROW_MAX + 1.5) * self._frame_s
        st = sx = stt = stx = sxx = last = 0.0
        for t_s, x_m in window:
            t = t_s - begin_s
            x = x_m - x0
            if t - last > gap_max_s:
                return None
            last = t
            st += t
            sx += x
            stt += t * t
            stx += t * x
            sxx += x * x
        vtt = stt - st * st / count
        vtx = stx - st * sx / count
        speed = vtx / vtt
        if self._noise_m is None:
            scatter = max(0.0, sxx - sx * sx / count - speed * vtx)
            variance = scatter / (count - 2)
        else:
            variance = self._noise_m**2
        sigma = max(math.sqrt(variance / vtt), _SIGMA_MIN_M_S)
        return SpeedSample(begin_s + last / 2, speed, sigma)
