"""The error bound of a reference on a fish: the smallest error any admissible input can reach.

Noise-free, from rest, in beat means. Admissible are amplitudes from 0 to a largest one; thrust is
never negative, so only the drag slows the fish; neighbouring beats may be bound by a slew limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.learning.error_bound_solve import (
    ModelPlant,
    Plant,
    SimulatedPlant,
    Task,
    least_squares,
    minimax,
)
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified

NEGLIGIBLE_M_S = 0.0005  # errors below are nobody's concern: a camera's sigma per beat is 0.7 mm/s
_SPOT = 0.5  # of the largest error: beats above belong to a spot
_AT_LIMIT = 1e-3  # of w_max: 3 % of the largest speed

DRAG = "drag alone slows it"
SATURATED = "saturated"
SLEW = "slew"
START = "delay at the start"
COUPLED = "neighbouring beats cannot be had at once"


@dataclass(frozen=True)
class Miss:
    """Beats ``first`` to ``last`` in a row where the least-squares optimum misses the reference.

    ``error_m_s``: the largest among them, signed (positive = the fish is too slow), at beat
    ``worst``. ``why``: one of ``DRAG``, ``SATURATED``, ``SLEW``, ``START``, ``COUPLED``.
    """

    first: int
    last: int
    worst: int
    error_m_s: float
    why: str


@dataclass(frozen=True)
class ErrorBound:
    """What no learning law can beat on this fish with this reference.

    ``lsq_…``: of the least-squares optimum, "the" bound where nothing else is said. Inputs are
    amplitudes in rad, float32, shape (beats,). ``spots``: where and why, the worst first; none when
    the reference can be reached.
    """

    minimax_m_s: float
    lsq_max_abs_m_s: float
    lsq_rms_m_s: float
    minimax_input: F32
    lsq_input: F32
    spots: tuple[Miss, ...]


@dataclass(frozen=True)
class ErrorBoundRange:
    """The bound of an identified fish, by its model, and the 90 % interval over its models."""

    bound: ErrorBound
    lsq_max_abs_m_s: tuple[float, float]


def error_bound(
    fish: Any,
    reference: Reference,
    amplitude_max_rad: float,
    slew_rad: float | None = None,
) -> ErrorBound:
    """``fish``: a ``FishModel`` (some 50 ms) or the simulator's ``sim_config_t *`` (about 0.3 s).

    ``slew_rad``: largest change of the amplitude from beat to beat; None = any. Raises InputError
    when a value makes no sense.
    """
    task = _task(fish, reference, amplitude_max_rad, slew_rad)
    squares = least_squares(task)
    largest = minimax(task, task.start())
    error = task.error(squares)
    return ErrorBound(
        minimax_m_s=float(np.abs(task.error(largest)).max()),
        lsq_max_abs_m_s=float(np.abs(error).max()),
        lsq_rms_m_s=float(np.sqrt(np.mean(error**2))),
        minimax_input=task.plant.amplitude_rad(largest).astype(np.float32),
        lsq_input=task.plant.amplitude_rad(squares).astype(np.float32),
        spots=_spots(task, squares, error, reference.beat_s),
    )


def lsq_max_abs_m_s(
    fish: Any,
    reference: Reference,
    amplitude_max_rad: float,
    slew_rad: float | None = None,
) -> float:
    """The least-squares bound alone; of a ``FishModel`` in some 5 ms."""
    task = _task(fish, reference, amplitude_max_rad, slew_rad)
    return float(np.abs(task.error(least_squares(task))).max())


def error_bound_range(
    identified: Identified,
    reference: Reference,
    amplitude_max_rad: float,
    slew_rad: float | None = None,
) -> ErrorBoundRange:
    """The error bound before the first trial, and how sure it is."""
    each = [
        lsq_max_abs_m_s(model, reference, amplitude_max_rad, slew_rad)
        for model in identified.models
    ]
    low, high = np.percentile(each, [5, 95])
    return ErrorBoundRange(
        error_bound(identified.model, reference, amplitude_max_rad, slew_rad),
        (float(low), float(high)),
    )


def _task(
    fish: Any, reference: Reference, amplitude_max_rad: float, slew_rad: float | None
) -> Task:
    if not (amplitude_max_rad > 0 and (slew_rad is None or slew_rad > 0)):
        raise InputError(
            "the largest amplitude and the slew limit must be more than 0 rad.",
            "Check AMP_MAX_RAD.",
        )
    kind = ModelPlant if isinstance(fish, FishModel) else SimulatedPlant
    plant: Plant = kind(fish, reference.beat_s, amplitude_max_rad)
    if slew_rad is not None and slew_rad >= amplitude_max_rad:
        slew_rad = None
    return Task(plant, reference.speed_m_s.astype(np.float64), slew_rad)


def _spots(task: Task, w: F64, error: F64, beat_s: float) -> tuple[Miss, ...]:
    size = np.abs(error)
    limit = max(_SPOT * float(size.max()), NEGLIGIBLE_M_S)
    slopes = task.plant.slopes(w, task.wanted_m_s - error)
    found, beats = [], np.flatnonzero(size > limit)
    for group in np.split(beats, np.flatnonzero(np.diff(beats) > 1) + 1):
        if group.size:
            worst = int(group[np.argmax(size[group])])
            why = _why(task, w, error, slopes[worst], worst, beat_s)
            found.append(Miss(int(group[0]), int(group[-1]), worst, float(error[worst]), why))
    return tuple(sorted(found, key=lambda spot: -abs(spot.error_m_s)))


def _why(task: Task, w: F64, error: F64, by_w: F64, beat: int, beat_s: float) -> str:
    """The limit at which the inputs that move this beat most are held."""
    if error[beat] > 0 and beat <= task.plant.delay_s / beat_s:
        return START
    w_max = task.plant.w_max
    weight = np.abs(by_w)
    if error[beat] < 0:
        held = {DRAG: weight[w <= _AT_LIMIT * w_max].sum()}
    else:
        held = {SATURATED: weight[w >= (1 - _AT_LIMIT) * w_max].sum()}
    if task.slew_rad is not None:
        change = np.abs(np.diff(task.plant.amplitude_rad(w))) >= task.slew_rad * (1 - 1e-3)
        bound = np.r_[change, False] | np.r_[False, change]
        held[SLEW] = weight[bound].sum()
    why, most = max(held.items(), key=lambda item: float(item[1]))
    return why if most >= 0.25 * weight.sum() else COUPLED
