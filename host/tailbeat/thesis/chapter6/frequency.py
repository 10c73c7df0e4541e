"""Chapter 6 in the frequency domain: the rod of (6.35), its approximations, and the gains that
follow from them. Frequencies in rad/min."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize_scalar

Doubles = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Gain = Callable[[Doubles], Complexes]

BAND = (0.0, 10.0)  # Omega of section 6.6


def _band(frequency: ArrayLike) -> Doubles:
    """With 0 replaced by something next to it, where all of these have their limit."""
    w = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    return np.where(w == 0, 1e-9, w)


def rod(frequency: ArrayLike) -> Complexes:
    """s * h12(0, s) on s = jw, exactly: sqrt(s) / sinh(sqrt(s)). With the law's rho * s it is the
    whole loop, and 1 - rho * rod what a trial leaves of an error."""
    root = np.sqrt(1j * _band(frequency))
    loop: Complexes = root / np.sinh(root)
    return loop


def h11(x: float, s: complex) -> complex:
    """From w_x(0) to w(x), as it must be."""
    root = np.sqrt(s)
    return complex(-np.cosh(root * (1 - x)) / (root * np.sinh(root)))


def h11_printed(x: float, s: complex) -> complex:
    """The same as printed: what sinh for cosh in exp(Fx) gives."""
    root = np.sqrt(s)
    return complex(-np.exp(-root * x) / root)


def h11_slope_at_the_end(
    transfer: Callable[[float, complex], complex], s: complex, apart: float = 1e-5
) -> float:
    """abs(w_x(1)) that ``transfer`` leads to; the rod is insulated there as far as w_x(0) goes."""
    return float(abs(transfer(1.0, s) - transfer(1.0 - apart, s)) / apart)


def h12(x: float, frequency: ArrayLike) -> Complexes:
    """From the driven end x = 1 to w(x), K0 = 1."""
    root = np.sqrt(1j * _band(frequency))
    gain: Complexes = np.cosh(root * x) / (root * np.sinh(root))
    return gain


def half_differentiator(frequency: ArrayLike, step: float = 0.01, order: int = 5) -> Complexes:
    """A(z) of section 6.6 on the unit circle: sqrt(s) by Tustin's rule with Muir's recursion."""
    back = np.exp(-1j * _band(frequency) * step)
    over, under = (np.polyval(_muir(order, r)[::-1], back) for r in (0.5, -0.5))
    gain: Complexes = np.sqrt(2 / step) * over / under
    return gain


def _muir(order: int, r: float) -> Doubles:
    """A_n(z^-1, r), rising powers of z^-1: A_n = A_{n-1} - c_n * z^-n * A_{n-1}(z), c_n = r / n for
    odd n and 0 else."""
    row = np.ones(1)
    for n in range(1, order + 1):
        row = np.append(row, 0.0)
        if n % 2:
            row = row - r / n * row[::-1]
    return row


def half_differentiator_coefficients(order: int = 5) -> tuple[Doubles, Doubles]:
    """Numerator and denominator of A(z) ahead of its gain, rising powers of z^-1."""
    return _muir(order, 0.5), _muir(order, -0.5)


def modelled(frequency: ArrayLike) -> Complexes:
    """``rod`` as the thesis approximates it: A / sinh(A)."""
    root = half_differentiator(frequency)
    loop: Complexes = root / np.sinh(root)
    return loop


def moving_mean(frequency: ArrayLike, length: int, step: float) -> Doubles:
    """abs(H) of (6.42)."""
    half = _band(frequency) * step / 2
    gain: Doubles = np.abs(np.sin(length * half) / (length * np.sin(half)))
    return gain


def zero_phase(frequency: ArrayLike, length: int, step: float) -> Doubles:
    """Q = H(z) * H(1/z) of (6.42): real and positive."""
    gain: Doubles = moving_mean(frequency, length, step) ** 2
    return gain


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
