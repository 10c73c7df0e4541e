"""RAM goes bad while the image runs: no pulse outside the limits, none after the stop.

Each run writes random words over RAM in one of the board's states, and goes on until a swim would
be over. Runs begin as forks of one board, so that the session before them is run once.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from .corruption import Day, Lack, Outcome, Way

STATES = 11  # of Day.go()
SEEDS = int(os.environ.get("CORRUPTION_SEEDS", "91"))  # per state, in `make soak`


def spoil(
    image: Path, first: int, count: int, way: Way, lacks: Lack = Lack.NOTHING
) -> list[Outcome]:
    """``count`` runs in each state; what came of them is printed."""
    states: list[str] = []

    def plan(state: str) -> list[tuple[int, Way, Lack]]:
        states.append(state)
        start = first + count * (len(states) - 1)
        return [(seed, way, lacks) for seed in range(start, start + count)]

    outcomes = Day(image, plan).go()
    assert len(states) == STATES
    for state in states:
        ends = Counter(o.end for o in outcomes if o.state == state)
        wrong = sum(bool(o.wrong) for o in outcomes if o.state == state)
        print(f"{state}: {dict(ends)}, {wrong} runs with a wrong pulse")
    for outcome in outcomes:
        if outcome.wrong:
            print(f"seed {outcome.seed}, {outcome.state}: {outcome.wrong[:3]}")
    last = first + len(outcomes) - 1
    print(f"writes: {way.value}; lacking: {lacks.value}; seeds {first} to {last}")
    return outcomes


def wrong_runs(outcomes: list[Outcome]) -> int:
    return sum(bool(o.wrong) for o in outcomes)


def test_random_writes_move_no_tail(image: Path) -> None:
    assert wrong_runs(spoil(image, 1, 2, Way.ANYWHERE)) == 0


@pytest.mark.soak
@pytest.mark.parametrize("way", Way)
def test_a_thousand_random_writes_move_no_tail(image: Path, way: Way) -> None:
    assert wrong_runs(spoil(image, 10_000, SEEDS, way)) == 0


@pytest.mark.soak
@pytest.mark.parametrize("lacks", [Lack.REGION, Lack.MONITOR])
def test_without_the_monitor_or_its_region_they_do(image: Path, lacks: Lack) -> None:
    assert wrong_runs(spoil(image, 10_000, SEEDS, Way.TICK, lacks)) > 0
