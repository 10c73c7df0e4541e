"""The error bound of a reference on a fish: the smallest error any admissible input can reach.

Noise-free, from rest, in beat means. Admissible are amplitudes from 0 to a largest one; thrust is
never negative, so only the drag slows the fish; neighbouring beats may be bound by a slew limit.

The nearest reference that a fish can follow: the same speeds where it can, what drag and the
largest amplitude allow where it cannot.

The curve goes through the wanted means at the middle of each beat; from rest it may rise no faster
than full thrust and fall no faster than coasting, each with a margin; a mean over one beat then
rounds its corners, so that speed and slope are continuous (C1). Coasting leaves the wanted curve
where their slopes are equal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F32, F64
from tailbeat.core.csv import table_text
from tailbeat.core.errors import InputError
from tailbeat.core.files import replace_file
from tailbeat.core.reference import Reference, ReferenceLimits, curve
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
# Of what the model leaves out of a beat, in the minimax: how wide it makes the interval, and what
# it costs in the median. By 70 mild and 70 realistic random fish of the simulator's second plant.
_MISFIT_PART, _MISFIT_COSTS = 0.3, 0.25
_Z_90 = 1.6448536269514722
_MINIMAX_MODELS = 24
_INTERVAL_TOLERANCE_M_S = 1e-5  # of six fish and references the ends moved by 0.04 mm/s
_SPOT = 0.5  # of the largest error: beats above belong to a spot
_AT_LIMIT = 1e-3  # of w_max: 3 % of the largest speed

DRAG = "drag alone slows it"
SATURATED = "saturated"
SLEW = "slew"
START = "delay at the start"
COUPLED = "neighbouring beats are infeasible together"


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
    """The bound of an identified fish, by its model, and 90 % intervals: over its models, and of
    the minimax also by what the model leaves out."""

    bound: ErrorBound
    lsq_max_abs_m_s: tuple[float, float]
    minimax_m_s: tuple[float, float]


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
    best = error_bound(identified.model, reference, amplitude_max_rad, slew_rad)
    models = identified.models[:: max(1, len(identified.models) // _MINIMAX_MODELS)]
    start = ModelPlant(identified.model, reference.beat_s, amplitude_max_rad).thrust(
        best.minimax_input.astype(np.float64)
    )
    largest = [
        _minimax_m_s(_task(model, reference, amplitude_max_rad, slew_rad), start)
        for model in models
    ]
    ends = np.percentile(largest, [5, 95]) - best.minimax_m_s
    misfit_m_s = identified.scatter.misfit_m_s
    left_out = _Z_90 * _MISFIT_PART * misfit_m_s
    down, up = np.hypot(np.minimum(ends[0], 0), left_out), np.hypot(max(ends[1], 0), left_out)
    middle = best.minimax_m_s + _MISFIT_COSTS * misfit_m_s
    interval = max(middle - float(down), 0.0), middle + float(up)
    return ErrorBoundRange(best, (float(low), float(high)), interval)


def _minimax_m_s(task: Task, start: F64) -> float:
    """To what the interval of many needs; ``start``: the input of a similar fish."""
    found = minimax(task, task.admissible(start), _INTERVAL_TOLERANCE_M_S)
    return float(np.abs(task.error(found)).max())


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


TARGET_M_S = 0.001  # the error bound that is aimed at

_GRID = 20  # points per beat
_BRAKE_MARGIN = 0.9  # what is left for learning to correct
_PUSH_MARGIN = 0.5
_SPEED_MARGIN = 0.95
_TRAVEL_MARGIN = 0.97
_GENTLER = 0.9
_TRIES_MAX = 6
_FITS_MAX = 8
_UNDER_WAY = 0.3  # of the speed asked for
_PLATEAU = 0.98  # of the largest speed
_DIGITS = 7  # of the speeds in m/s: files of them are short and read back the same


@dataclass(frozen=True)
class Suggestion:
    """``t_s``, ``v_m_s``: the curve, 20 points per beat from 0 to the end; ``reference``: its beat
    means. ``floor_m_s``: the least-squares floor on it, the largest over likely models.
    ``changes``: what differs from the reference asked for, one line each; none = nothing worth
    saying."""

    reference: Reference
    t_s: F64
    v_m_s: F64
    floor_m_s: float
    changes: tuple[str, ...]

    def to_csv(self, path: Path) -> None:
        """Writes ``t_s,v_m_s``; ``reference.from_csv`` reads the very same reference."""
        points = zip(self.t_s.tolist(), self.v_m_s, strict=True)
        rows = [(repr(t), f"{v:.{_DIGITS}f}") for t, v in points]
        replace_file(path, table_text(("t_s", "v_m_s"), rows))


@dataclass(frozen=True)
class _Reach:
    """What the fish is counted on for."""

    brake_per_m: float  # slope at speed v: at least -brake*v**2
    push_per_m: float  # and at most push*(steady_max**2 - v**2),
    ramp_beats: float  # of which the first beats use a growing share
    steady_max_m_s: float
    delay_s: float

    def gentler(self) -> _Reach:
        brake, push = self.brake_per_m * _GENTLER, self.push_per_m * _GENTLER
        return replace(self, brake_per_m=brake, push_per_m=push, ramp_beats=self.ramp_beats + 1)


def suggest(
    fish: FishModel | Identified,
    reference: Reference,
    amplitude_max_rad: float,
    limits: ReferenceLimits | None = None,
) -> Suggestion:
    """The nearest feasible reference; deterministic, some 0.1 s.

    As long as the one asked for, unless the tank is too short: then beats are taken out of the
    cruise. Raises InputError when the fish has no thrust at ``amplitude_max_rad``.
    """
    limits = limits or ReferenceLimits()
    judges = _judges(fish)
    reach = _reach(judges, amplitude_max_rad)
    best: Suggestion | None = None
    for _ in range(_TRIES_MAX):
        t, v = _fitted(reference, reach, limits)
        found = curve(t, v, reference.beat_s, f"{reference.name}-feasible")
        worst = max(lsq_max_abs_m_s(model, found, amplitude_max_rad) for model in judges)
        if best is None or worst < best.floor_m_s:
            best = Suggestion(found, t, v, worst, _changes(reference, found, float(v[-1])))
        if worst <= TARGET_M_S:
            break
        reach = reach.gentler()
    assert best is not None
    wanted = min(float(reference.speed_m_s.max()), reach.steady_max_m_s, limits.speed_max_m_s)
    if float(best.reference.speed_m_s.max()) < _UNDER_WAY * wanted:
        raise InputError(
            "the reference is over before this fish is under way.", "Make it longer or slower."
        )
    return best


def _judges(fish: FishModel | Identified) -> list[FishModel]:
    """The model itself, and those of the identified set with little and with much drag."""
    if isinstance(fish, FishModel):
        return [fish]
    by_drag = sorted(fish.models, key=lambda model: model.kappa_per_m)
    low, high = (by_drag[round(share * (len(by_drag) - 1))] for share in (0.05, 0.95))
    return [fish.model, low, high]


def _reach(models: list[FishModel], amplitude_max_rad: float) -> _Reach:
    nominal = models[0]
    steady = min(float(model.steady_m_s(amplitude_max_rad)) for model in models)
    if steady <= 0:
        raise InputError(
            f"amplitudes up to {amplitude_max_rad:.3g} rad give this fish no thrust.",
            "Raise AMP_MAX_RAD beyond its dead zone.",
        )
    least = min(model.kappa_per_m for model in models)
    return _Reach(
        brake_per_m=min(_BRAKE_MARGIN * nominal.kappa_per_m, least),
        push_per_m=min(_PUSH_MARGIN * nominal.kappa_per_m, least),
        ramp_beats=0.5,
        steady_max_m_s=_SPEED_MARGIN * steady,
        delay_s=max(model.delay_s for model in models),
    )


def _fitted(reference: Reference, reach: _Reach, limits: ReferenceLimits) -> tuple[F64, F64]:
    """The curve (t_s, v_m_s), shortened until it fits into the tank."""
    top = min(limits.speed_max_m_s, reach.steady_max_m_s)
    wanted = np.minimum(reference.speed_m_s.astype(np.float64), top)
    room_m = _TRAVEL_MARGIN * (limits.tank_m - limits.fish_m) if limits.tank_m > 0 else math.inf
    if room_m <= 0:
        raise InputError(
            "the tank is no longer than the fish.", "Correct TANK_LEN_M or FISH_LEN_M."
        )
    for _ in range(_FITS_MAX):
        t, v = _curve(wanted, reference.beat_s, reach)
        travel_m = float(np.sum((v[1:] + v[:-1]) / 2) * (t[1] - t[0]))
        if travel_m <= room_m:
            break
        wanted = _shorter(wanted, reference.beat_s, travel_m - room_m, room_m / travel_m)
    return t, v


def _shorter(wanted: F64, beat_s: float, excess_m: float, scale: float) -> F64:
    """Without beats of the cruise; slower where there is none to spare."""
    top = float(wanted.max())
    fast = np.flatnonzero(wanted >= _PLATEAU * top)
    runs = np.split(fast, np.flatnonzero(np.diff(fast) > 1) + 1)
    cruise = max(runs, key=len)
    spare = min(len(cruise) - 1, math.ceil(excess_m / (top * beat_s)))
    if spare < 1:
        return wanted * scale
    first = int(cruise[0]) + (len(cruise) - spare) // 2
    return np.delete(wanted, np.arange(first, first + spare))


def _curve(wanted: F64, beat_s: float, reach: _Reach) -> tuple[F64, F64]:
    beats, step_s = len(wanted), beat_s / _GRID
    half = _GRID // 2
    t = step_s * np.arange(-half, beats * _GRID + half + 1, dtype=np.float64)
    middles = (np.arange(beats + 1) + 0.5) * beat_s
    last = max(2 * wanted[-1] - wanted[-2], 0.0) if beats > 1 else wanted[-1]
    asked = np.interp(t, middles, np.r_[wanted, last])
    followed = _follow(asked, t, step_s, reach, reach.delay_s + beat_s / 2)
    way = np.r_[0.0, np.cumsum((followed[1:] + followed[:-1]) / 2)] * step_s
    mean = (way[_GRID:] - way[:-_GRID]) / beat_s
    return np.round(t[half:-half], 9), np.round(np.maximum(mean, 0.0), _DIGITS)


def _follow(asked: F64, t: F64, step_s: float, reach: _Reach, start_s: float) -> F64:
    """The curve from rest at ``start_s`` that is as near as coasting and full thrust let it."""
    push, most = reach.push_per_m, reach.steady_max_m_s
    followed = np.zeros_like(asked)
    share = np.clip((t - start_s) / (reach.ramp_beats * _GRID * step_s), 0, 1)
    v = 0.0
    for i in range(1, len(t)):
        low = v / (1 + reach.brake_per_m * v * step_s)
        high = v + step_s * push * float(share[i]) * (most**2 - v**2)
        v = min(max(float(asked[i]), low), max(high, low))
        followed[i] = v
    return followed


def _changes(asked: Reference, found: Reference, end_m_s: float) -> tuple[str, ...]:
    lines = []
    old, new = asked.speed_m_s.astype(np.float64), found.speed_m_s.astype(np.float64)
    if len(new) != len(old):
        lines.append(
            f"{len(old) - len(new)} beats of the cruise fewer, to fit into the tank: {len(new)} "
            f"instead of {len(old)}"
        )
    if abs(new.max() - old.max()) > NEGLIGIBLE_M_S:
        lines.append(f"at most {new.max() * 1e3:.1f} mm/s instead of {old.max() * 1e3:.1f}")
    if len(new) == len(old):
        lines += _differences(new - old)
    if abs(new[-1] - old[-1]) > NEGLIGIBLE_M_S:
        lines.append(f"ends at {end_m_s * 1e3:.1f} mm/s")
    return tuple(lines)


def _differences(difference: F64) -> list[str]:
    lines = []
    apart = np.flatnonzero(np.abs(difference) > NEGLIGIBLE_M_S)
    sign = np.sign(difference)
    breaks = np.flatnonzero((np.diff(apart) > 1) | (np.diff(sign[apart]) != 0)) + 1
    for run in np.split(apart, breaks):
        if run.size:
            most = float(np.abs(difference[run]).max()) * 1e3
            where = f"beat {run[0]}" if run.size == 1 else f"beats {run[0]} to {run[-1]}"
            how = "faster" if sign[run[0]] > 0 else "slower"
            lines.append(f"{where} up to {most:.1f} mm/s {how}")
    return lines
