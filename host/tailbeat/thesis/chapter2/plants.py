"""The plants of chapter 2: linear, in discrete time, one input and one output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.thesis.arrays import Doubles

LAST = 50  # T_d, samples
TIMES: NDArray[np.int64] = np.arange(LAST + 1)
# Both examples want the same. Its printed third term, sin(50 pi t), is 0 at whole t.
WANTED: Doubles = np.sin(2 * np.pi * TIMES / 50) + np.sin(2 * np.pi * TIMES / 5)


@dataclass(frozen=True)
class LinearPlant:
    """(2.1), (2.31): x(t+1) = A(t) x(t) + B u(t), y = C x. ``a``: (samples, states, states)."""

    a: Doubles
    b: Doubles
    c: Doubles

    def respond(self, inputs: Doubles, start: Doubles | None = None) -> Doubles:
        """Outputs of inputs (series, samples) from the states ``start`` (series, states), or 0."""
        state = np.zeros((len(inputs), len(self.b))) if start is None else start
        outputs = np.empty_like(inputs)
        for t, a in enumerate(self.a):
            outputs[:, t] = state @ self.c
            state = state @ a.T + inputs[:, t, np.newaxis] * self.b
        return outputs

    @property
    def first_markov(self) -> float:
        """CB: what an input does to the next output."""
        return float(self.c @ self.b)

    def wanted_input(self, wanted: Doubles) -> Doubles:
        """u_d: the input that follows ``wanted`` exactly from the state 0; one sample less."""
        state = np.zeros(len(self.b))
        found = np.empty(len(wanted) - 1)
        for t in range(len(found)):
            free = self.a[t] @ state
            found[t] = (wanted[t + 1] - self.c @ free) / self.first_markov
            state = free + self.b * found[t]
        return found


def example1() -> LinearPlant:
    """Example 1: CB = 1, zeros at 0.5 and 0.3."""
    a = np.array([[0.5, 0.0, 1.0], [0.15, 0.3, 0.0], [-0.75, 0.25, -0.25]])
    third = np.array([0.0, 0.0, 1.0])
    return LinearPlant(np.broadcast_to(a, (len(TIMES), 3, 3)), third, third)


def example2() -> LinearPlant:
    """(2.37), as printed: CB = 0.1. Its inverse is unstable, frozen zeros up to -11.7."""
    a = np.zeros((len(TIMES), 3, 3))
    a[:, 0, 0], a[:, 0, 1] = 0.2 * np.exp(-TIMES / 100), -0.6
    a[:, 1, 1], a[:, 1, 2] = 0.5, np.sin(TIMES)
    a[:, 2, 2] = 0.7
    return LinearPlant(a, np.array([1.3, 0.5, 0.6]), np.array([-0.5, 1.5, 0.0]))


def example2_substitute() -> LinearPlant:
    """A and B of (2.37), its third state as the output: CB = 0.6, and a stable inverse."""
    printed = example2()
    return LinearPlant(printed.a, printed.b, np.array([0.0, 0.0, 1.0]))
