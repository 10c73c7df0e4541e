"""What knowing the speed costs the fish's processor, from a byte of the IMU to a beat.

The emulated chip counts instructions, of the code that is in the flash image. How long one takes it
assumes, as in bench/image_load.py. Exits with 1 when the goal for a frame's motion is missed; the
row below it is the same formulas in floating point.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from vboard.chip import CYCLES_PER_INSTRUCTION
from vboard.core.bench import compile_program, run_program

LIBRARY = Path("build/firmware/libtailbeat_firmware.a")
PROGRAM = Path("bench/chip/estimate.c")
INCLUDES = (Path("firmware"), Path("hal/include"), Path("tests/unit"))
CLOCK_HZ = 84_000_000
BEGIN = 0x100  # as in the program, and the kinds
IMU_PUSH, REST_PUSH, MOTION_PUSH, MOTION_FORWARD, FORWARD, BACK = 0, 1, 2, 3, 4, 8
MOTION_PLAIN = 12
MOTION_GOAL = 4000
BEATS = 32
SOURCES = {0: "vision and IMU", 2: "IMU between rests", 3: "IMU and thrust model"}
RATES_HZ = (100, 200, 400)
SLOTS_PER_S = 10


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    longest_s: float  # of the chip's time


FULL = Load(longest_s=20.0)
TINY = FULL  # 0.3 s of processor time


def measure(longest_s: float) -> dict[int, list[int]]:
    """Instructions of every piece, by kind."""
    with tempfile.TemporaryDirectory() as folder:
        image = compile_program(PROGRAM.read_text(), Path(folder), LIBRARY, INCLUDES)
        probe = run_program(image, longest_s)
    pieces = defaultdict(list)
    for (begin, value), (end, _) in zip(probe.marks[::2], probe.marks[1::2], strict=True):
        pieces[value - BEGIN].append((end - begin) // CYCLES_PER_INSTRUCTION)
    return pieces


def share(instructions_per_s: float) -> float:
    """Of the processor's time."""
    return instructions_per_s * CYCLES_PER_INSTRUCTION / CLOCK_HZ


def show(pieces: dict[int, list[int]]) -> float:
    """Prints all; instructions of a frame's motion."""
    typical = {kind: statistics.mean(counts) for kind, counts in pieces.items()}
    names = {
        IMU_PUSH: "a frame read, checked, decoded, timed",
        REST_PUSH: "a frame looked at for stillness",
        MOTION_PUSH: f"a frame turned level, summed up (<= {MOTION_GOAL})",
        MOTION_PLAIN: "the same in floating point",
        MOTION_FORWARD: "a slot of 0.1 s of forward motion",
    }
    print("cost of the speed on the fish's processor, instructions:")
    print(f"  {'':42} {'mean':>8} {'most':>8}")
    for kind, name in names.items():
        print(f"  {name:42} {typical[kind]:8.0f} {max(pieces[kind]):8}")
    for source, name in SOURCES.items():
        forward = pieces[FORWARD + source][:BEATS]
        mean = statistics.mean(forward)
        print(f"  {'a beat forward, ' + name:42} {mean:8.0f} {max(forward):8}")
    for source, name in SOURCES.items():
        back = pieces[BACK + source]
        ms = max(back) * CYCLES_PER_INSTRUCTION / CLOCK_HZ * 1000
        text = f"  (a piece of 16 takes {ms:.1f} ms at most)"
        print(f"  {'a beat of the way back, ' + name:42} {sum(back) / BEATS:8.0f} {'':8}{text}")
    print(f"  share of the processor, if an instruction takes {CYCLES_PER_INSTRUCTION} cycles:")
    frame = sum(typical[kind] for kind in (IMU_PUSH, REST_PUSH, MOTION_PUSH))
    beat = max(statistics.mean(pieces[FORWARD + source][:BEATS]) for source in SOURCES)
    slow = SLOTS_PER_S * typical[MOTION_FORWARD] + beat
    for rate_hz in RATES_HZ:
        print(f"    {rate_hz} Hz: frames {share(rate_hz * frame):.2%}, slots and beats", end="")
        print(f" {share(slow):.2%}")
    return typical[MOTION_PUSH]


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    if not LIBRARY.exists():
        sys.exit(f"{LIBRARY} is not built. `make firmware` builds it.")
    cost = show(measure(load.longest_s))
    if cost > MOTION_GOAL:
        sys.exit(f"a frame's motion takes {cost:.0f} instructions, {MOTION_GOAL} are the goal")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
