"""What a calibration by hand turns makes of random sensors, and whether its deviations are honest.

Each sensor has scales and axes of its own, biases, noise, and a hand that trembles; what is so is
what the same turns tell without noise and tremor. Exits with 1 when a goal is missed.

Usage: imu_calibration.py [FIRST_SEED]
"""

from __future__ import annotations

import math
import os
import secrets
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.sensors.vn100.calibration import ImuCalibration, Recording, calibrate, missing
from tailbeat.sim.hand import Hand

FLAWS = {"imu_rate_scale": 1e-3, "imu_accel_scale": 1e-3, "imu_misaligned_rad": 1e-3}
STILL = {"imu_noise": 0.0, "tremor_rad": 0.0}
TREMBLING = {"tremor_rad": math.radians(0.05)}
COVERED = 0.90, 0.99
REST_S = 3.0


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    sensors: int


FULL = Load(100)


def turned(seed: int, world: dict[str, float], rests: int = 0) -> tuple[ImuCalibration, int, float]:
    """(what was found, rests, s) by the turns of a simulated hand: until enough is known, or after
    so many rests."""
    with Fish.connect("sim:tank", seed=seed, **(FLAWS | world)) as fish:
        assert fish.sim is not None
        fish.imu_verdict()
        found, hand, begin_s = Recording(), Hand(fish.sim.world), None
        with closing(fish.imu_frames()) as frames:
            for frame in frames:
                begin_s = frame.time_s if begin_s is None else begin_s
                hand.follow(frame.time_s)
                if not found.add(frame):
                    continue
                if len(found.rests) == rests or (not rests and not missing(found)):
                    break
        return calibrate(found), len(found.rests), frame.time_s - (begin_s or 0.0)


def errors(seed: int) -> tuple[F64, F64, float, int, float]:
    """(errors of the scales over their deviations, those of the gyroscopes' matrix, the worst
    angle of an axis, rests, s)."""
    found, rests, duration_s = turned(seed, TREMBLING)
    true, *_ = turned(seed, STILL, rests)
    off = found.rate - true.rate
    across = off - np.diag(np.diag(off))
    return np.diag(off) / found.scale_sd, off, float(np.abs(across).max()), rests, duration_s


def main(load: Load = FULL, first_seed: int | None = None) -> int:
    """Measures and prints."""
    first = secrets.randbits(30) if first_seed is None else first_seed
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(errors, range(first, first + load.sensors)))
    over, off = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    scale = np.array([np.diag(one) for one in off])
    across = off[:, ~np.eye(3, dtype=bool)]
    inside = float(np.mean(np.abs(over) < 2))
    scale_part, across_rad = (math.sqrt(np.mean(one**2)) for one in (scale, across))
    rests, duration_s = (np.median([row[k] for row in rows]) for k in (3, 4))
    print(f"{load.sensors} sensors, scales off by 0.1 %, axes by 0.06 degrees, seeds from {first}:")
    print(
        f"  afterwards {100 * scale_part:.4f} % RMS and {math.degrees(across_rad):.4f} degrees;"
        f" scales in 2 sigma {inside:.1%}; {rests:.0f} rests, {duration_s:.0f} s"
    )
    return int(not COVERED[0] <= inside <= COVERED[1])


if __name__ == "__main__":
    raise SystemExit(main(FULL, int(sys.argv[1]) if len(sys.argv) > 1 else None))
