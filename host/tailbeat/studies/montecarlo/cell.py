"""One piece of a Monte Carlo study: some seeds of one plant, law, noise and corner. A pure function
of both."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core import reference as references
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.learning.error_bound import ErrorBound, error_bound, suggest
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan
from tailbeat.studies.montecarlo import learners
from tailbeat.studies.montecarlo.batch import QUIET_TRIAL, BatchTrials, batch_of, is_foreign
from tailbeat.studies.montecarlo.learners import ROLLED_BACK, BatchLearner, Columns
from tailbeat.studies.montecarlo.populations import draw, still
from tailbeat.studies.montecarlo.recipe import (
    REFERENCE_IDENTIFIED,
    REFERENCES_FEASIBLE,
    Corner,
    LawSpec,
    Recipe,
    SimSettings,
)
from tailbeat.studies.montecarlo.results import FAILED, Table, pyarrow, schema
from tailbeat.studies.montecarlo.smallest_error import smallest_errors

FIRST_TRIAL = 9  # of a population: the trials before are the identification's, which drifts, too
_CHUNKS = {"p": 250, "repeats": 250, "design": 5, "model": 5}  # each some seconds of work at most
_CORNERS = {  # what a plant has for slope and dead zone; speed goes with the depth of the fin
    "tank": ("slope_m_s_rad", "dead_zone_rad"), "reactive": ("fin_depth_m", "servo_backlash_rad"),
}  # fmt: skip
_ANOTHER_SEED = 0  # of the fish that a reference is made for: one of those that learn, but not them


@dataclass(frozen=True)
class Cell:
    """``index``: its place in the results. ``seeds``: of its fish."""

    index: int
    plant: SimSettings
    law: LawSpec
    noise: SimSettings
    corner: Corner
    seeds: tuple[int, ...]

    @property
    def label(self) -> str:
        """For a file name; sorts like ``index``."""
        words = (self.plant.name, self.law.name, self.noise.name, self.corner.name)
        text = re.sub(r"[^a-z0-9.]+", "-", " ".join(words).lower()).strip("-")
        return f"{self.index:05d}-{text[:80]}"


def cells(recipe: Recipe) -> list[Cell]:
    """All of a recipe."""
    found: list[Cell] = []
    last = recipe.first_seed + recipe.seeds
    for plant in recipe.plants:
        for noise in recipe.noises:
            for law in recipe.laws:
                own = plant.each_its_own and recipe.reference == REFERENCE_IDENTIFIED
                chunk = 1 if own else recipe.chunk or _CHUNKS[law.kind]
                for corner in recipe.corners if law.corners else [Corner()]:
                    for first in range(recipe.first_seed, last, chunk):
                        seeds = tuple(range(first, min(first + chunk, last)))
                        found.append(Cell(len(found), plant, law, noise, corner, seeds))
    return found


def run_cell(recipe: Recipe, cell: Cell) -> Table:
    """A table of ``results.schema()``: a row per fish and iteration, fish by fish.

    A fish that cannot be identified or taught does not end a study: its rows are NaN, their verdict
    is ``FAILED`` and ``failure`` says why. Raises InputError when there is no such reference.
    """
    names = [(recipe.reference, recipe.iterations)]
    if recipe.before and not cell.law.cold:
        names.insert(0, (recipe.before, recipe.before_iterations))
    try:
        phases = [(_ground_of(recipe, cell, name), count) for name, count in names]
    except InputError as error:
        raise InputError(f"plant {cell.plant.name}: {error.message}", error.remedy) from error
    return _run(recipe, cell, phases)


def _run(recipe: Recipe, cell: Cell, phases: Phases) -> Table:
    """All of its fish; one by one when something is wrong with one of them."""
    try:
        return _trials(recipe, cell, phases)
    except (TailbeatError, ArithmeticError, ValueError) as error:
        if len(cell.seeds) > 1:
            alone = [_run(recipe, replace(cell, seeds=(seed,)), phases) for seed in cell.seeds]
            return pyarrow.concat_tables(alone).combine_chunks()
        return _failed(recipe, cell, phases, error)
    except Exception as error:
        error.add_note(f"in cell {cell.label}, seeds {cell.seeds[0]} to {cell.seeds[-1]}")
        raise


def _trials(recipe: Recipe, cell: Cell, phases: Phases) -> Table:
    fish = [_fish_of(cell, seed) for seed in cell.seeds]
    batch = batch_of(cell.plant.plant, fish)
    rows = _Rows(recipe, cell, fish)
    learner = _LEARNERS[cell.law.kind](recipe, cell, fish, phases[0][0])
    number = FIRST_TRIAL - 1 if cell.plant.each_its_own else 0
    for ground, iterations in phases:
        reference = ground.reference
        learner.begin(reference)
        rows.begin(ground, learner.bound_m_s)
        for _ in range(iterations):
            number += 1
            amplitude = learner.following()
            reached = cell.noise.executed(cell.seeds, number, reference.beats)
            trials = batch.run(amplitude, number, reference.beat_s).cut(reached)
            rows.judge(amplitude, number)
            report = learner.learn(trials) | {"predicted_floor_m_s": learner.bound_m_s}
            rows.add(amplitude, trials, reached, report)
    rows.own_bounds()
    return rows.table()


def _failed(recipe: Recipe, cell: Cell, phases: Phases, error: Exception) -> Table:
    message = error.message if isinstance(error, TailbeatError) else f"{error!r}"
    rows = _Rows(recipe, cell, [_fish_of(cell, seed) for seed in cell.seeds])
    for ground, iterations in phases:
        rows.failed(ground, iterations, " ".join(message.split()))
    return rows.table()


def _fish_of(cell: Cell, seed: int) -> dict[str, float]:
    plant = cell.plant
    drawn = draw(plant.population, plant.plant, seed) if plant.population else {}
    return {**drawn, **plant.values, **cell.noise.values, "seed": seed}


def _kappa_per_m(cell: Cell, fish: dict[str, float]) -> float:
    """NaN: nobody knows."""
    if is_foreign(cell.plant.plant):
        return np.nan
    return float(plant_config(cell.plant.plant, fish).kappa_per_m)


def _smallest_errors(
    recipe: Recipe,
    cell: Cell,
    fish: dict[str, float],
    reference: Reference,
    trials: Sequence[int],
    more: Sequence[F64] = (),
) -> tuple[F64, F64]:
    """(the fish's smallest error as it has drifted at each of ``trials``, the best input of the
    first): from the inputs of two plain fish models and ``more``, later ones from the one before.
    """
    wanted, most = reference.speed_m_s.astype(np.float64), recipe.amplitude_max_rad
    kappa_per_m = _kappa_per_m(cell, fish)
    kappa_per_m = 10.0 if np.isnan(kappa_per_m) else kappa_per_m
    plain = [FishModel(kappa_per_m, 0.13, 0.1, 0.2), FishModel(kappa_per_m, 0.18, 0.15, 0.4)]
    starts = [plan(model, wanted, reference.beat_s, most).amplitude_rad for model in plain]
    plant, beat_s = cell.plant.plant, reference.beat_s
    return smallest_errors(plant, fish, wanted, beat_s, most, [*more, *starts], trials)


@dataclass(frozen=True)
class _Ground:
    """What a plant and a reference are to each other. ``bound``: None where every fish has its
    own."""

    reference: Reference
    bound: ErrorBound | None


Fish = list[dict[str, float]]
Phases = list[tuple[_Ground, int]]  # what is learned one after the other, each for so many trials


def _ground_of(recipe: Recipe, cell: Cell, reference: str) -> _Ground:
    if cell.plant.each_its_own:
        return _Ground(_own_reference(recipe, cell, reference), None)
    noise = cell.noise.values if reference == REFERENCE_IDENTIFIED else {}
    values = cell.plant.values | noise
    return _ground(
        cell.plant.plant, tuple(sorted(values.items())), reference, recipe.amplitude_max_rad
    )


def _own_reference(recipe: Recipe, cell: Cell, name: str) -> Reference:
    """Of a population: a feasible one is that of the only fish of the cell, as identified."""
    if name not in REFERENCES_FEASIBLE:
        return references.from_text(name)
    if name != REFERENCE_IDENTIFIED:
        raise InputError(
            "fish that all differ have no feasible reference in common.",
            f'Give one that is fixed, or "{REFERENCE_IDENTIFIED}", each fish\'s own.',
        )
    thesis, most = references.thesis(), recipe.amplitude_max_rad
    fish = _fish_of(cell, cell.seeds[0])
    try:
        known = learners.identify(cell.plant.plant, fish, most, thesis.beat_s, 1)
    except TailbeatError:
        return thesis  # its learner fails for the same reason, which the fish's rows say
    return suggest(known, thesis, most).reference


@lru_cache(maxsize=64)
def _ground(
    plant: str, values: tuple[tuple[str, float], ...], name: str, amplitude_max_rad: float
) -> _Ground:
    config = plant_config(plant, dict(values))
    reference = _reference(plant, dict(values), name, amplitude_max_rad)
    return _Ground(reference, error_bound(config, reference, amplitude_max_rad))


def _reference(
    plant: str, values: dict[str, float], name: str, amplitude_max_rad: float
) -> Reference:
    if name not in REFERENCES_FEASIBLE:
        return references.from_text(name)
    thesis = references.thesis()
    fish: FishModel | Identified
    if name == REFERENCE_IDENTIFIED:
        another = values | {"seed": _ANOTHER_SEED}
        fish = learners.identify(plant, another, amplitude_max_rad, thesis.beat_s)
    else:
        config = plant_config(plant, values)
        fish = FishModel(
            config.kappa_per_m, config.slope_m_s_rad, config.dead_zone_rad, config.delay_s
        )
    return suggest(fish, thesis, amplitude_max_rad).reference


def _fixed(recipe: Recipe, cell: Cell, fish: Fish, ground: _Ground) -> BatchLearner:
    if ground.bound is not None:
        return learners.FixedInput(ground.bound.lsq_input.astype(np.float64), len(fish))
    best = [_smallest_errors(recipe, cell, one, ground.reference, [FIRST_TRIAL])[1] for one in fish]
    return learners.FixedInput(np.array(best), len(fish))


def _board(recipe: Recipe, cell: Cell, fish: Fish, ground: _Ground) -> BatchLearner:
    spec = cell.law
    laws = [learners.law_of(spec, recipe.amplitude_max_rad)] * len(fish)
    return learners.BoardLaw(laws, spec.rollback_ratio, spec.past, spec.window)


def _identified(recipe: Recipe, cell: Cell, fish: Fish, ground: _Ground) -> BatchLearner:
    most, beat_s = recipe.amplitude_max_rad, ground.reference.beat_s
    first = 1 if cell.plant.each_its_own else learners.FIRST_RUN
    known = [
        learners.identify(cell.plant.plant, _at_corner(one, cell), most, beat_s, first)
        for one in fish
    ]
    return _BY_MODEL[cell.law.kind](known, cell.law, most)


_BY_MODEL = {"design": learners.DesignedLaw, "model": learners.ModelBasedLaw}
_LEARNERS = {"p": _board, "repeats": _fixed, "design": _identified, "model": _identified}


def _at_corner(fish: dict[str, float], cell: Cell) -> dict[str, float]:
    """The fish that is identified."""
    if not cell.law.corners:
        return fish
    config = plant_config(cell.plant.plant, fish)
    corner = cell.corner
    slope, dead_zone = _CORNERS.get(cell.plant.plant, _CORNERS["tank"])
    return fish | {
        "kappa_per_m": config.kappa_per_m * corner.kappa_factor,
        slope: getattr(config, slope) * corner.slope_factor,
        dead_zone: getattr(config, dead_zone) * corner.dead_zone_factor,
        "delay_s": max(0.0, config.delay_s + corner.delay_add_s),
    }


class _Rows:
    """Collects columns of shape (iterations, fish)."""

    def __init__(self, recipe: Recipe, cell: Cell, fish: Fish) -> None:
        self.recipe, self.cell, self.each = recipe, cell, fish
        self.amplitude_max_rad = recipe.amplitude_max_rad
        self.fish = len(cell.seeds)
        self.kappa_per_m = np.array([_kappa_per_m(cell, one) for one in fish])
        self._best = [(np.inf, np.zeros(0))] * len(fish)
        self._judged: Columns = {}
        self.rows: list[dict[str, Any]] = []

    def begin(self, ground: _Ground, bound_m_s: F64) -> None:
        """Iteration 0: the zero input, which is not executed; its error is the reference."""
        self.ground = ground
        self.iteration = -1
        self.wanted = ground.reference.speed_m_s.astype(np.float64)
        self._largest: F64 = np.full(self.fish, np.nan)
        still = np.tile(np.abs(self.wanted), (self.fish, 1))
        nothing = np.zeros_like(still)
        self._before, self._made_by_law = nothing, np.zeros(self.fish, dtype=bool)
        self._put(
            self._errors(still, still)
            | self._bounds(nothing, nothing, np.full(self.fish, ground.reference.beats))
            | {"predicted_floor_m_s": bound_m_s}
        )

    def add(
        self,
        amplitude: F64,
        trials: BatchTrials,
        executed: NDArray[np.int64],
        report: Columns,
    ) -> None:
        """A trial executed for ``executed`` beats."""
        at_limit = amplitude >= np.float32(self.amplitude_max_rad) * (1 - 1e-7)
        self._put(
            self._judged
            | self._errors(self.wanted - trials.speed_m_s, self.wanted - trials.true_m_s)
            | self._bounds(amplitude, trials.true_m_s, executed)
            | report
            | {"saturated_beats": at_limit.sum(axis=1)}
        )
        self._before = amplitude
        verdict = np.array(report.get("verdict", ""))
        self._made_by_law = np.broadcast_to(verdict != ROLLED_BACK, self.fish)

    def judge(self, amplitude: F64, number: int) -> None:
        """What the next trial's inputs would do without noise, where each fish has its own bound,
        and the best of them so far."""
        if self.ground.bound is not None:
            return
        plant = self.cell.plant.plant
        batch = batch_of(plant, [still(one) for one in self.each])
        number = QUIET_TRIAL if is_foreign(plant) else number
        true = batch.run(amplitude, number, self.ground.reference.beat_s).true_m_s
        error = np.abs(self.wanted - true).max(axis=1)
        self._judged = {"input_max_abs_error_m_s": error}
        for i, (size, row) in enumerate(zip(error, amplitude, strict=True)):
            self._best[i] = min(self._best[i], (float(size), row), key=lambda one: one[0])

    def failed(self, ground: _Ground, iterations: int, why: str) -> None:
        """Nothing is known of any trial."""
        self.ground = ground
        self.iteration = -1
        for _ in range(iterations + 1):
            self._put({"verdict": FAILED, "failure": why})

    def _errors(self, error: F64, true: F64) -> Columns:
        known = np.isfinite(error)
        count = known.sum(axis=1)
        squares = np.where(known, error, 0.0) ** 2
        largest = np.where(count == 0, np.nan, np.sqrt(squares.max(axis=1)))
        rms = np.sqrt(squares.sum(axis=1) / np.where(count == 0, 1, count))
        before, self._largest = self._largest, largest
        return {
            "max_abs_error_m_s": largest,
            "ratio": largest / before,
            "rms_error_m_s": np.where(count == 0, np.nan, rms),
            "true_max_abs_error_m_s": np.abs(true).max(axis=1),
            "true_rms_error_m_s": np.sqrt(np.mean(true**2, axis=1)),
            "measured_beats": count,
        }

    def _bounds(self, amplitude: F64, true: F64, executed: NDArray[np.int64]) -> Columns:
        """``step_rad``: the largest change of a beat that the law made; 0 for the first amplitudes
        and for those that were brought back."""
        reached = np.arange(true.shape[1]) < executed[:, None]
        change = np.abs(amplitude - self._before).max(axis=1)
        return {
            "executed_beats": executed,
            "amplitude_min_rad": amplitude.min(axis=1),
            "amplitude_max_rad": amplitude.max(axis=1),
            "step_rad": np.where(self._made_by_law, change, 0.0),
            "true_min_m_s": true.min(axis=1),
            "true_max_m_s": true.max(axis=1),
            "travel_m": (true * reached).sum(axis=1) * self.ground.reference.beat_s,
        }

    def _put(self, columns: Columns) -> None:
        """The next row; what is not given is NaN, 0 or empty."""
        self.iteration += 1
        cell, ground = self.cell, self.ground
        names = {key: getattr(cell, key).name for key in ("plant", "law", "noise", "corner")}
        bound = ground.bound
        floors = {} if bound is None else {
            "floor_minimax_m_s": bound.minimax_m_s, "floor_lsq_m_s": bound.lsq_max_abs_m_s,
        }  # fmt: skip
        self.rows.append(
            columns | names | floors | {
                "iteration": self.iteration,
                "seed": cell.seeds,
                "reference": ground.reference.name,
                "kappa_per_m": self.kappa_per_m,
            }
        )  # fmt: skip

    def own_bounds(self) -> None:
        """Each fish's own smallest error at each trial, from the law's best input among other
        starts."""
        if self.ground.bound is not None:
            return
        trials = range(FIRST_TRIAL, FIRST_TRIAL + len(self.rows) - 1)
        found = np.array([
            _smallest_errors(self.recipe, self.cell, fish, self.ground.reference, trials, [best])[0]
            for fish, (_, best) in zip(self.each, self._best, strict=True)
        ])  # fmt: skip
        for row, bounds in zip(self.rows, [found[:, 0], *found.T], strict=True):
            row["floor_minimax_m_s"] = np.fmin(bounds, row.get("input_max_abs_error_m_s", np.inf))

    def table(self) -> Table:
        """Fish by fish, in the order of the iterations."""
        defaults = {pyarrow.string(): "", pyarrow.int64(): 0, pyarrow.float64(): np.nan}
        arrays = []
        for column in schema():
            rows = [row.get(column.name, defaults[column.type]) for row in self.rows]
            values = np.array([np.broadcast_to(row, self.fish) for row in rows]).T.ravel()
            arrays.append(pyarrow.array(values, type=column.type))
        return pyarrow.table(arrays, schema=schema())
