"""The heat equation on a rod, chapters 6 and 7: driven at one end, measured at the other.

w_t = w_xx + f(x, t) on x in [0, 1], t in min, w = 0 at first. Heat flows in at both ends as the
chapter has it. The rod is linear and does not change in time, so that its output is what it does
undriven plus the input convolved with one response: both are computed once.

Trial after trial on the plants of chapters 6 and 7, with the laws of host/native/thesis/learner.h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
from scipy.signal import fftconvolve

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.example import ExampleOptions
from tailbeat.studies.thesis.learner import LearnerConfig, load, pointer
from tailbeat.studies.thesis.options import Span, last_iteration
from tailbeat.studies.thesis.series import LearningProblem

Scheme = Literal["backward-euler", "crank-nicolson", "modal"]

HORIZON = 10.0  # min, T of both chapters
STEP = 0.01  # min
CELLS = 100
TRIAL = Span(HORIZON, "min", steps_max=20_000, budget=100_000_000)
_MODES = 400  # of the modal solution; 100 to 800 agree to 5 digits


@dataclass(frozen=True)
class Rod:
    """What is driven, measured and heated.

    ``driven_end``, ``measured_end``: 0 or 1, an end of [0, 1]. ``sign``: of the input as heat that
    flows in: +1 for w_x(1) = u, -1 for w_x(0) = u. ``source``: f(x, t) = (a + b*x + c*x**2) + t*(d
    + e*x) as (a, b, c, d, e). ``inflow``: heat at x = 1 beside the input, g of (7.1).
    """

    driven_end: Literal[0, 1]
    measured_end: Literal[0, 1]
    sign: Literal[-1, 1]
    source: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    inflow: float = 0.0


CHAPTER6 = Rod(1, 0, 1, source=(0.0, 0.0, 1.0, 0.0, 2.0))
"""(6.35): f = 2*x*t + x**2, K0*w_x(1) = u, y = w(0)."""

CHAPTER7 = Rod(0, 1, -1, inflow=1.0)
"""(7.3) with F = 0: v_x(0) = u, v_x(1) = g = 1, y = v(1)."""


def times(step: float) -> F64:
    """k * step for k = 0 .. T / step.

    Raises:
        InputError: as ``Span.steps``.
    """
    return np.arange(TRIAL.steps(step) + 1, dtype=np.float64) * step


def reference(time: F64) -> F64:
    """y^d of both chapters: t^3 * (10 - t)^3 / 1000, at most 15.625."""
    values: F64 = time**3 * (HORIZON - time) ** 3 / 1000
    return values


class HeatPlant:
    """A rod, sampled. The input is one value per sample: held over the step that ends with it in
    backward Euler, a straight line from sample to sample in the other two.

    ``scheme``: ``backward-euler`` and ``crank-nicolson`` are the method of lines on ``cells`` equal
    cells, with half a cell of heat at either end and the source at the middles of the cells;
    ``modal`` is the exact solution as a sum of cosines. ``substeps``: of the method of lines within
    a sample, along the straight line.
    """

    def __init__(
        self,
        rod: Rod,
        step: float = STEP,
        scheme: Scheme = "backward-euler",
        cells: int = CELLS,
        substeps: int = 1,
    ):
        self.time = times(step)
        modal = scheme == "modal"
        self._line = None if modal else _Line(rod, self.time, scheme, cells, substeps)
        if self._line is None:
            self._free, self._first, self._second = _modal(rod, self.time)
            return
        still, first, second = np.zeros((3, len(self.time)))
        first[0] = second[1] = 1.0
        at = -rod.measured_end
        self._free = self._line.march(still, heated=True)[:, at]
        self._first = self._line.march(first, heated=False)[:, at]
        self._second = self._line.march(second, heated=False)[:, at]

    def output(self, values: F64) -> F64:
        """y of a trial, a new array."""
        out: F64 = self._free + values[0] * self._first
        out[1:] += fftconvolve(values[1:], self._second[1:])[: len(out) - 1]
        return out

    def field(self, values: F64) -> F64:
        """w of a trial, one row per sample, one column per node.

        Raises:
            ValueError: of a modal plant, which has no nodes.
        """
        if self._line is None:
            raise ValueError("the modal solution has no nodes")
        return self._line.march(values, heated=True)


@lru_cache(maxsize=8)
def heat_plant(rod: Rod, step: float = STEP, scheme: Scheme = "backward-euler") -> HeatPlant:
    """A plant of 100 cells, made once; it keeps nothing of a trial."""
    return HeatPlant(rod, step, scheme)


class _Line:
    """The method of lines: C dw/dt = L w + load."""

    def __init__(self, rod: Rod, time: F64, scheme: Scheme, cells: int, substeps: int):
        h = 1.0 / cells
        self._substeps, self._step = substeps, (time[1] - time[0]) / substeps
        self._implicit = 1.0 if scheme == "backward-euler" else 0.5
        heat = np.full(cells + 1, h)
        heat[[0, -1]] = h / 2
        flow = (np.eye(cells + 1, k=1) + np.eye(cells + 1, k=-1) - 2 * np.eye(cells + 1)) / h
        flow[0, 0] = flow[-1, -1] = -1 / h
        inverse = np.linalg.inv(np.diag(heat / self._step) - self._implicit * flow)
        self._kept = inverse @ (np.diag(heat / self._step) + (1 - self._implicit) * flow)
        self._driven = rod.sign * inverse[:, -rod.driven_end]
        middle = (np.arange(cells, dtype=np.float64) + 0.5) * h
        a, b, c, d, e = rod.source
        self._load = inverse @ (_to_nodes(a + b * middle + c * middle**2, h))
        self._load += rod.inflow * inverse[:, -1]
        self._load_by_t = inverse @ _to_nodes(d + e * middle, h)

    def march(self, values: F64, heated: bool) -> F64:
        """All nodes at all samples; ``heated``: by source and inflow, not only by the input."""
        inside = np.arange((len(values) - 1) * self._substeps + 1) / self._substeps
        fine = np.interp(inside, np.arange(len(values)), values)
        drive = self._implicit * fine[1:] + (1 - self._implicit) * fine[:-1]
        out = np.zeros((len(fine), len(self._load)))
        w = out[0]
        for k, driven in enumerate(drive):
            w = self._kept @ w + driven * self._driven
            if heated:
                w += self._load + self._step * (k + self._implicit) * self._load_by_t
            out[k + 1] = w
        return out[:: self._substeps]


def _to_nodes(middles: F64, h: float) -> F64:
    """What the middles of cells give to the nodes: half to either side."""
    out = np.zeros(len(middles) + 1)
    out[:-1] += h / 2 * middles
    out[1:] += h / 2 * middles
    return out


def _modal(rod: Rod, time: F64) -> tuple[F64, F64, F64]:
    """(undriven output, response to a unit at sample 0 alone, at sample 1 alone) of the exact
    solution with straight lines between the samples."""
    n = np.arange(1, _MODES + 1, dtype=np.float64)
    rate = (n * np.pi) ** 2
    shape = {0: np.ones(_MODES), 1: np.cos(n * np.pi)}
    gain = 2 * rod.sign * shape[rod.driven_end] * shape[rod.measured_end]
    step = time[1] - time[0]
    rise, fall = _ramp(rate, step)
    decay = np.exp(-rate * step)
    ahead = np.arange(len(time) - 1)
    powers = np.exp(-rate * step * ahead[:, None])
    first, second = np.zeros(len(time)), np.zeros(len(time))
    first[1:] = rod.sign * step / 2 + powers @ (gain * fall)
    second[1] = rod.sign * step / 2 + gain @ rise
    second[2:] = rod.sign * step + powers[:-1] @ (gain * (decay * rise + fall))
    return _undriven(rod, rate, shape, time), first, second


def _ramp(rate: F64, step: float) -> tuple[F64, F64]:
    """What an input that rises from 0 to 1 within a step leaves of each mode, and one that falls
    from 1 to 0."""
    z = rate * step
    gone = -np.expm1(-z)
    rise = step * (1 / z - gone / z**2)
    return rise, step * gone / z - rise


def _undriven(rod: Rod, rate: F64, shape: dict[int, F64], time: F64) -> F64:
    """The output that source and inflow give; the inflow's at x = 1 in closed form, as its modes
    converge slowly there."""
    a, b, c, d, e = rod.source
    by_x = (shape[1] - 1) / rate  # the integral of x * cos(n pi x)
    by_x2 = 2 * shape[1] / rate
    weights = 2 * shape[rod.measured_end]
    still = weights * (b * by_x + c * by_x2)
    growing = weights * e * by_x
    late = np.exp(-rate * time[:, None])
    gone = -np.expm1(-rate * time[:, None])
    out: F64 = (a + b / 2 + c / 3) * time + (d + e / 2) * time**2 / 2
    out += gone @ (still / rate - growing / rate**2) + time * np.sum(growing / rate)
    inflow = 2 * shape[rod.measured_end] * shape[1] / rate
    at_rest = 1 / 3 if rod.measured_end == 1 else -1 / 6  # the modes' sum for ever
    came = np.where(time > 0, time + at_rest - late @ inflow, 0.0)
    return out + rod.inflow * came


def undriven_as_printed(time: float) -> float:
    """y^0 of chapter 6 by (6.39) as printed, with sinh for cosh in the source's kernel:
    Talbot's inversion of its Laplace transform, on Weideman's cotangent contour."""
    terms = 24
    angle = np.pi * (2 * np.arange(terms) + 1) / terms - np.pi
    cot = 1 / np.tan(0.6407 * angle)
    s = terms / time * (0.5017 * angle * cot - 0.6122 + 0.2645j * angle)
    along = 0.5017 * (cot - 0.6407 * angle * (1 + cot**2)) + 0.2645j
    r = np.sqrt(s)
    of_x = np.sinh(r) / r**2 - 1 / r  # the integral of x * sinh(r * (1 - x))
    of_x2 = 2 * (np.cosh(r) - 1) / r**3 - 1 / r
    transform = (2 * of_x / s**2 + of_x2 / s) / (r * np.sinh(r))
    return float(np.real(np.sum(transform * np.exp(s * time) * along) / (1j * time)))


class SampledPlant(Protocol):
    """From rest, one trial after the other; nothing is carried over. NaN from where it cannot be
    computed any more."""

    @property
    def time(self) -> F64: ...

    def output(self, values: F64) -> F64: ...


def window(minutes: float, step: float) -> int:
    """N0 of (6.42) for a window of ``minutes``: it is the window that is kept when the step is
    another, as samples have no meaning of their own."""
    return max(1, round(minutes / step))


def lead_samples(minutes: float, step: float) -> float:
    """A lead in samples, whole or half.

    Raises:
        InputError: when it is negative, not a multiple of half a step, or longer than the trial.
    """
    halves = round(2 * minutes / step) if np.isfinite(minutes) and minutes >= 0 else -1
    if halves > 2 * round(HORIZON / step):
        raise InputError(
            f"a lead of {minutes:g} min is longer than the trial.",
            f"Give at most {HORIZON:g} min.",
        )
    if halves < 0 or abs(halves * step / 2 - minutes) > 1e-9 * max(1.0, minutes):
        raise InputError(
            f"a lead of {minutes:g} min is no multiple of half a step of {step:g} min.",
            f"Give one like {max(1, halves) * step / 2:g}, or another --step.",
        )
    return halves / 2


def step_and_last(options: ExampleOptions, usual: int) -> tuple[float, int]:
    """Step and last iteration of the options; ``usual`` where they say nothing of the latter.

    Raises:
        InputError: when they make no sense, or take too long together.
    """
    step = STEP if options.step is None else options.step
    last = last_iteration(options.iterations, usual)
    TRIAL.afford(TRIAL.steps(step), last)
    return step, last


def problem(
    plant: SampledPlant, law: LearnerConfig, taught: Callable[[F64], F64] | None = None
) -> LearningProblem:
    """The reference of both chapters on a plant. ``taught``: as of ``LearningProblem``."""

    def respond(inputs: F64, iteration: int) -> F64:
        return np.stack([plant.output(one) for one in inputs])

    return LearningProblem(plant.time, reference(plant.time), respond, law, taught=taught)


def zero_phase(values: F64, q_len: int) -> F64:
    """Q of (6.42) by law_zero_phase, renormalised at the ends; a new array."""
    native = load("double")
    given = np.ascontiguousarray(values, dtype=np.float64)
    out = np.empty_like(given)
    native.lib.law_zero_phase(pointer(native, given), pointer(native, out), len(given), q_len)
    return out


def slope(values: F64, step: float = STEP) -> F64:
    """The law's derivative: the forward difference, the last one repeated."""
    differences = np.diff(values) / step
    return np.append(differences, differences[-1])
