"""What a simulated trial costs: wire, Python host, board, fish.

One trial = arm, swim 40 s with the camera's speeds streamed, pull the log, learn. Processor time of
this process, the least and the median of a few trials. The limit is the same time simulated with
nobody on the wire. Exits with 1 above the goal.
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
from tailbeat.sim.board import SimBoard, SimTransport

GOAL_S = 0.045


@dataclass(frozen=True)
class Load:
    """How much is measured; ``judged``: the goal counts."""

    trials: int
    judged: bool


FULL, TINY = Load(trials=12, judged=True), Load(trials=1, judged=False)


@dataclass(frozen=True)
class Cost:
    """Of a trial: simulated time and processor time."""

    trial_s: float
    cpu_s: float


def one_trial(fish: Fish, folder: Path) -> Cost:
    """Swum, pulled and learned from."""
    transport = fish.link.transport
    assert isinstance(transport, SimTransport)
    begin_s, begin_cpu_s = transport.now_s(), time.process_time()
    outcome = run_trial(fish)
    fish.pull_trial(outcome.number, folder)
    fish.learn(outcome.number)
    return Cost(transport.now_s() - begin_s, time.process_time() - begin_cpu_s)


def alone_s(duration_s: float) -> float:
    """Processor time of the board and the fish by themselves."""
    board = SimBoard("tank")
    begin_s = time.process_time()
    board.run(duration_s)
    return time.process_time() - begin_s


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    with Fish.connect("sim:tank") as fish, tempfile.TemporaryDirectory() as folder:
        fish.upload_reference(thesis().record())
        costs = [one_trial(fish, Path(folder)) for _ in range(load.trials)]
    least = min(costs, key=lambda cost: cost.cpu_s)
    limit_s = min(alone_s(least.trial_s) for _ in range(load.trials))
    median_s = statistics.median(cost.cpu_s for cost in costs)
    print(
        f"whole way (wire, Python host, board, fish): {least.cpu_s * 1e3:.0f} ms of CPU time for a"
        f" trial at best (goal {GOAL_S * 1e3:.0f}), {median_s * 1e3:.0f} ms in the median of"
        f" {load.trials}, {least.trial_s / least.cpu_s:.0f} x real time; limit {limit_s * 1e3:.0f}"
        f" ms without the wire, {limit_s / least.cpu_s:.2f} of it"
    )
    return 0 if least.cpu_s <= GOAL_S or not load.judged else 1


if __name__ == "__main__":
    raise SystemExit(main())
