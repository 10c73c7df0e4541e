"""Tracks with the LED in their patches, made without pictures: what a bad camera leaves of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.native import lib
from tailbeat.sensors.camera.tracking.track import LOST, SEEN, Track
from tailbeat.sensors.camera.tracking.tracker import PATCH_SHAPE

Floats = F64

FRAME_S = 0.02
_SAMPLES = 40  # of an exposure


@dataclass(frozen=True)
class LedFilm:
    """``hidden``: part of the pictures in which the LED is covered; ``hidden_s`` long each time.
    ``before_s`` and ``after_s`` of the trial; negative: the film begins or ends in mid-swim.
    ``blink_s``: length of a countdown before it, until ``steady_s`` before it."""

    number: int = 7
    fps: float = 25.0
    swim_s: float = 40.0
    before_s: float = 3.0
    after_s: float = 4.0
    lost: float = 0.1
    hidden: float = 0.5
    hidden_s: float = 0.0
    glare: float = 0.15
    led: bool = True
    saturation: float = 1.0
    blink_s: float = 0.0
    steady_s: float = 0.3
    jitter_s: float = 0.0  # of the time stamps' distances; the stamps are true

    def make(self, seed: int) -> tuple[Track, float]:
        """The track and the true begin of the trial."""
        rng = np.random.default_rng(seed)
        exposure_s = rng.uniform(0.002, 0.9 / self.fps)
        start_s = self.before_s + rng.uniform(0, 0.5)
        count = int((self.before_s + self.swim_s + self.after_s) * self.fps)
        t_s = np.arange(count) / self.fps
        t_s += rng.uniform(-0.5, 0.5, count) * self.jitter_s
        patch = self._water(rng, t_s - start_s)
        if self.led:
            self._shine(rng, patch, self._lit(t_s - start_s, exposure_s))
        seen = rng.random(count) >= self.lost
        levels = np.clip(patch, 0, 255).astype(np.uint8)
        levels[~seen] = 0
        state = np.where(seen, SEEN, LOST).astype(np.uint8)
        where = np.where(seen, 0.0, np.nan)
        return (
            Track(t_s, where, where, where, seen * 1.0, state, self.fps, "film.mp4", levels),
            start_s,
        )

    def _lit(self, since_s: Floats, exposure_s: float) -> Floats:
        """By the firmware's own function, at many moments of each exposure."""
        frames = round(self.swim_s / FRAME_S)
        code = np.array([lib.blink_on(i, self.number) for i in range(frames)], dtype=float)
        lit = np.zeros(len(since_s))
        for k in range(_SAMPLES):
            moment = since_s + exposure_s * ((k + 0.5) / _SAMPLES - 0.5)
            frame = np.clip((moment / FRAME_S).astype(int), 0, frames - 1)
            trials = np.where(moment < self.swim_s, code[frame], 0.0)
            lit += np.where(moment < 0, self._before(moment), trials) / _SAMPLES  # idle after
        return np.minimum(1.0, lit * self.saturation)

    def _before(self, moment: Floats) -> Floats:
        """Armed, blinking for a while; dark before that when there was a countdown."""
        left_s = -moment - self.steady_s
        blinks = (left_s // 0.2 % 2 == 0) & (left_s < self.blink_s)
        lit = (left_s < 0) | (self.blink_s == 0) | blinks
        return lit.astype(float)

    def _water(self, rng: np.random.Generator, since_s: Floats) -> Floats:
        """Body texture, the tail's shade at once and twice the beat, flashes of glare."""
        rows, columns = PATCH_SHAPE
        patch = rng.uniform(20, 90, (rows, columns)) + rng.normal(
            0, 4, (len(since_s), rows, columns)
        )
        for column in range(8):
            phase = 2 * np.pi * since_s + 0.3 * column
            patch[:, 4:8, column] += 60 * rng.uniform(0.3, 1) * np.abs(np.sin(phase))[:, None]
            patch[:, 2:6, column + 8] += 40 * (np.sin(phase) > 0)[:, None]
        for i in np.flatnonzero(rng.random(len(since_s)) < self.glare):
            row, column = int(rng.integers(0, rows)), int(rng.integers(0, columns))
            spot = np.s_[i, max(0, row - 2) : row + 3, max(0, column - 2) : column + 3]
            patch[spot] += rng.uniform(50, 150)
        return patch

    def _shine(self, rng: np.random.Generator, patch: Floats, lit: Floats) -> None:
        """At a corner of four cells, now in one and now in the next."""
        count = len(lit)
        runs = max(1, round(self.hidden_s * self.fps))
        covered = np.repeat(rng.random(count // runs + 1) < self.hidden, runs)[:count]
        row = rng.integers(3, 9) + rng.integers(0, 2, count)
        column = rng.integers(18, 36) + rng.integers(0, 2, count)
        level = rng.uniform(60, 160)
        patch[np.arange(count), row, column] += np.where(covered, 0.0, level * lit)
