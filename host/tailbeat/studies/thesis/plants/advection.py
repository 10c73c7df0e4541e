"""Chapter 7's anticipatory law (7.10) on its example (section 7.5), and what learns instead.

The Theta function of chapter 7, (7.5)-(7.6): how heat given at one end of an insulated rod of
length 1 arrives along it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import ExampleOptions, Prepared, Uptake
from tailbeat.studies.thesis.learner import LearnerConfig, load, pointer
from tailbeat.studies.thesis.plants.heat import (
    CELLS,
    CHAPTER7,
    STEP,
    SampledPlant,
    heat_plant,
    lead_samples,
    problem,
    step_and_last,
    times,
    window,
)
from tailbeat.studies.thesis.series import LearningProblem, prepared

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
        """y of a trial; NaN from where v jumps the pole of phi, or is not finite any more."""
        return self._run(values, None)

    def field(self, values: F64) -> F64:
        """v of a trial, one row per sample, one column per node."""
        field = np.empty((len(values), self.cells + 1))
        self._run(values, field)
        return field

    def _run(self, values: F64, field: F64 | None) -> F64:
        native = load("double")
        fields = asdict(self) | {"samples": len(values), "uptake": _UPTAKES.index(self.uptake)}
        plant = native.ffi.new("advection_plant_t *", fields)
        out = np.empty(len(values))
        given, *made = (pointer(native, one) for one in (np.ascontiguousarray(values), out, field))
        done = native.lib.advection_plant_run(plant, given, *made)
        out[done:] = np.nan
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


def printed_plant(step: float, options: ExampleOptions) -> SampledPlant:
    """(7.31) as printed, its phi below v = 0 as the options have it, or clipped."""
    return AdvectionPlant(step, options.uptake or UPTAKE)


def rod_plant(step: float, options: ExampleOptions) -> SampledPlant:
    """The heat equation, F = 0."""
    return heat_plant(CHAPTER7, step)


def prepare(
    setting: Callable[[float, ExampleOptions], SampledPlant], options: ExampleOptions
) -> Prepared:
    """(7.10) on one of these plants."""
    step, last = step_and_last(options, ITERATIONS)
    delta = DELTA if options.delta is None else options.delta
    lead_samples(delta, step)
    uptake: dict[str, Any] = (
        {"uptake": options.uptake or UPTAKE} if setting is printed_plant else {}
    )

    def learned() -> LearningProblem:
        return problem(setting(step, options), law(delta, step))

    return prepared(learned, options, last, delta=delta, step=step, **uptake)


@dataclass(frozen=True)
class Proportional:
    """P-type with lead and Q: what learns where the input leaves no integral behind. ``gain``: of
    u[k] += gain * e[k + lead]; ``by_time`` makes it gain * (2 t + 3)."""

    gain: float
    window: float  # min, of Q
    by_time: bool = False
    lead: float = 0.10  # min

    def problem(self, step: float = STEP) -> LearningProblem:
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

        return problem(AdvectionPlant(step), config, weighted)


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
    return np.asarray(kernels.sum(axis=-1) / np.sqrt(4 * np.pi * time))


def _by_modes(x: float, time: F64) -> F64:
    """(7.6): the same as a sum of cosines."""
    n = np.arange(1, _TERMS)
    modes = np.cos(n * np.pi * x) * np.exp(-((n * np.pi) ** 2) * time[..., None])
    return np.asarray(0.5 + modes.sum(axis=-1))


def gain_for(lead: float) -> float:
    """-1 / (2 theta(1, lead)): the gain that (7.14) has contract best."""
    return float(-1 / (2 * theta(1.0, lead)))


def contraction_bound(gain: float, lead: float) -> float:
    """abs(1 + 2 * gain * theta(1, lead)): the factor per trial that theorem 7.1 allows."""
    return float(abs(1 + 2 * gain * theta(1.0, lead)))
