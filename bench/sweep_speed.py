"""Trials per second of one core: many fish side by side in C against the numpy batch.

One trial = a swim of 40 beats with disturbances, camera and a line through the pictures of each
beat, a thousand fish at a time. The two take turns, each is judged by its best turn in processor
time, so that a busy machine slows neither more than the other.

Two cores share caches, memory and the clock of the processor: what the machine itself gives on two
is measured with processes that only swim, and stands beside the sweep's.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy_batch import Array, draw, swim

from tailbeat.core.platform.programs import cores_here
from tailbeat.studies.montecarlo.batch import FishBatch
from tailbeat.studies.montecarlo.recipe import Recipe, parse
from tailbeat.studies.montecarlo.runner import run_study

BEATS = 40
GOAL = 20.0
SUBSTEPS = 200  # of a beat
PROGRAM = Path("build/bench/tailbeat_bench")
SCALING_GOAL = 1.9
RECIPE = """
iterations = {iterations}
seeds = {seeds}
[[plant]]
kappa_per_m = 10
[[law]]
lead_beats = 1
"""


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    fish: int
    turns: int
    sweep_turns: int
    bare_swims: int
    iterations: int
    seeds: int  # of a cell of the sweep
    cells: int
    cores: int


FULL = Load(
    fish=1000, turns=5, sweep_turns=2, bare_swims=15, iterations=12, seeds=250, cells=24, cores=2
)  # fmt: skip


def trials_per_s(work: Callable[[], object], trials: int) -> float:
    """By processor time of this process, whose clock may tick as slowly as that of the system."""
    tick_s = time.get_clock_info("process_time").resolution
    begin_s = time.process_time()
    work()
    return trials / max(time.process_time() - begin_s, tick_s)


def compare(works: dict[str, Callable[[], object]], trials: int, turns: int) -> dict[str, float]:
    """The best of some turns of each, in trials/s."""
    best = dict.fromkeys(works, 0.0)
    for _ in range(turns):
        for name, work in works.items():
            best[name] = max(best[name], trials_per_s(work, trials))
    return best


def amplitudes(fish: int) -> Array:
    """Like those of a fish that has learned the thesis's profile, each a bit different."""
    rng = np.random.default_rng(1)
    slope = np.clip(np.minimum(np.arange(BEATS), np.arange(BEATS)[::-1]) / 10, 0, 1)
    return 0.2 + 0.36 * slope + rng.uniform(-0.02, 0.02, (fish, BEATS))


def swims(load: Load) -> dict[str, float]:
    """Of the bare swim, both ways."""
    batch = FishBatch("tank", [{"seed": seed} for seed in range(load.fish)])
    amplitude = amplitudes(load.fish)
    rng = np.random.default_rng(2)
    config = batch.config(0)
    return compare(
        {
            "batch": lambda: batch.run(amplitude, 1),
            "numpy": lambda: swim(config, amplitude, draw(config, load.fish, BEATS, rng)),
        },
        load.fish,
        load.turns,
    )


def divider_trials_per_s() -> float:
    """No batch is faster: a substep has a quotient and a root, for which the processor's divider
    takes its time, at best with full vector registers."""
    run = subprocess.run([PROGRAM, "divider"], capture_output=True, text=True, check=True)
    return 1e9 / (float(run.stdout.split()[0]) * SUBSTEPS * BEATS)


def board_recipe(load: Load) -> Recipe:
    """The board's law on many fish of one kind."""
    text = RECIPE.format(iterations=load.iterations, seeds=load.seeds)
    return parse(text, "speed").with_seeds(load.seeds * load.cells)


def sweep_trials_per_s(recipe: Recipe, cells: int, cores: int) -> float:
    """Of a whole ``tailbeat sim montecarlo``: learning, errors and Parquet files included, by the
    clock on the wall; from when every process has done a cell to the last one."""
    done_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        run_study(
            recipe, Path(folder), cores, progress=lambda d, n: done_s.append(time.perf_counter())
        )
    per_cell = recipe.seeds * recipe.iterations / cells
    return per_cell * (cells - cores) / (done_s[-1] - done_s[cores])


def swim_bare(fish: int, swims: int, together: Any, rates: Any) -> None:
    """In a process of its own: puts its trials/s by the clock on the wall into ``rates``."""
    batch = FishBatch("tank", [{"seed": seed} for seed in range(fish)])
    amplitude = amplitudes(fish)
    batch.run(amplitude, 1)
    together.wait()
    begin_s = time.perf_counter()
    for number in range(swims):
        batch.run(amplitude, number + 2)
    rates.put(fish * swims / (time.perf_counter() - begin_s))


def bare_trials_per_s(load: Load, processes: int) -> float:
    """Of processes that swim side by side and do nothing else."""
    context = get_context("spawn")
    together, rates = context.Barrier(processes), context.Queue()
    workers = [
        context.Process(
            target=swim_bare, args=(load.fish, load.bare_swims, together, rates), daemon=True
        )
        for _ in range(processes)
    ]
    for worker in workers:
        worker.start()
    total = sum(rates.get() for _ in workers)
    for worker in workers:
        worker.join()
    return float(total)


def by_cores(works: dict[str, Callable[[int], float]], load: Load) -> dict[str, dict[int, float]]:
    """The best of some turns of each, by the number of cores."""
    best = {name: dict.fromkeys(sorted({1, min(load.cores, cores_here())}), 0.0) for name in works}
    for _ in range(load.sweep_turns):
        for name, rates in best.items():
            for cores in rates:
                rates[cores] = max(rates[cores], works[name](cores))
    return best


def scaling(rates: dict[int, float]) -> float:
    """Two cores over one; NaN on a machine with one."""
    return rates.get(2, math.nan) / rates[1]


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    found = swims(load)
    ratio = found["batch"] / found["numpy"]
    limit = divider_trials_per_s() / found["numpy"]
    print(
        f"one core, {load.fish} fish at a time: {found['batch']:.0f} trials/s side by side in C,"
        f" {found['numpy']:.0f} in numpy: {ratio:.1f} x (goal {GOAL:.0f} x; limit, by a quotient"
        f" and a root per substep: {limit:.0f} x, {limit / ratio:.1f} x of this)"
    )
    recipe = board_recipe(load)
    best = by_cores(
        {
            "sweep": lambda cores: sweep_trials_per_s(recipe, load.cells, cores),
            "bare": lambda cores: bare_trials_per_s(load, cores),
        },
        load,
    )
    rates = ", ".join(f"{rate:.0f} trials/s on {cores}" for cores, rate in best["sweep"].items())
    print(
        f"tailbeat sim montecarlo, the board's law: {rates}: "
        f"{best['sweep'][1] / found['numpy']:.1f} x numpy"
        f" (goal {GOAL:.0f} x; limit as above),"
        f" {scaling(best['sweep']):.2f} x on two cores (goal {SCALING_GOAL} x;"
        f" processes that only swim: {scaling(best['bare']):.2f} x on this machine)"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
