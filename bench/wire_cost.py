"""What a simulated trial costs: wire, Python host, board, fish.

One trial = arm, swim 40 s with the camera's speeds streamed, pull the log, learn. Processor time of
this process, the least and the median of a few trials. The limit is the share of it that C
takes (board, fish, line), measured in trials of their own. Exits with 1 above the goal.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from tailbeat.board.fish import Fish
from tailbeat.core.reference import thesis
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

TICK_S = time.get_clock_info("process_time").resolution  # a timer makes the clock tick slowly
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


@dataclass
class Stopwatch:
    """Processor time inside of functions."""

    passed_s: float = 0.0

    def on(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, timed."""

        def timed(*args: Any) -> Any:
            begin_s = time.process_time()
            found = function(*args)
            self.passed_s += time.process_time() - begin_s
            return found

        return timed


def one_trial(fish: Fish, folder: Path) -> Cost:
    """Executed, pulled and learned from."""
    transport = fish.link.transport
    begin_s, begin_cpu_s = transport.now_s(), time.process_time()
    outcome = run_trial(fish)
    fish.pull_trial(outcome.number, folder)
    fish.learn(outcome.number)
    return Cost(transport.now_s() - begin_s, max(time.process_time() - begin_cpu_s, TICK_S))


def costs_of(board: SimBoard, trials: int) -> list[Cost]:
    """Of so many trials of one fish."""
    with Fish(SimTransport(board)) as fish, tempfile.TemporaryDirectory() as folder:
        fish.upload_reference(thesis().record())
        return [one_trial(fish, Path(folder)) for _ in range(trials)]


def limit_s(trials: int) -> float:
    """What C takes of a trial, at least."""
    shares = []
    for _ in range(trials):
        watch = Stopwatch()
        with (
            patch.object(SimBoard, "run", watch.on(SimBoard.run)),
            patch.object(SimBoard, "converse", watch.on(SimBoard.converse)),
        ):
            costs_of(SimBoard("tank"), 1)
        shares.append(watch.passed_s)
    return max(min(shares), TICK_S)


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    costs, limit = costs_of(SimBoard("tank"), load.trials), limit_s(load.trials)
    least = min(costs, key=lambda cost: cost.cpu_s)
    median_s = statistics.median(cost.cpu_s for cost in costs)
    print(
        f"a simulated trial (wire, Python host, board, fish): {least.cpu_s * 1e3:.0f} ms of CPU"
        f" time at best (goal {GOAL_S * 1e3:.0f}), {median_s * 1e3:.0f} ms in the median of"
        f" {load.trials}, {least.trial_s / least.cpu_s:.0f} x real time; limit {limit * 1e3:.0f} ms"
        f" (C alone), {least.cpu_s / limit:.1f} of it"
    )
    return 0 if least.cpu_s <= GOAL_S or not load.judged else 1


if __name__ == "__main__":
    raise SystemExit(main())
