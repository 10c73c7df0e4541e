"""Random fish: populations of different severity.

``mild`` is kinder than any fish in a tank, ``realistic`` what one has to reckon with, ``hard`` is
beyond it; ``adversarial`` breaks what the fish model takes for granted (a delay beyond a beat, a
thrust that collapses). All numbers of a fish come from its seed, so that every law meets the same
fish in the same water.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

_KAPPA_PER_M = (4.0, 20.0)
_FIN_DEPTH_M, _FIN_KAPPA_PER_M, _FIN_FACTOR = 0.08, 10.0, (0.85, 1.25)
_BACKLASH_RAD = (0.03, 0.16)
_ASYMMETRY = 0.25
_PLACE_M, _PLACE_RAD = 0.005, 0.0175

Range = tuple[float, float]


@dataclass(frozen=True)
class Population:
    """Ranges of the simulator's settings, drawn evenly, and settings that all fish share."""

    ranges: dict[str, Range]
    shared: dict[str, float]
    trend: float  # of the gain per trial, at most, downwards
    reactive: dict[str, float] = field(default_factory=dict)


def _shared(gain: float, flow: float, wave: float, start: float, walk: float) -> dict[str, float]:
    return {
        "gain_sigma": gain,
        "flow_sigma_m_s": flow,
        "flow_moves_m_s": flow,
        "standing_wave_m_s": wave,
        "start_sigma_m_s": start,
        "drift_sigma": walk,
        "place_sigma_m": _PLACE_M,
        "place_sigma_rad": _PLACE_RAD,
    }


_MILD = Population(
    {"thrust_exponent": (2.0, 2.0), "drag_linear": (0.0, 0.0), "drag_per_rad": (0.0, 0.0),
     "servo_rate_rad_s": (4.0, 9.0), "servo_lag_s": (0.02, 0.06), "wake_share": (0.1, 0.1),
     "wake_s": (0.5, 1.2), "delay_s": (0.05, 0.35)},
    _shared(0.01, 0.0007, 0.0005, 0.0015, 0.001),
    0.0008,
)  # fmt: skip
_REALISTIC = Population(
    {"thrust_exponent": (1.7, 2.6), "drag_linear": (0.0, 0.15), "drag_per_rad": (0.0, 0.6),
     "servo_rate_rad_s": (4.0, 9.0), "servo_lag_s": (0.02, 0.06), "wake_share": (0.15, 0.4),
     "wake_s": (0.5, 1.2), "delay_s": (0.05, 0.35)},
    _shared(0.02, 0.0015, 0.0015, 0.003, 0.004) | {"outliers": 0.04, "lost_beats": 0.01},
    0.003,
)  # fmt: skip
_HARD = Population(
    {"thrust_exponent": (1.7, 2.6), "drag_linear": (0.0, 0.15), "drag_per_rad": (0.0, 0.6),
     "servo_rate_rad_s": (3.2, 6.0), "servo_lag_s": (0.04, 0.12), "wake_share": (0.3, 0.6),
     "wake_s": (1.5, 3.0), "delay_s": (0.1, 0.6)},
    _shared(0.03, 0.0025, 0.003, 0.005, 0.008) | {"outliers": 0.08, "lost_beats": 0.04},
    0.006,
)  # fmt: skip
_ADVERSARIAL = Population(
    _REALISTIC.ranges | {"delay_s": (1.1, 1.1)},
    _REALISTIC.shared,
    _REALISTIC.trend,
    {"collapse_rad": 0.5},
)
POPULATIONS = {
    "mild": _MILD, "realistic": _REALISTIC, "hard": _HARD, "adversarial": _ADVERSARIAL,
}  # fmt: skip
_ONLY_REACTIVE = (
    "thrust_exponent", "drag_linear", "drag_per_rad", "wake_share", "wake_s",
)  # fmt: skip
_STILL = {
    "gain_sigma": 0.0, "flow_sigma_m_s": 0.0, "flow_moves_m_s": 0.0, "standing_wave_m_s": 0.0,
    "start_sigma_m_s": 0.0, "outliers": 0.0, "lost_beats": 0.0, "camera_noise_m": 0.0,
    "place_sigma_m": 0.0, "place_sigma_rad": 0.0,
}  # fmt: skip


def draw(population: str, plant: str, seed: int) -> dict[str, float]:
    """Settings of the fish of that seed, of ``plant``."""
    known = POPULATIONS[population]
    rng = np.random.default_rng([seed, list(POPULATIONS).index(population)])
    kappa_per_m = float(np.exp(rng.uniform(*np.log(_KAPPA_PER_M))))
    fish = {name: float(rng.uniform(*span)) for name, span in known.ranges.items()}
    factor = float(np.exp(rng.uniform(*np.log(_FIN_FACTOR))))
    only = {
        "fin_depth_m": _FIN_DEPTH_M * math.sqrt(kappa_per_m / _FIN_KAPPA_PER_M) * factor,
        "servo_backlash_rad": float(rng.uniform(*_BACKLASH_RAD)),
        "asymmetry": float(rng.uniform(-_ASYMMETRY, _ASYMMETRY)),
    }
    trend = -float(rng.uniform(0.0, known.trend))
    fish |= known.shared | {"kappa_per_m": kappa_per_m, "drift_trend": trend}
    if plant == "reactive":
        return fish | only | known.reactive
    return {name: value for name, value in fish.items() if name not in _ONLY_REACTIVE}


def still(fish: dict[str, float]) -> dict[str, float]:
    """The same fish without noise, which drifts as it does: how its inputs are judged."""
    return fish | _STILL
