"""Runs several commands one after the other, also when one fails, and sums up at the end.

Usage: run_all.py NAME COMMAND [NAME COMMAND ...]. Every command goes to the shell. The exit status
is 1 when at least one failed. CPU time is that of a command with all processes it waited for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """How one command ended."""

    name: str
    status: int
    wall_s: float
    cpu_s: float

    def line(self) -> str:
        """For the summary."""
        verdict = "passed" if self.status == 0 else f"FAILED (exit status {self.status})"
        return f"  {self.name:24} {self.wall_s:7.0f} s {self.cpu_s:7.0f} s  {verdict}"


def run(name: str, command: str) -> Outcome:
    """Runs ``command`` in a shell and waits for its end."""
    begin_s = time.monotonic()
    process = subprocess.Popen(command, shell=True)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu_s = usage.ru_utime + usage.ru_stime
    return Outcome(name, process.returncode, time.monotonic() - begin_s, cpu_s)


def main(arguments: list[str]) -> int:
    """Runs all; prints one line for each."""
    if not arguments or len(arguments) % 2:
        print(__doc__, file=sys.stderr)
        return 2
    pairs = zip(arguments[::2], arguments[1::2], strict=True)
    outcomes = [run(name, command) for name, command in pairs]
    print(f"\n  {'':24} {'wall':>9} {'CPU':>9}")
    for outcome in outcomes:
        print(outcome.line())
    failed = [outcome.name for outcome in outcomes if outcome.status != 0]
    if failed:
        print(f"FAILED: {len(failed)} of {len(outcomes)}: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
