"""Runs several commands one after the other, also when one fails, and sums up at the end.

Usage: run_all.py [--costs FILE] [--cpu-max S] [--in-memory] [--beside NAME COMMAND ...] NAME
COMMAND [NAME COMMAND ...]. Every command goes to the shell. Those of --beside run one after the
other while the last command does, with what it leaves of the processors, and print at their end.
The exit status is 1 when at least one failed, or when all together used more than S seconds of CPU
time, told on a machine as quick as the one of the budget: a fixed piece of work, every few seconds
while they run, says how quick this one is. One that is much slower is allowed a third more: it
slows some work more than other. CPU time is that of a command with all processes it waited for.

With --in-memory, temporary files are in memory where that has room for them, and go at the end.

With FILE, the commands add lines `<CPU seconds> <what>` to the file that TEST_COSTS names; the
largest are printed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO

COSTS_VARIABLE = "TEST_COSTS"
LARGEST = 20
# CPU time of ``fixed_work`` on the machine of the budgets, and how long from one to the next.
WORK_S, EVERY_S = 0.1, 10.0
MEMORY = Path("/dev/shm")
MEMORY_LEAST_BYTES = 2**30  # all tests need a fifth of it
# A machine that takes so many times as long may use so much more: tests were seen to take 2.2 times
# where the fixed work took 1.7.
SLOW, SLOW_MORE = 1.4, 4 / 3


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


def run(name: str, command: str, output: IO[bytes] | None = None) -> Outcome:
    """Runs ``command`` in a shell and waits for its end. ``output``: where that of a command goes
    which leaves the processors to others."""
    begin_s = time.monotonic()
    nice = [] if output is None else ["nice", "-n", "10"]
    process = subprocess.Popen([*nice, "sh", "-c", command], stdout=output, stderr=output)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu_s = usage.ru_utime + usage.ru_stime
    return Outcome(name, process.returncode, time.monotonic() - begin_s, cpu_s)


def fixed_work() -> float:
    """CPU seconds of work that is always the same: half of it in Python, half in C."""
    begin_s = time.thread_time()
    total = 0
    for number in range(1_000_000):
        total += number * number % 7
    data = bytes(2**20)
    for _ in range(83):
        data = hashlib.sha256(data).digest() * 2**15
    return time.thread_time() - begin_s


@contextmanager
def timed_works() -> Iterator[list[float]]:
    """What the fixed work takes again and again, CPU seconds; complete at the end."""
    works_s: list[float] = []
    ended = threading.Event()

    def sample() -> None:
        works_s.append(fixed_work())
        while not ended.wait(EVERY_S):
            works_s.append(fixed_work())

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield works_s
    finally:
        ended.set()
        thread.join()


def has_room(folder: Path) -> bool:
    """Whether it is there, big enough, and programs run from it."""
    if not folder.is_dir():
        return False
    there = os.statvfs(folder)
    fits = there.f_bavail * there.f_frsize >= MEMORY_LEAST_BYTES
    return fits and not there.f_flag & os.ST_NOEXEC


@contextmanager
def in_memory() -> Iterator[None]:
    """Temporary files of what runs meanwhile: tests write many small ones, for which a disk takes
    4 % of their time, and run programs from there."""
    if not has_room(MEMORY):
        yield
        return
    with TemporaryDirectory(prefix="", dir=MEMORY, ignore_cleanup_errors=True) as folder:
        os.environ["TMPDIR"] = folder
        yield


def largest(costs: Path) -> list[str]:
    """The lines of the costs' file with the most CPU time, for the summary."""
    lines = costs.read_text().splitlines() if costs.is_file() else []
    rows = [(float(cpu), what) for cpu, _, what in (line.partition(" ") for line in lines)]
    return [f"  {cpu_s:7.1f} s  {what}" for cpu_s, what in sorted(rows, reverse=True)[:LARGEST]]


def over_budget(outcomes: Sequence[Outcome], works_s: Sequence[float], cpu_max_s: float) -> str:
    """What was used beyond the budget; empty = nothing. ``works_s``: what the fixed work took on
    the way."""
    slower = sum(works_s) / len(works_s) / WORK_S
    used_s = sum(outcome.cpu_s for outcome in outcomes) / slower
    cpu_max_s *= SLOW_MORE if slower > SLOW else 1.0
    print(
        f"  {used_s:.0f} of {cpu_max_s:.0f} s of CPU time (this machine takes {slower:.2f} times)"
    )
    return f"{used_s:.0f} s of CPU time, at most {cpu_max_s:.0f}" if used_s > cpu_max_s else ""


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """``pairs``: names and commands in turn."""
    parser = argparse.ArgumentParser(description=__doc__, add_help=False)
    parser.add_argument("--costs", type=Path)
    parser.add_argument("--cpu-max", type=float)
    parser.add_argument("--in-memory", action="store_true")
    parser.add_argument("--beside", nargs=2, action="append", default=[])
    parser.add_argument("pairs", nargs="*")
    return parser.parse_args(arguments)


def run_with(name: str, command: str, beside: Sequence[tuple[str, str]]) -> list[Outcome]:
    """A command, and those beside it, each a name and a command, whose outcomes come first."""
    with ThreadPoolExecutor(1) as pool, TemporaryFile() as output:
        others = [pool.submit(run, *other, output) for other in beside]
        try:
            found = run(name, command)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)  # none begins any more
            raise
        outcomes = [*(other.result() for other in others), found]
        output.seek(0)
        print(output.read().decode(errors="replace"), end="", flush=True)
    return outcomes


def main(arguments: Sequence[str]) -> int:
    """Runs all; prints one line for each."""
    asked = parsed(arguments)
    if not asked.pairs or len(asked.pairs) % 2:
        print(__doc__, file=sys.stderr)
        return 2
    if asked.costs is not None:
        asked.costs.parent.mkdir(parents=True, exist_ok=True)
        asked.costs.unlink(missing_ok=True)
        os.environ[COSTS_VARIABLE] = str(asked.costs.resolve())
    judged = asked.cpu_max is not None
    outcomes: list[Outcome] = []
    timed: AbstractContextManager[list[float]] = timed_works() if judged else nullcontext([])
    with timed as works_s, in_memory() if asked.in_memory else nullcontext():
        *first, last = zip(asked.pairs[::2], asked.pairs[1::2], strict=True)
        outcomes += [run(*command) for command in first]
        outcomes += run_with(*last, asked.beside)
    if asked.costs is not None and (rows := largest(asked.costs)):
        print("\n  the most CPU time", *rows, sep="\n")
    print(f"\n  {'':24} {'wall':>9} {'CPU':>9}")
    for outcome in outcomes:
        print(outcome.line())
    failed = [outcome.name for outcome in outcomes if outcome.status != 0]
    if failed:
        print(f"FAILED: {len(failed)} of {len(outcomes)}: {', '.join(failed)}")
    over = "" if not judged else over_budget(outcomes, works_s, asked.cpu_max)
    if over:
        print(f"FAILED: {over}")
    return 1 if failed or over else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
