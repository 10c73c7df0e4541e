"""Chapter 7's anticipatory law (7.10) on its example (section 7.5), and what learns instead.

The Theta function of chapter 7, (7.5)-(7.6): how heat given at one end of an insulated rod of
length 1 arrives along it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import ExampleOptions, ExampleRun, Uptake
from tailbeat.studies.thesis.heat import (
    CELLS,
    CHAPTER7,
    STEP,
    PlantFailed,
    SampledPlant,
    asked,
    heat_plant,
    lead_samples,
    learn,
    times,
    window,
)
from tailbeat.studies.thesis.learner import LearnerConfig, Precision, load

RHO = -1.2041
DELTAS = (0.25, 0.15, 0.10, 0.05, 0.02)  # min, the thesis's five
DELTA = 0.25  # the one that RHO is made for
ITERATIONS = 5
UPTAKE: Uptake = "clip"
_UPTAKES: tuple[Uptake, ...] = ("clip", "abs", "monod", "none")  # as advection_uptake_t


@dataclass(frozen=True)
class AdvectionPlant:
    """(7.31) with g = 1, by host/native/thesis/advection_plant.h. ``uptake``: phi below v = 0,
    where the printed one has a pole: ``clip`` phi(max(v, 0)), ``abs`` -mu*v/(K + abs(v)), ``monod``
    as printed, ``none`` no phi at all."""

    step: float = STEP  # min
    uptake: Uptake = "clip"
    carried: float = 2.0  # varsigma
    uptake_max: float = 3.2  # mu_max
    half_at: float = 1.0  # K_s
    inflow: float = 1.0  # g
    cells: int = CELLS

    @property
    def time(self) -> F64:
        """Where the samples are, min."""
        return times(self.step)

    def output(self, values: F64) -> F64:
        """y of a trial.

        Raises:
            PlantFailed: when v jumps the pole of phi, or is not finite any more.
        """
        return self._run(values, None)

    def field(self, values: F64) -> F64:
        """v of a trial, one row per sample, one column per node. Raises as ``output``."""
        field = np.empty((len(self.time), self.cells + 1))
        self._run(values, field)
        return field

    def _run(self, values: F64, field: F64 | None) -> F64:
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

        def pointer(array: F64 | None) -> Any:
            if array is None:
                return native.ffi.NULL
            return native.ffi.cast("double *", native.ffi.from_buffer(array))

        given = np.ascontiguousarray(values, dtype=np.float64)
        done = native.lib.advection_plant_run(plant, pointer(given), pointer(out), pointer(field))
        if done < samples:
            raise PlantFailed(f"v cannot be computed beyond {done * self.step:.2f} min")
        return out


def law(delta: float = DELTA, step: float = STEP, tail: str = "hold-new") -> LearnerConfig:
    """(7.10). ``tail``: ``hold-new`` goes on with the new input of T - delta, ``hold-old`` with the
    old one, as printed.

    Raises:
        InputError: when delta is no multiple of half a step, or as long as the trial.
    """
    return LearnerConfig(
        samples=len(times(step)),
        step=step,
        kd=RHO,
        lead=lead_samples(delta, step),
        tail=tail,
    )


def printed(options: ExampleOptions) -> ExampleRun:
    """(7.10) on (7.31) as printed, its phi below v = 0 as the options have it, or clipped."""
    given = _asked(options)
    return _run(AdvectionPlant(given.step, options.uptake or UPTAKE), given, options.precision)


def printed_settings(options: ExampleOptions) -> dict[str, Any]:
    """What ``printed`` uses."""
    return {**asdict(_asked(options)), "uptake": options.uptake or UPTAKE}


def heat(options: ExampleOptions) -> ExampleRun:
    """(7.10) on the heat equation, F = 0."""
    given = _asked(options)
    return _run(heat_plant(CHAPTER7, given.step), given, options.precision)


def heat_settings(options: ExampleOptions) -> dict[str, Any]:
    """What ``heat`` uses."""
    return asdict(_asked(options))


@dataclass(frozen=True)
class _Chosen:
    delta: float
    iterations: int
    step: float


def _asked(options: ExampleOptions) -> _Chosen:
    step, last = asked(options, ITERATIONS)
    delta = DELTA if options.delta is None else options.delta
    lead_samples(delta, step)
    return _Chosen(delta, last, step)


def _run(plant: SampledPlant, given: _Chosen, precision: Precision) -> ExampleRun:
    return learn(plant, law(given.delta, given.step), given.iterations, precision)


def variant(delta: float, carried: float, uptake: Uptake = "clip") -> ExampleRun:
    """(7.10) on (7.31) with another varsigma or phi."""
    return learn(AdvectionPlant(uptake=uptake, carried=carried), law(delta), ITERATIONS)


@dataclass(frozen=True)
class Proportional:
    """P-type with lead and Q: what learns where the input leaves no integral behind. ``gain``: of
    u[k] += gain * e[k + lead]; ``by_time`` makes it gain * (2 t + 3)."""

    gain: float
    window: float  # min, of Q
    by_time: bool = False
    lead: float = 0.10  # min

    def learn(
        self, iterations: int, step: float = STEP, precision: Precision = "double"
    ) -> ExampleRun:
        """On the printed plant, clipped."""
        config = LearnerConfig(
            samples=len(times(step)),
            step=step,
            kp=self.gain,
            lead=lead_samples(self.lead, step),
            q_len=window(self.window, step),
            tail="hold-new",
        )
        at_input = times(step) - self.lead  # when what this error corrects was given

        def weighted(error: F64) -> F64:
            return np.asarray(error * (2 * at_input + 3)) if self.by_time else error

        return learn(AdvectionPlant(step), config, iterations, precision, weighted)


STEADY = Proportional(gain=-4.0, window=0.2)
BY_TIME = Proportional(gain=-0.5, window=0.1, by_time=True)
"""The rod's gain at rest is about -1 / (2 t + 1): the correction grows with time as it falls."""


_TERMS = 60  # of either sum: far beyond double precision where it is used


def theta(x: float, t: ArrayLike, images: int | None = None) -> F64:
    """theta(x, t) for t > 0. ``images``: the sum (7.5) cut at abs(m) <= images, as in figures 7.1
    to 7.3; None = the whole of it."""
    time = np.asarray(t, dtype=np.float64)
    if images is not None:
        return _by_images(x, time, images)
    with np.errstate(under="ignore"):
        early, late = _by_images(x, time, _TERMS), _by_modes(x, time)
    return np.where(time < 0.5, early, late)


def _by_images(x: float, time: F64, images: int) -> F64:
    """(7.5): the heat kernel and its mirror images."""
    at = x + 2 * np.arange(-images, images + 1)
    with np.errstate(under="ignore"):
        kernels = np.exp(-(at**2) / (4 * time[..., None]))
    total: F64 = kernels.sum(axis=-1) / np.sqrt(4 * np.pi * time)
    return total


def _by_modes(x: float, time: F64) -> F64:
    """(7.6): the same as a sum of cosines."""
    n = np.arange(1, _TERMS)
    modes = np.cos(n * np.pi * x) * np.exp(-((n * np.pi) ** 2) * time[..., None])
    total: F64 = 0.5 + modes.sum(axis=-1)
    return total


def gain_for(lead: float) -> float:
    """-1 / (2 theta(1, lead)): the gain that (7.14) has contract best."""
    return float(-1 / (2 * theta(1.0, lead)))


def promised(gain: float, lead: float) -> float:
    """abs(1 + 2 * gain * theta(1, lead)): the factor per trial that theorem 7.1 promises."""
    return float(abs(1 + 2 * gain * theta(1.0, lead)))
