"""What the learning law costs the fish's processor: instructions per beat of the longest trial.

The emulated chip counts them, of the code that is in the flash image. Beside them stands the same
law with every operation made, as the equation has it: what it cost before those with a known result
were left out. Both must give the same amplitudes. Exits with 1 when a goal is missed.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from vboard.chip import CYCLES_PER_INSTRUCTION
from vboard.core.bench import compile_program, run_program

LIBRARY = Path("build/firmware/libtailbeat_firmware.a")
PROGRAM = Path("bench/chip/law.c")
INCLUDES = (Path("firmware"), Path("tests/unit"))
BEATS = 512
MARKS = 4  # of each law
LONGEST_S = 5.0


@dataclass(frozen=True)
class Law:
    """One law, what differs from the board's default (P, gain 4, lead 1, no filter)."""

    what: str
    fields: str = ""
    goal: float | None = None


DEFAULT = (
    ".kp_rad_s_m = 4, .amplitude_max_rad = NUMBER(0.5), .beat_s = 1, .lead_beats = 1, .q_len = 1,"
)
LAWS = (
    Law("P, lead 1", goal=400),
    Law("P, lead 1/2", ".lead_beats = NUMBER(0.5)"),
    Law("P, lead 1, decreasing gain", ".fade = NUMBER(0.5), .fade_from = 5"),
    Law("P, lead 1, steps limited", ".step_max_rad = NUMBER(0.05)"),
    Law("PD, lead 1", ".kd_rad_s2_m = NUMBER(0.5)"),
    Law(
        "PD, lead 1, decreasing gain, filter of 3",
        ".kd_rad_s2_m = NUMBER(0.5), .fade = NUMBER(0.5), .q_len = 3",
    ),
)


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    laws: tuple[Law, ...]


FULL, TINY = Load(LAWS), Load(LAWS[:1])


def measure(laws: tuple[Law, ...]) -> list[tuple[float, float]]:
    """Instructions per beat of each law: as it is, and with every operation made."""
    rows = ", ".join(f"{{{DEFAULT} {law.fields}}}" for law in laws)
    code = f"#define LAWS {rows}\n{PROGRAM.read_text()}"
    with tempfile.TemporaryDirectory() as folder:
        image = compile_program(code, Path(folder), LIBRARY, INCLUDES)
        probe = run_program(image, LONGEST_S)
    times, values = probe.times(), probe.values_marked()
    costs = []
    for j, law in enumerate(laws):
        begin, middle, end = times[MARKS * j : MARKS * j + 3]
        if values[MARKS * j + 3] != 0:
            sys.exit(f"the law {law.what!r} gives other amplitudes than its plain form")
        scale = CYCLES_PER_INSTRUCTION * BEATS
        costs.append(((middle - begin) / scale, (end - middle) / scale))
    return costs


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    if not LIBRARY.exists():
        sys.exit(f"{LIBRARY} is not built. `make firmware` builds it.")
    missed = 0
    print(f"the law on the fish's processor, {BEATS} beats, instructions per beat:")
    print(f"  {'':42} {'now':>5} {'goal':>5} {'every operation':>16}")
    for law, (now, plain) in zip(load.laws, measure(load.laws), strict=True):
        goal = "" if law.goal is None else f"{law.goal:.0f}"
        missed += law.goal is not None and now > law.goal
        print(f"  {law.what:42} {now:5.0f} {goal:>5} {plain:16.0f}")
    if missed:
        sys.exit(f"{missed} goals missed")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
