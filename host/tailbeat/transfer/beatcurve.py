"""A curve through means over beats, and its means over other beats.

Within a beat the curve is the parabola that has the beat's mean and the values at its two edges
(fourth order where neighbours allow it, as in the piecewise parabolic method, never beyond the
neighbouring means). What is between two instants is therefore kept: of a speed the distance, of a
thrust the impulse. The means over the curve's own beats come back bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BUMP = 3.0  # times the mean: an edge of more would make the parabola of a beat fall below 0


class BeatCurve:
    """``mean``: float64, shape (beats,). Instants are counted in beats of the curve: beat k is
    [k, k + 1]. Before 0 the curve is 0; beyond the end it stays at ``end``."""

    def __init__(self, mean: Array, end: float | None = None) -> None:
        self.mean = np.asarray(mean, dtype=np.float64)
        self.edge = _edges(self.mean)
        self.end = float(self.edge[-1]) if end is None else end

    def at(self, instant: Array) -> Array:
        """The curve's value at instants of any shape."""
        k = np.clip(np.floor(instant).astype(int), 0, len(self.mean) - 1)
        x = np.clip(instant - k, 0.0, 1.0)
        left, right, mean = self.edge[k], self.edge[k + 1], self.mean[k]
        inside = left + (right - left) * x + 3 * (2 * mean - left - right) * x * (1 - x)
        late = np.where(instant > len(self.mean), self.end, inside)
        return np.asarray(np.where(instant < 0, 0.0, late))

    def means(self, instant: Array) -> Array:
        """Means between neighbours of rising instants, shape (n,) to (n - 1,)."""
        begin, end = instant[:-1, None], instant[1:, None]
        beat = np.arange(len(self.mean), dtype=np.float64)
        area = self._within(np.clip(end - beat, 0, 1)) - self._within(np.clip(begin - beat, 0, 1))
        last = len(self.mean)
        late = np.maximum(end[:, 0] - last, 0.0) - np.maximum(begin[:, 0] - last, 0.0)
        return np.asarray((area.sum(axis=1) + late * self.end) / np.diff(instant))

    def _within(self, x: Array) -> Array:
        """The integral over each beat from its begin to x of it; exactly its mean at 1."""
        left, right = self.edge[:-1], self.edge[1:]
        bend = self.mean * (3 * x**2 - 2 * x**3 - x)
        bend += left * (x**3 - 2 * x**2 + x) + right * (x**3 - x**2)
        return np.asarray(self.mean * x + bend)


def overlap(mean: Array, instant: Array) -> Array:
    """Means of a staircase: as ``BeatCurve.means``, with the last step going on for ever."""
    begin, end = instant[:-1, None], instant[1:, None]
    step = np.arange(len(mean), dtype=np.float64)
    upper = np.append(step[1:], np.inf)
    lower = np.append(-np.inf, step[1:])  # the first step holds before 0, too
    share = np.minimum(end, upper) - np.maximum(begin, lower)
    return np.asarray((np.maximum(share, 0.0) @ mean) / np.diff(instant))


def _edges(mean: Array) -> Array:
    """Values at the n + 1 edges of beats."""
    if len(mean) == 1:
        return np.repeat(mean, 2)
    inner = (mean[:-1] + mean[1:]) / 2
    if len(mean) > 3:
        inner[1:-1] = (7 * (mean[1:-2] + mean[2:-1]) - (mean[:-3] + mean[3:])) / 12
    inner = np.clip(inner, np.minimum(mean[:-1], mean[1:]), np.maximum(mean[:-1], mean[1:]))
    first = 1.5 * mean[0] - 0.5 * mean[1]
    last = 1.5 * mean[-1] - 0.5 * mean[-2]
    edge = np.concatenate([[first], inner, [last]])
    if np.all(mean >= 0):
        most = _BUMP * np.minimum(np.append(mean[0], mean), np.append(mean, mean[-1]))
        edge = np.clip(edge, 0.0, most)
    return edge
