"""Chapter 6 in the frequency domain: the rod of (6.35), its approximations, and the gains that
follow from them. Frequencies in rad/min.

Chapter 6's law on chapter 6's rod, with the thesis's numbers (section 6.6) and others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize_scalar

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import ExampleOptions, Prepared
from tailbeat.studies.thesis.learner import LearnerConfig
from tailbeat.studies.thesis.plants.heat import (
    CHAPTER6,
    STEP,
    heat_plant,
    problem,
    slope,
    step_and_last,
    times,
    window,
    zero_phase,
)
from tailbeat.studies.thesis.series import LearningProblem, prepared

Complexes = NDArray[np.complex128]
Gain = Callable[[F64], Complexes]

BAND = (0.0, 10.0)  # Omega of section 6.6
PRINTED_OVER = (14.14, -7.07, 1.414, -2.475, 0.707, -1.414)
PRINTED_UNDER = (1.0, 0.5, 0.1, 0.175, 0.05, 0.1)
"""A(z) of section 6.6, rising powers of z^-1, rounded to four digits as there."""


def _band(frequency: ArrayLike) -> F64:
    """With 0 replaced by something next to it, where all of these have their limit."""
    w = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    return np.where(w == 0, 1e-9, w)


def rod(frequency: ArrayLike) -> Complexes:
    """s * h12(0, s) on s = jw, exactly: sqrt(s) / sinh(sqrt(s)). With the law's rho * s it is the
    whole loop, and 1 - rho * rod what a trial leaves of an error."""
    root = np.sqrt(1j * _band(frequency))
    return np.asarray(root / np.sinh(root))


def along(x: float, s: complex) -> Complexes:
    """exp(F x) of (6.35), as it must be: what (w, w_x) at 0 makes of them at x, undisturbed."""
    root = np.sqrt(s)
    slope = np.sinh(root * x)
    return np.array([[np.cosh(root * x), slope / root], [root * slope, np.cosh(root * x)]])


def along_printed(x: float, s: complex) -> Complexes:
    """The same as printed, with sinh in place (2, 2)."""
    matrix = along(x, s)
    matrix[1, 1] = np.sinh(np.sqrt(s) * x)
    return matrix


Along = Callable[[float, complex], Complexes]
_LEFT = np.array([[0.0, 1.0], [0.0, 0.0]])  # M and N of lemma 6.1, K0 = 1
_RIGHT = np.array([[0.0, 0.0], [0.0, 1.0]])


def from_the_ends(x: float, s: complex, by: Along = along) -> Complexes:
    """H(x, s) of lemma 6.1: from w_x(0) and w_x(1) to (w, w_x) at x; the first column is h11, h21,
    the second h12, h22."""
    ends: Complexes = by(x, s) @ np.linalg.inv(_LEFT + _RIGHT @ by(1.0, s))
    return ends


def from_inside(x: float, at: float, s: complex, by: Along = along) -> Complexes:
    """G(x, xi, s) of lemma 6.1: from (0, 1) given at xi to (w, w_x) at x."""
    ends = from_the_ends(x, s, by)
    if at < x:
        return np.asarray(ends @ _LEFT @ by(-at, s))
    return np.asarray(-ends @ _RIGHT @ by(1.0 - at, s))


def off_at_the_ends(s: complex, by: Along = along) -> tuple[float, float]:
    """What h11 and h21 leave at the ends, where w_x(0) is given and the other end is insulated:
    abs(dh11/dx) at 1, and abs(h21 - 1) at 0."""
    apart = 1e-5
    near, end = (from_the_ends(x, s, by)[0, 0] for x in (1.0 - apart, 1.0))
    return float(abs(end - near) / apart), float(abs(from_the_ends(0.0, s, by)[1, 0] - 1))


def off_inside(s: complex, by: Along = along, at: float = 0.4) -> float:
    """What G leaves of a source at ``at``: the largest of abs(w_x) at both ends, which are
    insulated, and of abs(jump of w_x - 1) at the source."""
    apart = 1e-9
    ends = [abs(from_inside(x, at, s, by)[1, 1]) for x in (0.0, 1.0)]
    before, after = (from_inside(at + d, at, s, by)[1, 1] for d in (-apart, apart))
    return float(max(*ends, abs(after - before - 1)))


def widest_band(step: float) -> float:
    """Up to where Re(s * h12) is above 0 from 0 on: no gain meets (6.20) on a wider band."""
    omega = np.linspace(0.01, np.pi / step, 30_001)
    first = int(np.argmax(rod(omega).real <= 0))
    return float(brentq(lambda w: float(rod(w)[0].real), omega[first - 1], omega[first]))


def h12(x: float, frequency: ArrayLike) -> Complexes:
    """From the driven end x = 1 to w(x), K0 = 1."""
    root = np.sqrt(1j * _band(frequency))
    return np.asarray(np.cosh(root * x) / (root * np.sinh(root)))


def half_differentiator(
    frequency: ArrayLike, rounded: bool = True, step: float = 0.01
) -> Complexes:
    """A(z) of section 6.6 on the unit circle: sqrt(s) by Tustin's rule with Muir's recursion, its
    coefficients rounded as there, or not."""
    over, under = half_differentiator_coefficients()
    over = np.array(PRINTED_OVER) if rounded else np.sqrt(2 / step) * over
    under = np.array(PRINTED_UNDER) if rounded else under
    back = np.exp(-1j * _band(frequency) * step)
    return np.asarray(np.polyval(np.flip(over), back) / np.polyval(np.flip(under), back), complex)


def _muir(order: int, r: float) -> F64:
    """A_n(z^-1, r), rising powers of z^-1: A_n = A_{n-1} - c_n * z^-n * A_{n-1}(z), c_n = r / n for
    odd n and 0 else."""
    row = np.ones(1)
    for n in range(1, order + 1):
        row = np.append(row, 0.0)
        if n % 2:
            row = row - r / n * row[::-1]
    return row


def half_differentiator_coefficients(order: int = 5) -> tuple[F64, F64]:
    """Numerator and denominator of A(z) ahead of its gain, rising powers of z^-1."""
    return _muir(order, 0.5), _muir(order, -0.5)


def modelled(frequency: ArrayLike, rounded: bool = True) -> Complexes:
    """``rod`` as the thesis approximates it: A / sinh(A)."""
    root = half_differentiator(frequency, rounded)
    return np.asarray(root / np.sinh(root))


def modelled_unrounded(frequency: ArrayLike) -> Complexes:
    """The same before A(z) was rounded."""
    return modelled(frequency, rounded=False)


def moving_mean(frequency: ArrayLike, length: int, step: float) -> F64:
    """abs(H) of (6.42)."""
    half = _band(frequency) * step / 2
    return np.asarray(np.abs(np.sin(length * half) / (length * np.sin(half))))


def zero_phase_frequency(frequency: ArrayLike, length: int, step: float) -> F64:
    """Q = H(z) * H(1/z) of (6.42): real and positive."""
    return np.asarray(moving_mean(frequency, length, step) ** 2)


def cut_off(length: int, step: float, passes: int) -> float:
    """Where ``passes`` moving means, one after the other, have fallen by 3 dB."""

    def above(frequency: float) -> float:
        return float(moving_mean(frequency, length, step)[0] ** passes - np.sqrt(0.5))

    return float(brentq(above, 1e-6, 2 * np.pi / (length * step) - 1e-6))


def left_over(gain: Gain, rho: float, frequency: ArrayLike) -> float:
    """sup abs(1 - rho * gain) over the frequencies, (6.20)."""
    return float(np.max(np.abs(1 - rho * gain(_band(frequency)))))


def best_rho(gain: Gain, frequency: ArrayLike, weight: ArrayLike = 1.0) -> tuple[float, float]:
    """(rho, what it leaves) that minimises sup abs(weight * (1 - rho * gain)), (6.41); the sup is
    convex in rho."""
    loop, weights = gain(_band(frequency)), np.asarray(weight)

    def worst(rho: float) -> float:
        return float(np.max(np.abs(weights * (1 - rho * loop))))

    found = minimize_scalar(worst, bounds=(0.0, 50.0), method="bounded", options={"xatol": 1e-7})
    return float(found.x), float(found.fun)


RHO = 0.7444
WINDOW = 0.2  # min; N0 = 20 samples of 0.6 s
Q_LEN = 20  # of the thesis's step
ITERATIONS = 7
LONG = 50  # iterations that show whether noise grows


def law(step: float = STEP, rho: float = RHO, q_len: int | None = None) -> LearnerConfig:
    """(6.31) with rho * s and (6.42): the filter acts on input plus correction."""
    return LearnerConfig(
        samples=len(times(step)),
        step=step,
        kd=rho,
        q_len=window(WINDOW, step) if q_len is None else q_len,
    )


def prepare(setting: None, options: ExampleOptions) -> Prepared:
    """The example: the rod by backward Euler on 100 cells."""
    step, last = step_and_last(options, ITERATIONS)

    def learned() -> LearningProblem:
        return problem(heat_plant(CHAPTER6, step), law(step))

    return prepared(learned, options, last, step=step)


def exact(
    config: LearnerConfig, iterations: int, taught: Callable[[F64], F64] | None = None
) -> F64:
    """Errors of any law of the thesis's step on the exact rod."""
    return problem(heat_plant(CHAPTER6, scheme="modal"), config, taught).uncut(iterations)


def with_filter() -> F64:
    """Errors of ``LONG`` iterations as the thesis has it."""
    return exact(law(), LONG)


def without_filter() -> F64:
    """(6.19)."""
    return exact(law(q_len=1), LONG)


def with_filter_on_the_correction() -> F64:
    """u + rho * Q(de/dt), as the words of section 6.5 may be read."""
    config = LearnerConfig(samples=len(times(STEP)), step=STEP, kp=RHO)
    return exact(config, LONG, lambda error: zero_phase(slope(error), Q_LEN))
