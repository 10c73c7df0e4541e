"""What a command costs before it does anything: CPU time over that of a bare ``python -c pass``.

Both are measured in turns, user and system time of the process, the least of some runs: other load
of the machine only adds. The limit is Python with the one package that reads the words. Exits with
1 when a goal is missed.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

BARE = ("-c", "pass")
LIMIT = ("-c", "import gc; gc.disable(); import typer; gc.freeze()")
RUN = "import sys; from tailbeat.app.cli import main; sys.exit(main())"
SIM = ("--connect", "sim")
GOALS = {
    ("--help",): 8.0,
    ("info", *SIM): 12.0,
    ("trial", "list", *SIM): 12.0,
    ("params", "list", *SIM): 12.0,
    ("stop", *SIM): 12.0,
}


@dataclass(frozen=True)
class Load:
    """How much is measured; ``judged``: goals count."""

    runs: int
    judged: bool


FULL, TINY = Load(25, judged=True), Load(1, judged=False)


def children_s() -> float:
    """CPU seconds of the processes that were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def cpu_s(arguments: Sequence[str]) -> float:
    """Of one run of Python."""
    begin_s = children_s()
    subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
    return children_s() - begin_s


def main(load: Load = FULL) -> int:
    """A line for each command."""
    commands = {words: ("-c", RUN, *words) for words in GOALS}
    least: dict[tuple[str, ...], float] = {}
    for _ in range(load.runs):
        for arguments in (BARE, LIMIT, *commands.values()):
            least[arguments] = min(cpu_s(arguments), least.get(arguments, float("inf")))
    bare, limit, met = least[BARE], least[LIMIT], True
    for words, arguments in commands.items():
        times, goal = least[arguments] / bare, GOALS[words]
        print(
            f"tailbeat {' '.join(words):26} {least[arguments] * 1e3:5.0f} ms of CPU time,"
            f" {times:4.1f} x bare Python (goal {goal:.0f}); limit {limit / bare:.1f} x,"
            f" {limit / least[arguments]:.2f} of it"
        )
        met = met and times <= goal
    return 0 if met or not load.judged else 1


if __name__ == "__main__":
    raise SystemExit(main())
