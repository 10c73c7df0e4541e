"""Random fish: populations of different severity.

``mild`` is kinder than any fish in a tank, ``realistic`` what one has to reckon with, ``hard`` is
beyond it; ``adversarial`` breaks what the fish model takes for granted (a delay beyond a beat, a
thrust that collapses). All numbers of a fish come from its seed, so that every law meets the same
fish in the same water.

Trials of many simulated fish at once: of the simulator, or of a plant compiled elsewhere.

The smallest error that one fish allows, whatever the plant: in amplitudes, by the plant's own
differences, so that nothing is taken for granted of how thrust depends on them. The lowest of
several starts counts, as the search ends in the nearest optimum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from cffi import FFI
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.fish_model import SIGMA_M_S
from tailbeat.sim.config import senseless

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


@dataclass(frozen=True)
class BatchTrials:
    """Shape (fish, beats), m/s over ground. ``speed_m_s``: measured, NaN = too few pictures;
    ``sigma_m_s``: its standard deviation from the scatter about the line, NaN likewise;
    ``true_m_s``: the simulator's own."""

    speed_m_s: F64
    sigma_m_s: F64
    true_m_s: F64

    def cut(self, executed: NDArray[np.int64]) -> BatchTrials:
        """As it is known of trials that ended after ``executed`` whole beats, shape (fish,). The
        simulator's own speeds go on: they are what the amplitudes would have done."""
        beyond = np.arange(self.speed_m_s.shape[1]) >= executed[:, None]
        speed, sigma = (np.where(beyond, np.nan, of) for of in (self.speed_m_s, self.sigma_m_s))
        return BatchTrials(speed_m_s=speed, sigma_m_s=sigma, true_m_s=self.true_m_s)


class FishBatch:
    """Fish given as settings of the simulator (fields of ``sim_config_t``, ``seed`` among them)
    that differ from the plant's defaults. Raises InputError when a value makes no sense."""

    def __init__(self, plant: str, fish: Sequence[dict[str, float]]) -> None:
        self._count = len(fish)
        self._configs: Any = ffi.new("sim_config_t[]", max(1, self._count))
        for index, settings in enumerate(fish):
            config = plant_config(plant, settings)
            if not lib.sim_config_valid(config):
                raise senseless()
            self._configs[index] = config[0]

    def run(
        self, amplitude_rad: F64, number: int | NDArray[np.uint32], beat_s: float = 1.0
    ) -> BatchTrials:
        """One trial of each, with ``amplitude_rad`` of shape (fish, beats); ``number`` keys the
        noise (1 = the first trial), one for all or one for each. Raises InputError when a value
        makes no sense."""
        amplitude = np.ascontiguousarray(amplitude_rad, dtype=np.float64)
        if amplitude.ndim != 2 or len(amplitude) != self._count:
            raise InputError(
                f"amplitudes of shape {amplitude.shape} do not fit {self._count} fish.",
                "Give one row of amplitudes per fish.",
            )
        numbers = np.ascontiguousarray(np.broadcast_to(number, self._count), dtype=np.uint32)
        true, speed, sigma = (np.empty_like(amplitude) for _ in range(3))
        arrays = [ffi.from_buffer("double[]", one) for one in (amplitude, true, speed, sigma)]
        if not lib.shoal_swim(
            self._configs, self._count, ffi.from_buffer("uint32_t[]", numbers), arrays[0],
            amplitude.shape[1], beat_s, *arrays[1:],
        ):  # fmt: skip
            raise InputError(
                f"no fish can swim these amplitudes in beats of {beat_s:g} s.",
                "Amplitudes are finite, in rad; a beat is a multiple of 0.02 s.",
            )
        return BatchTrials(speed_m_s=speed, sigma_m_s=sigma, true_m_s=true)

    def config(self, index: int) -> Any:
        """``sim_config_t *`` of one fish, a copy."""
        return ffi.new("sim_config_t *", self._configs[range(self._count)[index]])


