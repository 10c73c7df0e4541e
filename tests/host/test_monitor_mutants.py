"""Each rule of the monitor, broken on purpose: the exploration of its states must see it.

The exploration itself is tests/unit/monitor_explorer.h.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = ROOT / "firmware"
SOURCE = FIRMWARE / "monitor" / "monitor.c"
OTHERS = [FIRMWARE / name for name in ("base/crc.c", "base/real.c", "params/params.c")]
WRONG, HELD_BACK = 1, 2

MAIN = """
#include "monitor_explorer.h"
_Noreturn void panic(const char *where) { puts(where); abort(); }
int main(void) {
    const explored_t explored = explore_monitor();
    return (explored.wrong_pulses != 0) | (explored.held_back != 0) << 1;
}
"""

# The lines as they are, the lines as they must not be, and what must be seen of it, one of them.
MUTANTS = {
    "no lower limit": ("pulse_ticks >= limits->min_ticks &&", "", WRONG),
    "no upper limit": ("&& pulse_ticks <= limits->max_ticks", "", WRONG),
    "lower limit shifted": (
        "pulse_ticks >= limits->min_ticks",
        "pulse_ticks > limits->min_ticks",
        HELD_BACK,
    ),
    "steps are free": ("<= monitor->limits.step_ticks", "<= UINT16_MAX", WRONG),
    "steps count one way only": ("return abs((int)", "return ((int)", WRONG),
    "an old trial again": (
        "request->trial <= monitor->trial",
        "request->trial < monitor->trial",
        WRONG,
    ),
    "the trial is not remembered": ("    monitor->trial = request->trial;\n", "", WRONG),
    "limits of the first swim for all": (
        "    monitor->limits = request->limits;\n",
        "    if (monitor->trial == 0) monitor->limits = request->limits;\n",
        WRONG | HELD_BACK,
    ),
    "new limits at any time": (
        "    const bool due =",
        "    monitor->limits = request->limits;\n    const bool due =",
        WRONG | HELD_BACK,
    ),
    "a start by a coast": (
        "!(request->swim && starts(monitor, request))",
        "!starts(monitor, request)",
        WRONG,
    ),
    "swims for ever": ("    monitor->swim_left--;\n", "", WRONG),
    "coasts for ever": ("    monitor->coast_left--;\n", "", WRONG),
    "late ticks do not matter": ("now_us - monitor->tick_us > MONITOR_LATE_US", "false", WRONG),
    "late ticks by wall clock": ("now_us - monitor->tick_us >", "now_us >", HELD_BACK),
    "swims on after a coast": ("monitor->state != MONITOR_SWIM ||", "", WRONG),
    "swims on after a stop": ("        monitor->state = MONITOR_OFF;\n", "", WRONG | HELD_BACK),
    "counts the swim too early": ("monitor->swim_left == 0", "monitor->swim_left <= 1", HELD_BACK),
    "a refused pulse goes out": (
        "return monitor->pulse_ticks;",
        "return request->pulse_ticks;",
        WRONG,
    ),
}


def explore(text: str, folder: Path) -> tuple[int, str]:
    """What the exploration of this monitor finds, and what it prints."""
    (folder / "monitor.c").write_text(text)
    (folder / "main.c").write_text(MAIN)
    program = folder / "explore"
    include = [f"-I{path}" for path in (FIRMWARE, ROOT / "tests" / "unit")]
    sources = [folder / "monitor.c", folder / "main.c", *OTHERS]
    command = [
        os.environ.get("CC", "cc"),
        "-O1",
        *include,
        *map(str, sources),
        "-o",
        str(program),
        "-lm",
    ]
    subprocess.run(command, check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def test_the_monitor_breaks_no_rule(tmp_path: Path) -> None:
    found, text = explore(SOURCE.read_text(), tmp_path)
    print(text)
    assert found == 0


@pytest.mark.parametrize("what", MUTANTS)
def test_a_broken_rule_is_seen(tmp_path: Path, what: str) -> None:
    right, wrong, expected = MUTANTS[what]
    source = SOURCE.read_text()
    assert source.count(right) == 1, "the monitor was changed: adapt this mutant"
    found, text = explore(source.replace(right, wrong), tmp_path)
    print(text)
    assert found & expected
