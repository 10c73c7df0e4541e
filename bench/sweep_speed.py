"""Trials per second of one core: many fish side by side in C against the numpy batch.

One trial = a swim of 40 beats with disturbances, camera and a line through the pictures of each
beat, a thousand fish at a time. The two take turns, each is judged by its best turn in processor
time, so that a busy machine slows neither more than the other.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy_batch import Array, draw, swim

from tailbeat.sweep.recipe import Recipe, parse
from tailbeat.sweep.runner import cores_here, sweep
from tailbeat.sweep.shoal import Shoal

FISH = 1000
BEATS = 40
TURNS = 7
GOAL = 5.0
SCALING_GOAL = 1.9
SWEEP_TURNS = 2
RECIPE = """
iterations = 60
seeds = 250
[[plant]]
kappa_per_m = 10
[[law]]
lead_beats = 1
"""
CELLS = 24


def trials_per_s(work: Callable[[], object], trials: int) -> float:
    """By processor time of this process."""
    begin_s = time.process_time()
    work()
    return trials / (time.process_time() - begin_s)


def compare(works: dict[str, Callable[[], object]], trials: int) -> dict[str, float]:
    """The best of some turns of each, in trials/s."""
    best = dict.fromkeys(works, 0.0)
    for _ in range(TURNS):
        for name, work in works.items():
            best[name] = max(best[name], trials_per_s(work, trials))
    return best


def amplitudes() -> Array:
    """Like those of a fish that has learned the thesis's profile, each a bit different."""
    rng = np.random.default_rng(1)
    slope = np.clip(np.minimum(np.arange(BEATS), np.arange(BEATS)[::-1]) / 10, 0, 1)
    return 0.2 + 0.36 * slope + rng.uniform(-0.02, 0.02, (FISH, BEATS))


def swims() -> dict[str, float]:
    """Of the bare swim, both ways."""
    shoal = Shoal("tank", [{"seed": seed} for seed in range(FISH)])
    amplitude = amplitudes()
    rng = np.random.default_rng(2)
    config = shoal.config(0)
    return compare(
        {
            "shoal": lambda: shoal.swim(amplitude, 1),
            "numpy": lambda: swim(config, amplitude, draw(config, FISH, BEATS, rng)),
        },
        FISH,
    )


def board_recipe() -> Recipe:
    """The board's law on many fish of one kind."""
    recipe = parse(RECIPE, "speed")
    return recipe.with_seeds(recipe.seeds * CELLS)


def sweep_trials_per_s(recipe: Recipe, cores: int) -> float:
    """Of a whole ``tailbeat sweep``: learning, errors and Parquet files included, by the clock on
    the wall; from when every process has done a cell to the last one."""
    done_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        sweep(recipe, Path(folder), cores, progress=lambda d, n: done_s.append(time.perf_counter()))
    per_cell = recipe.seeds * recipe.iterations / CELLS
    return per_cell * (CELLS - cores) / (done_s[-1] - done_s[cores])


def sweeps() -> dict[int, float]:
    """By the number of cores; the best of some turns."""
    recipe = board_recipe()
    best = dict.fromkeys(sorted({1, min(2, cores_here())}), 0.0)
    for _ in range(SWEEP_TURNS):
        for cores in best:
            best[cores] = max(best[cores], sweep_trials_per_s(recipe, cores))
    return best


def main() -> None:
    """Measures and prints."""
    found = swims()
    ratio = found["shoal"] / found["numpy"]
    print(
        f"one core, {FISH} fish at a time: {found['shoal']:.0f} trials/s side by side in C,"
        f" {found['numpy']:.0f} in numpy: {ratio:.1f} x (goal {GOAL:.0f} x)"
    )
    by_cores = sweeps()
    rates = ", ".join(f"{rate:.0f} trials/s on {cores}" for cores, rate in by_cores.items())
    scaling = by_cores.get(2, math.nan) / by_cores[1]
    print(
        f"tailbeat sweep, the board's law: {rates}: {by_cores[1] / found['numpy']:.1f} x numpy "
        f"(goal {GOAL:.0f} x), {scaling:.2f} x on two cores (goal {SCALING_GOAL} x)"
    )


if __name__ == "__main__":
    main()