class Batch(Protocol):
    """Fish side by side, each with settings of its own."""

    def run(
        self, amplitude_rad: F64, number: int | NDArray[np.uint32], beat_s: float = 1.0
    ) -> BatchTrials:
        """One trial of each, as of ``FishBatch``."""


ABI = 1  # of host/native/tailbeat_plant.h
QUIET_TRIAL = 0  # the number of a trial without noise and drift
_DECLARED = """
uint32_t tailbeat_plant_abi(void);
bool tailbeat_plant_trial(uint64_t seed, uint32_t trial, double beat_s, uint32_t beats,
                          const double *amplitude_rad, const double *bias_rad, double *speed_m_s,
                          double *heading_rad);
"""


def is_foreign(plant: str) -> bool:
    """Whether a plant is a shared library's path, not one of the simulator's."""
    return Path(plant).suffix in (".so", ".dylib", ".dll")


@cache
def foreign_plant(path: str) -> tuple[Any, Any]:
    """(cffi instance, library). Raises InputError when it is none, or of another version."""
    found = FFI()
    found.cdef(_DECLARED)
    try:
        library: Any = found.dlopen(str(Path(path).resolve()))
        abi = library.tailbeat_plant_abi()
        library.tailbeat_plant_trial  # noqa: B018 - looked up now, not in the middle of a study
    except (OSError, AttributeError) as error:
        raise InputError(
            f"{path} is no plant ({str(error).split('. Additionally')[0]}).",
            "Compile one that has the functions of tailbeat_plant.h (docs/monte-carlo.md).",
        ) from error
    if abi != ABI:
        raise InputError(
            f"{path} was compiled for version {abi} of tailbeat_plant.h; this is version {ABI}.",
            "Compile it again with the header of this version.",
        )
    return found, library


class ForeignBatch:
    """Fish of a plant compiled elsewhere, which differ by ``seed``. The speeds it gives are the
    true ones; measured they have a camera's noise."""

    def __init__(self, path: str, fish: Sequence[dict[str, float]]) -> None:
        self._path = path
        self._ffi, self._lib = foreign_plant(path)
        self._seeds = [int(one["seed"]) for one in fish]

    def run(
        self, amplitude_rad: F64, number: int | NDArray[np.uint32], beat_s: float = 1.0
    ) -> BatchTrials:
        """As of ``FishBatch``. Raises InputError when the plant refuses."""
        amplitude = np.ascontiguousarray(amplitude_rad, dtype=np.float64)
        numbers = np.broadcast_to(number, len(self._seeds))
        true, speed = np.empty_like(amplitude), np.empty_like(amplitude)
        for i, (seed, trial) in enumerate(zip(self._seeds, numbers.tolist(), strict=True)):
            true[i] = self._trial(seed, trial, beat_s, amplitude[i])
            noise = np.random.default_rng([seed, trial]).normal(0, SIGMA_M_S, len(true[i]))
            speed[i] = true[i] + (noise if trial != QUIET_TRIAL else 0.0)
        return BatchTrials(speed, np.where(np.isfinite(speed), SIGMA_M_S, np.nan), true)

    def _trial(self, seed: int, trial: int, beat_s: float, amplitude_rad: F64) -> F64:
        beats = len(amplitude_rad)
        straight, speed, heading = np.zeros(beats), np.full(beats, np.nan), np.zeros(beats)
        rows = (amplitude_rad, straight, speed, heading)
        pointers = [self._ffi.from_buffer("double[]", row) for row in rows]
        if not self._lib.tailbeat_plant_trial(seed, trial, beat_s, beats, *pointers):
            raise InputError(
                f"{Path(self._path).name} refuses a trial of {beats} beats of {beat_s:g} s.",
                "Look into what the plant can do.",
            )
        return speed


