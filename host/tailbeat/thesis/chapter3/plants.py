"""The plants of chapter 3: one state, in continuous time, the input held over each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tailbeat.thesis.arrays import Doubles

Rate = Callable[[Doubles, Doubles], Doubles]
"""(state, input) -> time derivative of the state."""
Method = Literal["euler", "rk4"]

FISH_DRAG = 31.2485  # alpha = mu/M, 1/m


@dataclass(frozen=True)
class HeldPlant:
    """x' = rate(x, u), y = x, x(0) = 0."""

    rate: Rate
    step: float
    method: Method

    def respond(self, inputs: Doubles) -> Doubles:
        """Outputs of inputs (series, samples). An input acts from its own sample on, so that the
        last one moves nothing."""
        advance = self._rk4 if self.method == "rk4" else self._euler
        state = np.zeros(len(inputs))
        outputs = np.empty_like(inputs)
        for k in range(inputs.shape[1]):
            outputs[:, k] = state
            state = advance(state, inputs[:, k])
        return outputs

    def _euler(self, state: Doubles, held: Doubles) -> Doubles:
        return state + self.step * self.rate(state, held)

    def _rk4(self, state: Doubles, held: Doubles) -> Doubles:
        half = 0.5 * self.step
        k1 = self.rate(state, held)
        k2 = self.rate(state + half * k1, held)
        k3 = self.rate(state + half * k2, held)
        k4 = self.rate(state + self.step * k3, held)
        return state + self.step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def example1_rate(x: Doubles, u: Doubles) -> Doubles:
    """Example 1; the input's slope 1 + cos(u)/2 lies in [0.5, 1.5]."""
    return 0.5 * np.cos(x) + u + 0.5 * np.sin(u)


def example1_wanted(t: Doubles) -> Doubles:
    return np.sin(2 * np.pi * t) + np.sin(2 * np.pi * t / 5) + np.sin(5 * np.pi * t)


def fish_rate(v: Doubles, u: Doubles) -> Doubles:
    """The fish, with a drag that brakes in either direction."""
    return u - FISH_DRAG * v * np.abs(v)


def fish_rate_printed(v: Doubles, u: Doubles) -> Doubles:
    """As printed: the drag of a fish that swims backwards accelerates it, and v escapes."""
    return u - FISH_DRAG * v * v


def fish_wanted(t: Doubles) -> Doubles:
    """m/s; 0.06 at its peak, 25 s."""
    return 48.0 / 50.0**5 * t**2 * (t - 50.0) ** 2


def fish_wanted_input(t: Doubles) -> Doubles:
    """u_d, m/s^2: negative where the wanted speed falls faster than drag alone would let it."""
    slope = 48.0 / 50.0**5 * (2.0 * t * (t - 50.0) ** 2 + 2.0 * t**2 * (t - 50.0))
    return slope + FISH_DRAG * fish_wanted(t) ** 2
