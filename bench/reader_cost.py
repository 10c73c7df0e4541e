"""What a byte from the IMU costs its reader, in instructions of this processor.

callgrind counts; two runs of different length are subtracted, so that starting the program and
making the stream cost nothing. The bytes are pushed 64 at a time, all checks on. Exits with 1 when
a goal is missed.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

PROGRAM = Path("build/bench/imu_reader_cost")
REPEATS = (10, 60)
COLLECTED = re.compile(r"Collected : (\d+)")
BYTES = re.compile(r"bytes (\d+)")


@dataclass(frozen=True)
class Stream:
    """One kind of stream, and how much a byte of it may cost."""

    mode: str
    what: str
    goal: float


STREAMS = (
    Stream("exact", "64-byte frames, that header only", 15),
    Stream("any", "frames of 64, 52 and 40 bytes, any header", 15),
    Stream("ascii", "$VNYMR lines", 25),
    Stream("mixed", "all of these, any header", 25),
)


def count(mode: str, repeats: int) -> tuple[int, int]:
    """Instructions executed and bytes pushed by one run."""
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    run = subprocess.run(
        [*command, str(PROGRAM), mode, str(repeats)], capture_output=True, text=True, check=False
    )
    instructions, pushed = COLLECTED.search(run.stderr), BYTES.search(run.stdout)
    if run.returncode != 0 or instructions is None or pushed is None:
        sys.exit(f"{PROGRAM} {mode} failed under valgrind:\n{run.stderr}")
    return int(instructions[1]), int(pushed[1])


def cost(stream: Stream) -> float:
    """Instructions per byte."""
    short, long = (count(stream.mode, repeats) for repeats in REPEATS)
    return (long[0] - short[0]) / (long[1] - short[1])


def main() -> None:
    """Measures and prints."""
    if shutil.which("valgrind") is None:
        sys.exit("valgrind is not installed: nothing counted. `tools/bootstrap bench` installs it.")
    if not PROGRAM.exists():
        sys.exit(f"{PROGRAM} is not built. `make bench` builds it.")
    missed = 0
    print("IMU reader, instructions per byte (callgrind, chunks of 64 bytes):")
    for stream in STREAMS:
        instructions = cost(stream)
        missed += instructions > stream.goal
        print(f"  {instructions:5.1f}  (goal {stream.goal:.0f})  {stream.what}")
    if missed:
        sys.exit(f"{missed} of {len(STREAMS)} goals missed")


if __name__ == "__main__":
    main()
