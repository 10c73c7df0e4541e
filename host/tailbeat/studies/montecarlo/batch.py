"""Many simulated fish side by side: the simulator's water, tail and camera, without board and wire.

Each fish moves exactly as ``hal/sim``'s would with the same settings, seed and trial number; its
speeds are measured from its camera's noisy pictures by a line over each beat (hal/sim/shoal.h).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.sim.config import make_config, senseless


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
            others = {name: value for name, value in settings.items() if name != "seed"}
            config = make_config(plant, settings.get("seed", 1), others)
            if not lib.sim_config_valid(config):
                raise senseless()
            self._configs[index] = config[0]

    def __len__(self) -> int:
        return self._count

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
        swims = np.ascontiguousarray(np.broadcast_to(number, self._count), dtype=np.uint32)
        true, speed, sigma = (np.empty_like(amplitude) for _ in range(3))
        if not lib.shoal_swim(
            self._configs,
            self._count,
            ffi.from_buffer("uint32_t[]", swims),
            ffi.from_buffer("double[]", amplitude),
            amplitude.shape[1],
            beat_s,
            *(ffi.from_buffer("double[]", out) for out in (true, speed, sigma)),
        ):
            raise InputError(
                f"no fish can swim these amplitudes in beats of {beat_s:g} s.",
                "Amplitudes are finite, in rad; a beat is a multiple of 0.02 s.",
            )
        return BatchTrials(speed_m_s=speed, sigma_m_s=sigma, true_m_s=true)

    def config(self, index: int) -> Any:
        """``sim_config_t *`` of one fish, a copy."""
        return ffi.new("sim_config_t *", self._configs[range(self._count)[index]])


_LENGTHS_REMEDY = (
    "Write it like uniform:20,50 (beats) or uniform:44,58,50 (of 50 for a full trial)."
)


@dataclass(frozen=True)
class Lengths:
    """The trial would end after a time drawn evenly from ``low`` to ``high``; ``full`` of the same
    unit last as long as the reference, 0 = as many as it has beats."""

    low: float
    high: float
    full: float = 0.0

    def executed(self, seed: int, trial: int, beats: int) -> int:
        """Whole beats that trial ``trial`` (1 = the first) has of ``beats``."""
        drawn = self.low + _draw(seed, trial) * (self.high - self.low)
        return min(beats, math.floor(drawn * beats / (self.full or beats)))


def parse_lengths(text: str) -> Lengths | None:
    """``""``: every trial is full (None). ``uniform:LOW,HIGH`` in beats, ``uniform:LOW,HIGH,FULL``
    where FULL is a full trial. Raises InputError for anything else."""
    if not text:
        return None
    kind, _, arguments = text.partition(":")
    try:
        values = [float(part) for part in arguments.split(",")]
    except ValueError:
        values = []
    if kind != "uniform" or len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise InputError(f"'{text}' is no length of trials.", _LENGTHS_REMEDY)
    found = Lengths(*values)
    if not 0 <= found.low <= found.high or (len(values) == 3 and found.full <= 0):
        raise InputError(f"no trial is as long as '{text}'.", _LENGTHS_REMEDY)
    return found


def executed(
    lengths: Lengths | None, seeds: Sequence[int], trial: int, beats: int
) -> NDArray[np.int64]:
    """Whole beats that each fish swims of ``beats`` in its trial ``trial``."""
    if lengths is None:
        return np.full(len(seeds), beats)
    return np.array([lengths.executed(seed, trial, beats) for seed in seeds])


def _draw(seed: int, trial: int) -> float:
    """[0, 1), to 53 bits."""
    digest = hashlib.sha256(f"length {seed} {trial}".encode()).digest()
    return (int.from_bytes(digest[:8], "little") >> 11) * 2.0**-53
