"""What the live page takes of a core while nobody looks at it and the fish rests.

The simulated fish is a process of its own, as a real one is. User and system time of the page's
process over some seconds of the clock, once it has connected, the least of a few turns: other load
of the machine only adds. The limit is a program that hears the
same board and does nothing with it. Exits with 1 above the goal.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from startup import RUN

GOAL = 0.005  # of a core
HEAR = """
import sys
from tailbeat.board.fish import Fish
with Fish.connect(sys.argv[1]) as fish:
    print("connected", flush=True)
    while True:
        fish.link.run(0.25)
"""


@dataclass(frozen=True)
class Load:
    """How much is measured; ``judged``: the goal counts."""

    settle_s: float
    measured_s: float
    turns: int
    judged: bool


FULL, TINY = Load(5.0, 10.0, 3, judged=True), Load(0.2, 0.5, 1, judged=False)


@contextmanager
def running(arguments: Sequence[str], folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """(process, first line it prints) of Python; killed at the end."""
    own = {"TAILBEAT_LOGBOOK": str(folder), "TAILBEAT_KEYS": str(folder)}
    with subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | own,
    ) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline()
        finally:
            process.kill()


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(arguments: Sequence[str], folder: Path, load: Load) -> float:
    """Of a core that the process takes once it has settled."""
    with running(arguments, folder) as (process, _):
        time.sleep(load.settle_s)
        return min(share_now(process.pid, load.measured_s) for _ in range(load.turns))


def share_now(pid: int, measured_s: float) -> float:
    """Of a core, over that time."""
    begin_s, begin_cpu_s = time.monotonic(), cpu_s(pid)
    time.sleep(measured_s)
    return (cpu_s(pid) - begin_cpu_s) / (time.monotonic() - begin_s)


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    simulator = ["-c", RUN, "sim", "--json", "--listen", "tcp:127.0.0.1:0"]
    with TemporaryDirectory() as folder, running(simulator, Path(folder)) as (_, line):
        address = json.loads(line)["listen"]
        page = ["-c", RUN, "session", "web", "--connect", address, "--port", "0", "--json"]
        taken = share([*page, "--root", folder], Path(folder), load)
        limit = share(["-c", HEAR, address], Path(folder), load)
    print(
        f"the page, idle: {taken:.2%} of a core (goal {GOAL:.1%}); limit {limit:.2%} (a program"
        f" that hears the board), {taken / limit if limit else float('nan'):.1f} x"
    )
    return 0 if taken <= GOAL or not load.judged else 1


if __name__ == "__main__":
    sys.exit(main())
