"""The power goes at any instant of a learning session: the board knows the old or the new."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from tailbeat.sim.emulated import EmulatedBoard
from vboard.flashlog import FlashLog, PageWrite, PowerLost, power_lost_at

from .power_cut import aftermath, cuts
from .power_cut.session import SEED as BOARD_SEED
from .power_cut.session import Session, begin, greet, run

CUTS, SOAK_CUTS = 20, 1000
SOAK_PROCESSES = 2
SEED = int(os.environ.get("POWER_CUT_SEED", "2"))
ONLY = os.environ.get("POWER_CUT")  # the number of the one cut to do again


@pytest.fixture(scope="module")
def image(image: Path) -> Path:
    """TAILBEAT_IMAGE names another than the usual one."""
    return Path(os.environ.get("TAILBEAT_IMAGE", image))


@pytest.fixture(scope="module")
def uncut(image: Path) -> Session:
    """The session as it goes when nobody cuts it."""
    session = begin(image)
    run(session)
    return session


def test_the_session_changes_what_is_to_be_cut(uncut: Session) -> None:
    changing = [step.name for step in uncut.steps if len(set(step.views)) > 1]
    assert changing == [
        "parameters", "reference", "trial 1", "learn 1", "parameters 1", "trial 2", "learn 2",
        "parameters 2",
    ]  # fmt: skip
    assert uncut.log.at(uncut.end) == uncut.board.flash
    for name in changing:
        step = next(step for step in uncut.steps if step.name == name)
        assert any(step.start <= write.start < step.end for write in uncut.log.writes)


@pytest.mark.parametrize(
    ("step", "progress"), [("trial 2", 0.3), ("trial 1", 0.8), ("trial 1", None)]
)
def test_a_cut_taken_from_the_log_is_the_cut_itself(
    image: Path, uncut: Session, step: str, progress: float | None
) -> None:
    span = next(s for s in uncut.steps if s.name == step)
    writes = [w for w in uncut.log.writes if span.start <= w.start < span.end]
    write = next(w for w in writes[len(writes) // 2 :] if not is_blank(uncut.log, w))
    tick = write.end + 1
    if progress is not None:
        tick = write.start + round(progress * (write.end - write.start))
    session = cut_for_real(image, tick)
    board, now = session.board, session.board.board.clock.now
    assert (uncut.log.writing(now) == write) == (progress is not None)
    assert board.flash == uncut.log.cut(now, random.Random(BOARD_SEED * 2 + 1))
    assert (board.flash == uncut.log.at(now)) == (progress is None)
    recovered = aftermath.Recovered(board, FlashLog(board.board), greet(board))
    assert cuts.check(uncut, recovered, cuts.Cut(0, now, True, random.Random(0)))


def is_blank(log: FlashLog, write: PageWrite) -> bool:
    """Whether the page was blank: then a cut while it is erased changes nothing."""
    begin = write.page * len(write.data)
    return set(log.at(write.start)[begin : begin + len(write.data)]) == {0xFF}


def cut_for_real(image: Path, tick: int) -> Session:
    """The same session on another board that loses its power and has it again at once."""
    session = begin(image)
    with power_lost_at(session.board.board, tick), pytest.raises(PowerLost):
        run(session)
    assert isinstance(session.board, EmulatedBoard)
    session.board.world.power_cycle()
    return session


def report(outcomes: list[cuts.Outcome]) -> None:
    """Prints the figures; fails with the cuts that failed."""
    print(cuts.summary(outcomes, SEED))
    failed = [
        f"cut {o.number} of seed {SEED} at {o.where}: {o.failure}"
        for o in sorted(outcomes, key=lambda o: o.number)
        if o.failure is not None
    ]
    assert not failed, "\n".join(failed)


def test_power_cuts(image: Path, uncut: Session) -> None:
    numbers = range(CUTS) if ONLY is None else [int(ONLY)]
    outcomes = list(cuts.series(uncut, image, SEED, numbers))
    report(outcomes)
    if ONLY is None:
        assert sum(outcome.hit_write for outcome in outcomes) >= CUTS // 4
        assert {"old", "new", "between"} <= {outcome.state for outcome in outcomes}


@pytest.mark.soak
def test_very_many_power_cuts(image: Path, uncut: Session) -> None:
    outcomes = []
    for outcome in cuts.series(uncut, image, SEED, range(SOAK_CUTS), SOAK_PROCESSES):
        outcomes.append(outcome)
        if len(outcomes) % 100 == 0:
            print(f"{len(outcomes)} cuts", flush=True)
    report(outcomes)
    assert sum(outcome.hit_write for outcome in outcomes) >= SOAK_CUTS // 3
