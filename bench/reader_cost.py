"""What a byte from the IMU costs its reader, in instructions: of this processor, and of the fish's.

Here callgrind counts; two runs of different length are subtracted, so that starting the program and
making the stream cost nothing. There the emulated chip counts, over the second of two passes; its
code is that of the flash image, compiled for size. The bytes are pushed 64 at a time, all checks
on. Exits with 1 when a goal, which is one for this processor, is missed.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from sim_cost import counted

from vboard.chip import CYCLES_PER_INSTRUCTION
from vboard.core.bench import compile_program, run_program

PROGRAM = Path("build/bench/imu_reader_cost")
LIBRARY = Path("build/firmware/libtailbeat_firmware.a")
CHIP_PROGRAM = Path("bench/chip/reader.c")
INCLUDES = (Path("firmware"), Path("bench"))
BYTES = re.compile(r"bytes (\d+)")
LONGEST_S = 5.0


@dataclass(frozen=True)
class Stream:
    """One kind of stream, and how much a byte of it may cost: to find and check its messages, and
    to decode all values as well (None: the firmware does not decode these)."""

    mode: str
    what: str
    goal: float
    values_goal: float | None


STREAMS = (
    Stream("exact", "64-byte frames, that header only", 15, 11),
    Stream("any", "frames of 64, 52 and 40 bytes, any header", 15, None),
    Stream("ascii", "$VNYMR lines", 25, 25),
    Stream("mixed", "all of these, any header", 25, 25),
)


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    streams: tuple[Stream, ...]
    repeats: tuple[int, int]


FULL = Load(STREAMS, (10, 60))


def count(mode: str, repeats: int) -> tuple[int, int]:
    """Instructions executed and bytes pushed by one run."""
    instructions, printed = counted([str(PROGRAM), mode, str(repeats)])
    pushed = BYTES.search(printed)
    if pushed is None:
        sys.exit(f"{PROGRAM} {mode} does not say how many bytes it pushed:\n{printed}")
    return instructions, int(pushed[1])


def cost_here(stream: Stream, repeats: tuple[int, int], values: bool = False) -> float:
    """Instructions per byte; with ``values`` those to decode them are in it."""
    mode = stream.mode + ("+values" if values else "")
    short, long = (count(mode, times) for times in repeats)
    return (long[0] - short[0]) / (long[1] - short[1])


def cost_on_the_fish(stream: Stream, folder: Path, values: bool = False) -> float:
    """The same for a Cortex-M3."""
    content = subprocess.run([PROGRAM, stream.mode, "0"], capture_output=True, check=True).stdout
    given = f"#define EXACT {int(stream.mode == 'exact')}\n#define VALUES {int(values)}\n"
    given += "static const uint8_t stream[] = {"
    given += ", ".join(map(str, content)) + "};\n"
    code = given + CHIP_PROGRAM.read_text()
    probe = run_program(compile_program(code, folder, LIBRARY, INCLUDES), LONGEST_S)
    begin, end = probe.times()[:2]
    messages = probe.values_marked()[2]
    if not messages:
        sys.exit(f"the reader found nothing in the stream {stream.mode} on the emulated chip")
    return (end - begin) / CYCLES_PER_INSTRUCTION / len(content)


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    for built in (PROGRAM, LIBRARY):
        if not built.exists():
            sys.exit(f"{built} is not built. `make bench_programs firmware` builds it.")
    missed = 0
    print("IMU reader, instructions per byte (chunks of 64 bytes), here and on the fish:")
    print("  x86-64  (goal)  Cortex-M3")
    with tempfile.TemporaryDirectory() as folder:
        for stream in load.streams:
            here, fish = cost_here(stream, load.repeats), cost_on_the_fish(stream, Path(folder))
            missed += here > stream.goal
            print(f"  {here:6.1f}  {stream.goal:6.0f}  {fish:9.1f}  {stream.what}")
        print("The same with all values decoded:")
        for stream in load.streams:
            if stream.values_goal is None:
                continue
            here = cost_here(stream, load.repeats, values=True)
            fish = cost_on_the_fish(stream, Path(folder), values=True)
            missed += here > stream.values_goal
            print(f"  {here:6.1f}  {stream.values_goal:6.0f}  {fish:9.1f}  {stream.what}")
    if missed:
        sys.exit(f"{missed} goals missed")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
