"""How much faster than real time a whole trial runs: wire, Python host, board, fish.

One trial = arm, swim 40 s with the camera's speeds streamed, pull the log, learn, dry run excluded.
Prints the best and the median of a few trials as a ratio; processor time of this process, one core.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tailbeat.board.fish import Fish
from tailbeat.core.reference import thesis
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    trials: int


FULL, TINY = Load(trials=7), Load(trials=1)


def one_trial(fish: Fish, folder: Path) -> float:
    """Simulated seconds per second of processor time."""
    transport = fish.link.transport
    assert isinstance(transport, SimTransport)
    begin_s, begin_cpu_s = transport.now_s(), time.process_time()
    outcome = run_trial(fish)
    fish.pull_trial(outcome.number, folder)
    fish.learn(outcome.number)
    return (transport.now_s() - begin_s) / (time.process_time() - begin_cpu_s)


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    with Fish.connect("sim:tank") as fish, tempfile.TemporaryDirectory() as folder:
        fish.upload_reference(thesis().record())
        ratios = [one_trial(fish, Path(folder)) for _ in range(load.trials)]
    print(
        f"whole way (wire, Python host, board, fish): {max(ratios):.0f} x real time at best,"
        f" {statistics.median(ratios):.0f} x in the median of {load.trials} trials"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