def batch_of(plant: str, fish: Sequence[dict[str, float]]) -> Batch:
    """Of a plant of the simulator, or of a shared library's path."""
    return ForeignBatch(plant, fish) if is_foreign(plant) else FishBatch(plant, fish)


_DIFFERENCE_RAD = 0.004
_STEPS_MAX = 25
_RADIUS_RAD, _RADIUS_MIN_RAD = 0.08, 5e-4
_GAINED_M_S = 2e-5  # less is not worth another step


def smallest_error(
    plant: str,
    fish: dict[str, float],
    reference_m_s: F64,
    beat_s: float,
    amplitude_max_rad: float,
    starts: Sequence[F64],
    number: int = 1,
) -> tuple[float, F64]:
    """(max|e| of the best input found, the input): linear programs in a trust region, from each of
    ``starts``, on the noise-free fish as it has drifted at trial ``number``. Costs about a second
    per start."""
    if is_foreign(plant):
        number = QUIET_TRIAL
    search = _Search(plant, still(fish), number, reference_m_s, beat_s, amplitude_max_rad)
    return min((search.descend(start) for start in starts), key=lambda found: found[0])


@dataclass(frozen=True)
class _Search:
    plant: str
    fish: dict[str, float]
    number: int
    reference_m_s: F64
    beat_s: float
    most_rad: float

    def speeds(self, rows: F64) -> F64:
        batch = batch_of(self.plant, [self.fish] * len(rows))
        return batch.run(rows, self.number, self.beat_s).true_m_s

    def descend(self, start: F64) -> tuple[float, F64]:
        amplitude = np.clip(start, 0.0, self.most_rad)
        speed = self.speeds(amplitude[None])[0]
        error, radius = self._error(speed), _RADIUS_RAD
        for _ in range(_STEPS_MAX):
            jacobian = self._jacobian(amplitude, speed)
            step = None
            while radius > _RADIUS_MIN_RAD and step is None:
                step = self._step(amplitude, speed, jacobian, error, radius)
                radius = radius / 2 if step is None else radius
            if step is None:
                break
            amplitude, speed, radius = step[0], step[1], radius * step[2]
            gained, error = error - self._error(speed), self._error(speed)
            if gained < _GAINED_M_S:
                break
        return error, amplitude

    def _error(self, speed: F64) -> float:
        return float(np.abs(self.reference_m_s - speed).max())

    def _jacobian(self, amplitude: F64, speed: F64) -> F64:
        step = np.where(amplitude + _DIFFERENCE_RAD <= self.most_rad, 1, -1) * _DIFFERENCE_RAD
        moved = self.speeds(amplitude + np.diag(step))
        slopes: F64 = ((moved - speed) / step[:, None]).T
        return slopes

    def _step(
        self, amplitude: F64, speed: F64, jacobian: F64, error: float, radius: float
    ) -> tuple[F64, F64, float] | None:
        """(amplitudes, their speeds, by how much the radius may grow), None when no better."""
        from scipy.optimize import linprog

        count, off = len(amplitude), self.reference_m_s - speed
        ones = np.ones((count, 1))
        low, high = np.maximum(-radius, -amplitude), np.minimum(radius, self.most_rad - amplitude)
        found = linprog(
            np.append(np.zeros(count), 1.0),
            A_ub=np.vstack([np.hstack([-jacobian, -ones]), np.hstack([jacobian, -ones])]),
            b_ub=np.concatenate([-off, off]),
            bounds=[*zip(low, high, strict=True), (0, None)],
            method="highs",
        )
        if found.x is None:
            return None
        moved = np.clip(amplitude + found.x[:count], 0.0, self.most_rad)
        speeds = self.speeds(moved[None])[0]
        gained, promised = error - self._error(speeds), error - float(found.x[-1])
        if gained < 1e-7:
            return None
        share = gained / max(promised, 1e-12)
        return moved, speeds, 2.0 if share > 0.7 else 1.0 if share > 0.3 else 0.5
