"""One piece of a Monte Carlo study: some seeds of one plant, law, noise and corner. A pure function
of both."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core import reference as references
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.learning.error_bound import error_bound
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.feasible import suggest
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.studies.montecarlo import learners
from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch, executed, parse_lengths
from tailbeat.studies.montecarlo.learners import ROLLED_BACK, BatchLearner, BatchReport
from tailbeat.studies.montecarlo.recipe import (
    REFERENCE_IDENTIFIED,
    REFERENCES_FEASIBLE,
    Corner,
    LawSpec,
    Recipe,
    SimSettings,
)
from tailbeat.studies.montecarlo.results import FAILED, arrow, schema

if TYPE_CHECKING:
    import pyarrow as pa

_CHUNKS = {"p": 250, "repeats": 250, "design": 5, "model": 5}  # each some seconds of work at most
_BOUNDS = (
    "amplitude_min_rad", "amplitude_max_rad", "step_rad",
    "true_min_m_s", "true_max_m_s", "travel_m",
)  # fmt: skip
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
                chunk = recipe.chunk or _CHUNKS[law.kind]
                for corner in recipe.corners if law.corners else [Corner()]:
                    for first in range(recipe.first_seed, last, chunk):
                        seeds = tuple(range(first, min(first + chunk, last)))
                        found.append(Cell(len(found), plant, law, noise, corner, seeds))
    return found


def run_cell(recipe: Recipe, cell: Cell) -> pa.Table:
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


def _run(recipe: Recipe, cell: Cell, phases: Phases) -> pa.Table:
    """All of its fish; one by one when something is wrong with one of them."""
    try:
        return _trials(recipe, cell, phases)
    except (TailbeatError, ArithmeticError, ValueError) as error:
        if len(cell.seeds) > 1:
            alone = [_run(recipe, replace(cell, seeds=(seed,)), phases) for seed in cell.seeds]
            return arrow().concat_tables(alone).combine_chunks()
        return _failed(cell, phases, error)
    except Exception as error:
        error.add_note(f"in cell {cell.label}, seeds {cell.seeds[0]} to {cell.seeds[-1]}")
        raise


def _trials(recipe: Recipe, cell: Cell, phases: Phases) -> pa.Table:
    fish = [{**cell.plant.values, **cell.noise.values, "seed": seed} for seed in cell.seeds]
    batch = FishBatch(cell.plant.plant, fish)
    rows = _Rows(cell)
    learner = _learner(recipe, cell, fish, phases[0][0])
    spread = parse_lengths(cell.noise.lengths)
    number = 0
    for ground, iterations in phases:
        learner.begin(ground.reference)
        rows.begin(ground, learner.floor_m_s)
        for _ in range(iterations):
            number += 1
            amplitude = learner.following()
            reached = executed(spread, cell.seeds, number, ground.reference.beats)
            swims = batch.run(amplitude, number, ground.reference.beat_s).cut(reached)
            said = learner.learn(swims)
            rows.add(amplitude, swims, reached, said, learner.floor_m_s, recipe.amplitude_max_rad)
    return rows.table()


def _failed(cell: Cell, phases: Phases, error: Exception) -> pa.Table:
    message = error.message if isinstance(error, TailbeatError) else f"{error!r}"
    rows = _Rows(cell)
    for ground, iterations in phases:
        rows.failed(ground, iterations, " ".join(message.split()))
    return rows.table()


@dataclass(frozen=True)
class _Ground:
    """What a plant and a reference are to each other."""

    reference: Reference
    floor_minimax_m_s: float
    floor_lsq_m_s: float
    near_optimal_rad: F64


Phases = list[tuple[_Ground, int]]  # what is learned one after the other, each for so many swims


def _ground_of(recipe: Recipe, cell: Cell, reference: str) -> _Ground:
    values = cell.plant.values
    if reference == REFERENCE_IDENTIFIED:
        values = values | cell.noise.values
    return _ground(
        cell.plant.plant, tuple(sorted(values.items())), reference, recipe.amplitude_max_rad
    )


@lru_cache(maxsize=64)
def _ground(
    plant: str, values: tuple[tuple[str, float], ...], name: str, amplitude_max_rad: float
) -> _Ground:
    config = plant_config(plant, dict(values))
    wanted = _reference(plant, dict(values), name, amplitude_max_rad)
    found = error_bound(config, wanted, amplitude_max_rad)
    return _Ground(
        wanted,
        found.minimax_m_s,
        found.lsq_max_abs_m_s,
        found.lsq_input.astype(np.float64),
    )


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


def _learner(
    recipe: Recipe, cell: Cell, fish: list[dict[str, float]], ground: _Ground
) -> BatchLearner:
    spec, most = cell.law, recipe.amplitude_max_rad
    if spec.kind == "repeats":
        return learners.FixedInput(ground.near_optimal_rad, len(fish))
    if spec.kind == "p":
        past = learners.PastKind(spec.past, spec.window)
        return learners.BoardLaw(
            [learners.law_of(spec, most)] * len(fish), spec.rollback_ratio, past
        )
    beat_s = ground.reference.beat_s
    identified = [
        learners.identify(cell.plant.plant, _at_corner(one, cell), most, beat_s) for one in fish
    ]
    if spec.kind == "design":
        return learners.DesignedLaw(identified, spec, most)
    return learners.ModelBasedLaw(identified, learners.law_of(spec, most), most)


def _at_corner(fish: dict[str, float], cell: Cell) -> dict[str, float]:
    """The fish that is identified."""
    config = plant_config(cell.plant.plant, fish)
    corner = cell.corner
    return fish | {
        "kappa_per_m": config.kappa_per_m * corner.kappa_factor,
        "slope_m_s_rad": config.slope_m_s_rad * corner.slope_factor,
        "dead_zone_rad": config.dead_zone_rad * corner.dead_zone_factor,
        "delay_s": max(0.0, config.delay_s + corner.delay_add_s),
    }


class _Rows:
    """Collects columns of shape (iterations, fish)."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.fish = len(cell.seeds)
        self.kappa_per_m = float(plant_config(cell.plant.plant, cell.plant.values).kappa_per_m)
        self.columns: dict[str, list[Any]] = {name: [] for name in schema().names}

    def begin(self, ground: _Ground, predicted_floor_m_s: F64) -> None:
        """Iteration 0: the zero input, which is not swum; its error is the reference."""
        self.ground = ground
        self.predicted_floor_m_s = predicted_floor_m_s
        self.iteration = 0
        wanted = ground.reference.speed_m_s.astype(np.float64)
        still = np.tile(np.abs(wanted), (self.fish, 1))
        self._errors(still, still)
        self._before = np.zeros_like(still)
        self._made_by_law = np.zeros(self.fish, dtype=bool)
        self._bounds(self._before, self._step(self._before), self._before, ground.reference.beats)
        self._said(BatchReport.nothing(self.fish), np.zeros(self.fish, dtype=np.int64))

    def add(
        self,
        amplitude: F64,
        swims: BatchTrials,
        executed: NDArray[np.int64],
        said: BatchReport,
        floor_m_s: F64,
        amplitude_max_rad: float,
    ) -> None:
        """A trial swum for ``executed`` beats; ``floor_m_s``: as it was predicted before."""
        self.iteration += 1
        self.predicted_floor_m_s = floor_m_s
        wanted = self.ground.reference.speed_m_s.astype(np.float64)
        self._errors(wanted - swims.speed_m_s, wanted - swims.true_m_s)
        self._bounds(amplitude, self._step(amplitude), swims.true_m_s, executed)
        self._before = amplitude
        self._made_by_law = np.broadcast_to(np.array(said.verdict) != ROLLED_BACK, self.fish)
        at_limit = amplitude >= np.float32(amplitude_max_rad) * (1 - 1e-7)
        self._said(said, at_limit.sum(axis=1))

    def failed(self, ground: _Ground, iterations: int, why: str) -> None:
        """Nothing is known of any trial."""
        nothing = np.full(self.fish, np.nan)
        said = BatchReport.nothing(self.fish)
        said.verdict = FAILED
        self.ground = ground
        self.predicted_floor_m_s = nothing
        for self.iteration in range(iterations + 1):
            self._put(
                max_abs_error_m_s=nothing,
                ratio=nothing,
                rms_error_m_s=nothing,
                true_max_abs_error_m_s=nothing,
                true_rms_error_m_s=nothing,
                measured_beats=0,
                executed_beats=0,
                **dict.fromkeys(_BOUNDS, nothing),
            )
            self._said(said, np.zeros(self.fish, dtype=np.int64), why)

    def _errors(self, error: F64, true: F64) -> None:
        known = np.isfinite(error)
        count = known.sum(axis=1)
        squares = np.where(known, error, 0.0) ** 2
        highest = np.sqrt(squares.max(axis=1))
        nothing = count == 0
        largest = np.where(nothing, np.nan, highest)
        before = self.columns["max_abs_error_m_s"]
        ratio = largest / before[-1] if self.iteration > 0 else np.full(self.fish, np.nan)
        rms = np.sqrt(squares.sum(axis=1) / np.where(nothing, 1, count))
        self._put(
            max_abs_error_m_s=largest,
            ratio=ratio,
            rms_error_m_s=np.where(nothing, np.nan, rms),
            true_max_abs_error_m_s=np.abs(true).max(axis=1),
            true_rms_error_m_s=np.sqrt(np.mean(true**2, axis=1)),
            measured_beats=count,
        )

    def _step(self, amplitude: F64) -> F64:
        """Largest change of a beat that the law made; 0 for the first amplitudes and for those that
        were brought back."""
        change: F64 = np.abs(amplitude - self._before).max(axis=1)
        return np.where(self._made_by_law, change, 0.0)

    def _bounds(
        self, amplitude: F64, step: F64, true: F64, executed: NDArray[np.int64] | int
    ) -> None:
        reached = np.arange(true.shape[1]) < np.broadcast_to(executed, self.fish)[:, None]
        self._put(
            executed_beats=executed,
            amplitude_min_rad=amplitude.min(axis=1),
            amplitude_max_rad=amplitude.max(axis=1),
            step_rad=step,
            true_min_m_s=true.min(axis=1),
            true_max_m_s=true.max(axis=1),
            travel_m=(true * reached).sum(axis=1) * self.ground.reference.beat_s,
        )

    def _said(self, said: BatchReport, saturated: NDArray[np.int64], failure: str = "") -> None:
        low, middle, high = said.predicted_m_s
        self._put(
            saturated_beats=saturated,
            predicted_low_m_s=low,
            predicted_max_abs_error_m_s=middle,
            predicted_high_m_s=high,
            ratio_low=said.ratio[0],
            ratio_high=said.ratio[1],
            gain_rad_s_m=said.gain_rad_s_m,
            lead_beats=said.lead_beats,
            swum_law=said.law,
            verdict=said.verdict,
            failure=failure,
            predicted_floor_m_s=self.predicted_floor_m_s,
            iteration=self.iteration,
            seed=self.cell.seeds,
            plant=self.cell.plant.name,
            law=self.cell.law.name,
            noise=self.cell.noise.name,
            corner=self.cell.corner.name,
            reference=self.ground.reference.name,
            kappa_per_m=self.kappa_per_m,
            floor_minimax_m_s=self.ground.floor_minimax_m_s,
            floor_lsq_m_s=self.ground.floor_lsq_m_s,
        )

    def _put(self, **columns: Any) -> None:
        for name, values in columns.items():
            self.columns[name].append(values)

    def table(self) -> pa.Table:
        """Fish by fish, in the order of the iterations."""
        arrays = [self._column(field) for field in schema()]
        return arrow().table(arrays, schema=schema())

    def _column(self, field: pa.Field) -> pa.Array:
        types = arrow()
        rows = self.columns[field.name]
        if field.type != types.string():
            grid = np.array([np.broadcast_to(row, self.fish) for row in rows])
            return types.array(grid.T.ravel(), type=field.type)
        codes: dict[str, int] = {}
        numbers = [
            np.broadcast_to(
                [
                    codes.setdefault(word, len(codes))
                    for word in ([row] if isinstance(row, str) else row)
                ],
                self.fish,
            )
            for row in rows
        ]
        indices = types.array(np.array(numbers, dtype=np.int32).T.ravel())
        return types.DictionaryArray.from_arrays(indices, list(codes)).cast(types.string())
