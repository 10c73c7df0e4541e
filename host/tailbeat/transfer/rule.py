"""The exact rule on v' = -alpha*v*|v| + u.

Wanted is v2(t) = m*v1(s*t), m > 0. Then v2' = m*s*v1'(s*t), and the drag is m^2 times that of v1 at
s*t, which is u1 - v1' there; hence

    u2(t) = m^2*u1(s*t) + (m*s - m^2)*v1'(s*t)

for every alpha, which need not be known. With m = s the acceleration drops out: what was learned is
enough. Two transfers in a row are the one by both products. Chapter 4 maps time alone and leaves
the rest to its adaptation; here the drag's square is known, and so nothing is left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def scaled_input(
    input_m_s2: ArrayLike,
    acceleration_m_s2: ArrayLike,
    magnitude: float,
    time_factor: float,
) -> NDArray[np.float64]:
    """u2(t), m/s^2, from u1 and v1' at ``time_factor``*t; arrays of one shape, or anything else in
    one unit (thrust and acceleration, both over alpha). ``magnitude`` m > 0."""
    thrust = magnitude**2 * np.asarray(input_m_s2, dtype=np.float64)
    push = magnitude * (time_factor - magnitude) * np.asarray(acceleration_m_s2, dtype=np.float64)
    return np.asarray(thrust + push)
