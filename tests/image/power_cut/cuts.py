"""Where the power is cut, and one cut from beginning to end."""

from __future__ import annotations

import multiprocessing
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from vboard.core.clock import TICKS_PER_S
from vboard.flashlog import PageWrite

from . import aftermath
from .session import Session, look

AIMED, AGAIN, SWIMS = 0.5, 0.1, 0.1
"""Shares of the cuts: aimed at a page being written; followed by another cut while the board boots,
if that does not repair the flash (then it is half of them); followed by a trial."""
AGAIN_IN_REPAIR = 0.5


@dataclass(frozen=True)
class Cut:
    """A cut of the series ``seed``. ``dice`` has the rest of its luck: how a page is torn."""

    number: int
    tick: int
    trials: bool
    dice: random.Random


@dataclass(frozen=True)
class Outcome:
    """What a cut hit, and what became of it. ``state``: old, new, between, or same when the step
    under way changes nothing that lasts. ``again``: writes that the second cut hit, 0 or 1; None
    without a second cut. ``failure``: None if all was well."""

    number: int
    where: str
    hit_write: bool
    again: int | None = None
    state: str = ""
    failure: str | None = None


def plan(session: Session, seed: int, number: int) -> Cut:
    """The same numbers, the same cut. An aimed one is aimed at a step first, for a trial writes
    more than all the others do."""
    dice = random.Random(f"{seed}/{number}")
    writes = dice.choice(session.writes_by_step()) if dice.random() < AIMED else []
    tick = _pick(dice, writes, session.end)
    return Cut(number, tick, dice.random() < SWIMS, dice)


def _pick(dice: random.Random, writes: list[PageWrite], end: int) -> int:
    """A tick during one of ``writes``; any tick before ``end`` if there are none."""
    if writes:
        write = dice.choice(writes)
        return dice.randrange(write.start, write.end)
    return dice.randrange(end)


def perform(session: Session, image: Path, cut: Cut) -> Outcome:
    """Cuts, recovers, checks."""
    write = session.log.writing(cut.tick)
    where = f"{cut.tick / TICKS_PER_S:.6f} s, {session.step_at(cut.tick).name}"
    where += "" if write is None else f", writing page {write.page}"
    outcome = Outcome(cut.number, where, write is not None)
    try:
        bank = session.log.cut(cut.tick, cut.dice)
        aftermath.check_mountable(session, cut.tick, bank)
        recovered = aftermath.recover(image, bank)
        if cut.dice.random() < (AGAIN_IN_REPAIR if recovered.log.writes else AGAIN):
            recovered, hits = _cut_boot(image, recovered, cut.dice)
            outcome = replace(outcome, again=hits)
        state = check(session, recovered, cut)
        recovered.switch_off()
        return replace(outcome, state=state)
    except Exception as error:
        return replace(outcome, failure=f"{type(error).__name__}: {error}")


def _cut_boot(
    image: Path, booted: aftermath.Recovered, dice: random.Random
) -> tuple[aftermath.Recovered, int]:
    """The boot as if it had been cut, aimed at a write if there is one; how many writes it hit."""
    tick = _pick(dice, booted.log.writes, booted.booted)
    bank = booted.log.cut(tick, dice)
    booted.switch_off()
    return aftermath.recover(image, bank), int(booted.log.writing(tick) is not None)


def check(session: Session, recovered: aftermath.Recovered, cut: Cut) -> str:
    """Everything about a board that has its power back; the state it is in, as in Outcome."""
    fish = recovered.fish
    aftermath.check_board(fish)
    seen = look(fish)
    index = aftermath.check_view(session, cut.tick, seen)
    files = aftermath.read_files(recovered.board.flash)
    aftermath.check_files(files)
    aftermath.check_trial_files(session, cut.tick, seen, files)
    aftermath.go_on(fish, seen, cut.trials)
    aftermath.read_files(recovered.board.flash)
    views = session.step_at(cut.tick).views
    if len(set(views)) == 1:
        return "same"
    return {0: "old", len(views) - 1: "new"}.get(index, "between")


def series(
    session: Session, image: Path, seed: int, numbers: Iterable[int], processes: int = 1
) -> Iterator[Outcome]:
    """Cuts, as they are done; with several processes in no order."""
    if processes == 1:
        yield from (perform(session, image, plan(session, seed, number)) for number in numbers)
        return
    context = multiprocessing.get_context("fork")  # which hands the session down for nothing
    with context.Pool(processes, _inherit, (session, image, seed)) as pool:
        yield from pool.imap_unordered(_perform_inherited, numbers)


_inherited: tuple[Session, Path, int]


def _inherit(session: Session, image: Path, seed: int) -> None:
    global _inherited
    _inherited = session, image, seed


def _perform_inherited(number: int) -> Outcome:
    session, image, seed = _inherited
    return perform(session, image, plan(session, seed, number))


def summary(outcomes: list[Outcome], seed: int) -> str:
    """One line."""
    states = Counter(outcome.state for outcome in outcomes)
    again = [outcome.again for outcome in outcomes if outcome.again is not None]
    return (
        f"{len(outcomes)} power cuts (seed {seed}), {sum(o.hit_write for o in outcomes)} of them"
        f" while a page was written: {states['old']} left the old state, {states['new']} the new,"
        f" {states['between']} were between (the trial counted, not yet over), {states['same']} hit"
        f" what changes nothing; {len(again)} were cut again while booting, {sum(again)} of them"
        f" while a page was written; {sum(o.failure is not None for o in outcomes)} failed"
    )
