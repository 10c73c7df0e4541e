"""What commands put into the fish's logbook, and the verdict they can give from it."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from tailbeat.app.cli._terminal import echo, progress_bar
from tailbeat.core.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish
    from tailbeat.experiment.library import Logbook
    from tailbeat.learning.convergence import Verdict
    from tailbeat.learning.identification import Identified
    from tailbeat.session.operator import DecisionKind


def keep_in_logbook(fish: Fish, path: Path) -> None:
    """Keeps a pulled trial; a logbook that cannot take it is told on stderr and no reason to
    fail."""
    from tailbeat.experiment.library import logbook_of

    try:
        if (book := logbook_of(fish)) is not None:
            book.keep(path)
    except TailbeatError as error:
        echo(f"tailbeat: not kept in the logbook: {error}", err=True)


def discard_and_keep(
    fish: Fish, number: int | None, repeat: bool, quiet: bool, reason: str = ""
) -> None:
    """Keeps the pending trial, then drops it without learning; only a ``repeat`` counts later. A
    trial that the logbook cannot keep (told on stderr) is dropped all the same; one that belongs to
    an experiment only once it is there, with the ``reason``. Raises InputError (disk full), and
    Refused of a stopped board before anything is written."""
    from tailbeat.experiment.library import DISCARDED, logbook_of
    from tailbeat.session.decide import not_noted, noted_decision, pending_of, withdrawn_if_refused

    pending = pending_of(fish, number, f"trial discard{_given(number, repeat, reason)}")
    noted = None
    if pending is not None:
        kind: DecisionKind = "repeat" if repeat else "discard"
        noted = noted_decision(fish, pending, kind, reason)
    book, copy = None, None
    try:
        book = logbook_of(fish)
        if book is not None and pending is not None:
            copy = _pulled(fish, book, pending, quiet)
    except TailbeatError as error:
        echo(f"tailbeat: not kept in the logbook: {error}", err=True)
    with withdrawn_if_refused(noted):
        fish.discard(number)
    if noted is None and (line := not_noted(fish)):
        echo(f"tailbeat: {line}", err=True)
    if book is not None and copy is not None and not repeat:
        book.mark(copy, DISCARDED)


def _given(number: int | None, repeat: bool, reason: str) -> str:
    """What was typed behind the command."""
    words = [] if number is None else [str(number)]
    words += ["--repeat"] * repeat + (["--reason", quote(reason)] if reason else [])
    return "".join(f" {word}" for word in words)


def verdict_after_learning(
    fish: Fish, number: int, rolled_back: bool, quiet: bool, kept: Path | None = None
) -> Verdict | None:
    """Judges the trial by what the logbook has; fetches it unless it is ``kept`` there already.
    None without a logbook, or when the trial cannot be had (told on stderr): the board has learned
    all the same."""
    from tailbeat.experiment.library import logbook_of

    try:
        book = logbook_of(fish)
        if book is None:
            return None
        return _judged(book, kept or _pulled(fish, book, number, quiet), rolled_back)
    except TailbeatError as error:
        echo(f"tailbeat: no verdict on trial {number}: {error}", err=True)
        return None


def _pulled(fish: Fish, book: Logbook, number: int, quiet: bool) -> Path:
    with TemporaryDirectory() as folder, progress_bar(quiet, f"trial {number}") as show:
        path = fish.pull_trial(
            number,
            Path(folder),
            lambda done, total: show(done / max(total, 1), f"{done} bytes"),
        )
        return book.keep(path)


def _judged(book: Logbook, kept: Path, rolled_back: bool) -> Verdict | None:
    from tailbeat.learning.verdict import progress_of

    trials = [one.trial for one in book.kept(kept)[0] if not one.mark]
    return progress_of(trials, None, sound_identified(book), (), rolled_back).verdict


def told_if_another(identified: Identified, unique_id: str) -> None:
    """Tells on stderr that the fish connected is not the one identified."""
    if identified.unique_id and identified.unique_id != unique_id:
        echo(f"tailbeat: identified on another fish ({identified.unique_id})", err=True)


def sound_identified(book: Logbook) -> Identified | None:
    """What was identified; a damaged file is told on stderr, and one does without."""
    try:
        return book.identified()
    except TailbeatError as error:
        echo(f"tailbeat: {error}", err=True)
        return None


def verdict_text(verdict: Verdict | None) -> str:
    """The lines that follow what was learned."""
    if verdict is None:
        return ""
    lines = [verdict.words]
    if verdict.stop:
        lines += [f"stop: {verdict.stop_reason}", verdict.advice]
    elif verdict.saturation is not None:
        lines.append(verdict.saturation.text)
    return "".join(f"\n{line}" for line in lines)
