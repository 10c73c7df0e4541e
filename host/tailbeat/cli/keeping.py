"""What commands put into the fish's logbook, and the verdict they can give from it."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import typer

from tailbeat.cli.common import progress_bar
from tailbeat.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.logbook import Logbook
    from tailbeat.model.identified import Identified
    from tailbeat.verdict import Verdict


def keep_in_logbook(fish: Fish, path: Path) -> None:
    """Keeps a pulled trial; a logbook that cannot take it is told on stderr and no reason to
    fail."""
    from tailbeat.logbook import logbook_of

    try:
        if (book := logbook_of(fish)) is not None:
            book.keep(path)
    except TailbeatError as error:
        typer.echo(f"tailbeat: not kept in the logbook: {error}", err=True)


def verdict_after_learning(
    fish: Fish, number: int, rolled_back: bool, quiet: bool
) -> Verdict | None:
    """Fetches the trial into the logbook and judges it by what is there. None without a logbook, or
    when the trial cannot be had (told on stderr): the board has learned all the same."""
    from tailbeat.logbook import logbook_of

    try:
        book = logbook_of(fish)
        return None if book is None else _judged(fish, book, number, rolled_back, quiet)
    except TailbeatError as error:
        typer.echo(f"tailbeat: no verdict on trial {number}: {error}", err=True)
        return None


def _judged(
    fish: Fish, book: Logbook, number: int, rolled_back: bool, quiet: bool
) -> Verdict | None:
    from tailbeat.progress import progress_of

    with TemporaryDirectory() as folder, progress_bar(quiet, f"trial {number}") as show:
        path = fish.pull_trial(
            number,
            Path(folder),
            lambda done, total: show(done / max(total, 1), f"{done} bytes"),
        )
        book.keep(path)
    trials = book.trials()
    last = max((at for at, trial in enumerate(trials) if trial.number == number), default=None)
    if last is None:
        return None
    identified = sound_identified(book)
    return progress_of(trials[: last + 1], None, identified, (), rolled_back).verdict


def sound_identified(book: Logbook) -> Identified | None:
    """What was identified; a damaged file is told on stderr, and one does without."""
    try:
        return book.identified()
    except TailbeatError as error:
        typer.echo(f"tailbeat: {error}", err=True)
        return None


def verdict_text(verdict: Verdict | None) -> str:
    """The lines that follow what was learned."""
    if verdict is None:
        return ""
    lines = [verdict.words]
    if verdict.stop:
        lines += [f"stop: {verdict.stop_reason}", verdict.advice]
    return "".join(f"\n{line}" for line in lines)
