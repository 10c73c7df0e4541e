"""The plant of chapter 7's example (7.31): heat that is carried along and taken up, computed by
host/native/thesis/advection_plant.h."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tailbeat.thesis.arrays import Doubles
from tailbeat.thesis.heat import CELLS, STEP, times
from tailbeat.thesis.native import load

Uptake = Literal["clip", "abs", "monod", "none"]
_UPTAKES: tuple[Uptake, ...] = ("clip", "abs", "monod", "none")  # as advection_uptake_t


class PlantFailed(ArithmeticError):
    """The plant could not be computed to the end of the trial."""


@dataclass(frozen=True)
class AdvectionPlant:
    """(7.31) with g = 1. ``uptake``: phi below v = 0, where the printed one has a pole: ``clip``
    phi(max(v, 0)), ``abs`` -mu*v/(K + abs(v)), ``monod`` as printed, ``none`` no phi at all."""

    step: float = STEP  # min
    uptake: Uptake = "clip"
    carried: float = 2.0  # varsigma
    uptake_max: float = 3.2  # mu_max
    half_at: float = 1.0  # K_s
    inflow: float = 1.0  # g
    cells: int = CELLS

    @property
    def time(self) -> Doubles:
        """Where the samples are, min."""
        return times(self.step)

    def output(self, values: Doubles) -> Doubles:
        """y of a trial.

        Raises:
            PlantFailed: when v jumps the pole of phi, or is not finite any more.
        """
        return self._run(values, None)

    def field(self, values: Doubles) -> Doubles:
        """v of a trial, one row per sample, one column per node. Raises as ``output``."""
        field = np.empty((len(self.time), self.cells + 1))
        self._run(values, field)
        return field

    def _run(self, values: Doubles, field: Doubles | None) -> Doubles:
        native = load("double")
        samples = len(self.time)
        if np.shape(values) != (samples,):
            raise ValueError(f"{np.shape(values)} inputs for {samples} samples")
        plant = native.ffi.new(
            "advection_plant_t *",
            {
                "samples": samples,
                "cells": self.cells,
                "step": self.step,
                "carried": self.carried,
                "uptake_max": self.uptake_max,
                "half_at": self.half_at,
                "inflow": self.inflow,
                "uptake": _UPTAKES.index(self.uptake),
            },
        )
        out = np.empty(samples)

        def pointer(array: Doubles | None) -> Any:
            if array is None:
                return native.ffi.NULL
            return native.ffi.cast("double *", native.ffi.from_buffer(array))

        given = np.ascontiguousarray(values, dtype=np.float64)
        done = native.lib.advection_plant_run(plant, pointer(given), pointer(out), pointer(field))
        if done < samples:
            raise PlantFailed(f"v cannot be computed beyond {done * self.step:.2f} min")
        return out
