"""Trials of many simulated fish at once: of the simulator, or of a plant compiled elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib, load_types
from tailbeat.core.platform.programs import LIBRARY_FLAGS
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.fish_model import SIGMA_M_S
from tailbeat.sim.config import senseless


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
        true, speed, sigma = np.empty((3, *amplitude.shape))
        arrays = [ffi.from_buffer("double[]", one) for one in (amplitude, true, speed, sigma)]
        if not lib.batch_swim(
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


def is_foreign(plant: str) -> bool:
    """Whether a plant is a shared library's path, not one of the simulator's."""
    return Path(plant).suffix in (".so", ".dylib", ".dll")


@cache
def foreign_plant(path: str) -> tuple[Any, Any]:
    """(cffi instance, library). Raises InputError when it is none, or of another version."""
    found = load_types("plant")
    try:
        library: Any = found.dlopen(str(Path(path).resolve()), LIBRARY_FLAGS)
        abi = library.tailbeat_plant_abi()
        library.tailbeat_plant_trial  # noqa: B018 - looked up now, not in the middle of a study
    except (OSError, AttributeError) as error:
        raise InputError(
            f"{path} is no plant ({str(error).split('. Additionally')[0]}).",
            "Compile one that has the functions of tailbeat_plant.h, which the package contains.",
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
