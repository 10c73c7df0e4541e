"""Whether a beat's sigma is honest when only the IMU knows the speed (SPD_SOURCE 2).

Each level is a sensor and a hand with other flaws; every swim has a seed of its own, drawn afresh
unless one is given. Intervals are of 95 %, by drawing swims again. Exits with 1 when a goal is
missed.

Usage: imu_coverage.py [FIRST_SEED]
"""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PROGRAM = Path("build/bench/imu_coverage")
PLANTS = ("tank", "reactive")
LEVELS = 5
RECORDED_LEVEL = LEVELS
RESAMPLES = 2000
COVERED, SIGMA_OVER_RMS = (0.90, 0.99), 1.5


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    swims: int


FULL = Load(300)


@dataclass(frozen=True)
class Figures:
    """Of the swims of one level; speeds in mm/s. Shape (swims, beats), NaN where unmeasured."""

    level: str
    error: NDArray[np.float64]
    sigma: NDArray[np.float64]

    def rms(self) -> float:
        """Root of the mean squared error of a beat."""
        return float(np.sqrt(np.nanmean(self.error**2)))

    def covered(self) -> tuple[float, float, float]:
        """Share of the beats within two sigma, and its 95 % interval."""
        within = (np.abs(self.error) <= 2 * self.sigma).sum(axis=1)
        measured = np.isfinite(self.error).sum(axis=1)
        draws = np.random.default_rng(0).integers(len(within), size=(RESAMPLES, len(within)))
        shares = within[draws].sum(axis=1) / measured[draws].sum(axis=1)
        low, high = np.quantile(shares, (0.025, 0.975))
        return float(within.sum() / measured.sum()), float(low), float(high)


def swim(plant: str, level: int, first_seed: int, swims: int) -> Figures:
    """Runs the program; every swim counts, also one whose beats are all unmeasured."""
    command = [str(PROGRAM), plant, str(level), str(first_seed), str(swims)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    name, *lines = run.stdout.splitlines()
    table = np.array([[float(value) for value in line.split(",")] for line in lines])
    true, measured, sigma = (1e3 * table[:, i].reshape(swims, -1) for i in (2, 3, 4))
    return Figures(name, measured - true, sigma)


def report(figures: Figures, load: Load) -> int:
    """Prints a line; 1 when it misses a goal."""
    share, low, high = figures.covered()
    rms, sigma = figures.rms(), float(np.nanmedian(figures.sigma))
    unmeasured = int(np.isnan(figures.error).sum())
    print(
        f"  {figures.level:24}{rms:6.1f} {sigma:13.1f} {sigma / rms:10.2f}"
        f" {share:9.1%} ({low:.1%} to {high:.1%}) {unmeasured:6} of {figures.error.size}"
    )
    well = COVERED[0] <= share <= COVERED[1] and sigma <= SIGMA_OVER_RMS * rms
    return int(not well)


def main(load: Load = FULL, first_seed: int | None = None) -> int:
    """Measures and prints."""
    if not PROGRAM.exists():
        sys.exit(f"{PROGRAM} is not built. `make bench_programs` builds it.")
    first = secrets.randbits(31) if first_seed is None else first_seed
    levels = [*range(LEVELS), *([RECORDED_LEVEL] if os.environ.get("TAILBEAT_RECORDINGS") else [])]
    print(f"Speed by the IMU alone, {load.swims} swims of 40 beats a level, seeds from {first} on:")
    missed = 0
    print("  level                RMS mm/s, median sigma, sigma/RMS, in 2 sigma (95 %), unmeasured")
    for plant in PLANTS:
        print(f"{plant} plant")
        missed += sum(report(swim(plant, level, first, load.swims), load) for level in levels)
    if missed:
        sys.exit(f"{missed} of {len(PLANTS) * len(levels)} levels miss a goal")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(FULL, int(sys.argv[1]) if len(sys.argv) > 1 else None))
