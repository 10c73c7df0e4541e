"""What a simulated second costs in C: instructions of this processor, counted by callgrind.

Two runs of ``tailbeat_bench`` of different length are subtracted, so that boot and reference cost
nothing: what is left are whole trials, from arming to the learned input, with an IMU at 100 Hz, a
camera and a host that fits a line to its pictures. The limit is what the firmware takes of that: it
is what the board executes, and no simulator gets by with less. Exits with 1 when the goal is
missed.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PROGRAM = Path("build/bench/tailbeat_bench")
FIRMWARE = "run_firmware_*"  # of sim/sim.c
COLLECTED = re.compile(r"Collected : (\d+)")
SIMULATED = re.compile(r"\(([\d.]+) s in")
GOAL = 1.0e6


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    trials: tuple[int, int]


FULL = Load((1, 4))


def counted(command: Sequence[str], *options: str) -> tuple[int, str]:
    """Instructions of a command and what it prints."""
    if shutil.which("valgrind") is None:
        sys.exit("valgrind is not installed: nothing counted. `tools/bootstrap bench` installs it.")
    callgrind = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *options]
    run = subprocess.run([*callgrind, *command], capture_output=True, text=True, check=False)
    instructions = COLLECTED.search(run.stderr)
    if run.returncode != 0 or instructions is None:
        sys.exit(f"{' '.join(command)} failed under valgrind:\n{run.stderr}")
    return int(instructions[1]), run.stdout


def count(trials: int, *options: str) -> tuple[int, float]:
    """Instructions of one run and the seconds it simulated."""
    instructions, printed = counted([str(PROGRAM), str(trials)], *options)
    simulated = SIMULATED.search(printed)
    if simulated is None:
        sys.exit(f"{PROGRAM} {trials} does not say what it simulated:\n{printed}")
    return instructions, float(simulated[1])


def per_second(load: Load, *options: str) -> float:
    """Instructions per simulated second."""
    short, long = (count(trials, *options) for trials in load.trials)
    return (long[0] - short[0]) / (long[1] - short[1])


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    if not PROGRAM.exists():
        sys.exit(f"{PROGRAM} is not built. `make bench_programs` builds it.")
    cost = per_second(load)
    limit = per_second(load, f"--toggle-collect={FIRMWARE}")
    print(
        f"simulator in C: {cost / 1e6:.3f} M instructions per simulated second"
        f" (goal {GOAL / 1e6:.1f} M; limit, the firmware alone: {limit / 1e6:.3f} M,"
        f" {cost / limit:.2f} x)"
    )
    if cost > GOAL:
        sys.exit(f"the goal is missed by {cost / GOAL - 1:.0%}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
