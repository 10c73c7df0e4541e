"""Whether a board was switched off since it last swam, told by two clocks."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tailbeat.board.fish import Fish
from tailbeat.experiment.store import Journal
from tailbeat.session.log import accepted, switched_off_since


def board(now_s: float, simulated: bool = False) -> Fish:
    """One that was switched on ``now_s`` ago."""
    clock = SimpleNamespace(now_s=lambda: now_s)
    status, info = SimpleNamespace(time_s=now_s), SimpleNamespace(simulated=simulated)
    made = SimpleNamespace(clock=clock, status=lambda: status, info=lambda: info)
    return cast("Fish", made)


@pytest.fixture
def journal(tmp_path: Path) -> Journal:
    """Trial 7 began an hour ago, when the board had been on for 10 minutes."""
    made = Journal(tmp_path / "journal.jsonl")
    made.add("made")
    then = datetime.now() - timedelta(hours=1)
    made.add("begun", now=then, trial=7, board_s=600.0)
    made.add("swum", now=then, trial=7)
    return made


@pytest.mark.parametrize(
    ("now_s", "trial"),
    [
        (4200.0, None),  # it was on all the time
        (4195.0, None),  # the clocks agree within a few seconds
        (4230.0, None),  # the laptop's was put back
        (20.0, 7),
        (599.0, 7),
        (3000.0, 7),  # on for longer than before, and yet not all the time
        (4160.0, 7),
    ],
)
def test_by_the_boards_clock_and_the_laptops(
    journal: Journal, now_s: float, trial: int | None
) -> None:
    assert switched_off_since(board(now_s), journal) == trial


def test_a_simulated_board_has_a_pace_of_its_own(journal: Journal) -> None:
    assert switched_off_since(board(700.0, simulated=True), journal) is None
    assert switched_off_since(board(599.0, simulated=True), journal) == 7


@pytest.mark.parametrize("what", ["resumed", "restarted"])
def test_once_it_is_known_it_is_not_told_again(journal: Journal, what: str) -> None:
    if what == "restarted":
        accepted(board(20.0), journal)
    else:
        journal.add("resumed", board_s=20.0)
    assert switched_off_since(board(20.0), journal) is None
    assert switched_off_since(board(5.0), journal) == 7


@pytest.mark.parametrize("entry", [None, {"what": "begun", "trial": 7}, {"what": "resumed"}])
def test_nobody_can_tell(tmp_path: Path, entry: dict[str, Any] | None) -> None:
    made = Journal(tmp_path / "journal.jsonl")
    if entry is not None:
        made.add(**entry)
    assert switched_off_since(board(5.0), made) is None
