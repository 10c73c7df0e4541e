"""What commands do with the trial library of a fish, and with a trial that they fetch for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory

from tailbeat.app.cli._options import sound_identified, verdict_lines
from tailbeat.app.cli._terminal import bytes_bar, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from tailbeat.experiment.library import DISCARDED, TrialLibrary, library_of
from tailbeat.learning.assessment import progress_of
from tailbeat.learning.convergence import Assessment
from tailbeat.session.decide import log_decision, not_logged_text, pending_of, withdrawn_if_refused


def keep_in_library(fish: Fish, path: Path) -> None:
    """Keeps a pulled trial; a library that cannot take it is reported on stderr and no reason to
    fail."""
    with _reported("not kept in the trial library"):
        if (book := library_of(fish)) is not None:
            book.keep(path)


@contextmanager
def _reported(what: str) -> Iterator[None]:
    """What goes wrong meanwhile is a line on stderr and no reason to fail."""
    try:
        yield
    except TailbeatError as error:
        warn(f"{what}: {error}")


def discard_and_keep(fish: Fish, number: int | None, repeat: bool, reason: str = "") -> None:
    """Keeps the pending trial, then drops it without learning; only a ``repeat`` counts later. A
    trial that the library cannot keep (see stderr) is dropped all the same; one that belongs to
    an experiment only once it is there, with the ``reason``. Raises InputError (disk full), and
    Refused of a stopped board before anything is written."""
    pending = pending_of(fish, number, f"trial discard{_given(number, repeat, reason)}")
    noted = None
    if pending is not None:
        noted = log_decision(fish, pending, "repeat" if repeat else "discard", reason)
    book, copy = None, None
    with _reported("not kept in the trial library"):
        book = library_of(fish)
        if book is not None and pending is not None:
            copy = keep_pulled(fish, book, pending)
    with withdrawn_if_refused(noted):
        fish.discard(number)
    if noted is None and (line := not_logged_text(fish)):
        warn(line)
    if book is not None and copy is not None and not repeat:
        book.mark(copy, DISCARDED)


def _given(number: int | None, repeat: bool, reason: str) -> str:
    """What was typed behind the command."""
    words = [] if number is None else [str(number)]
    words += ["--repeat"] * repeat + (["--reason", quote(reason)] if reason else [])
    return "".join(f" {word}" for word in words)


def assessment_after(
    fish: Fish, number: int, rolled_back: bool, kept: Path | None = None
) -> Assessment | None:
    """Assesses the trial by what the library has; fetches it unless it is ``kept`` there already.
    None without a library, or when the trial cannot be fetched (reported on stderr): the board has
    learned all the same."""
    found = None
    with _reported(f"no assessment of trial {number}"):
        if (book := library_of(fish)) is not None:
            kept = kept or keep_pulled(fish, book, number)
            trials = [one.trial for one in book.kept(kept)[0] if not one.mark]
            found = progress_of(trials, None, sound_identified(book), (), rolled_back).verdict
    return found


def pull_with_bar(fish: Fish, number: int, folder: Path) -> Path:
    """The trial's file, copied from the board into the folder."""
    with bytes_bar(f"trial {number}") as show:
        return fish.pull_trial(number, folder, show)


def keep_pulled(fish: Fish, book: TrialLibrary, number: int) -> Path:
    """The trial's file in the trial library, copied from the board."""
    with TemporaryDirectory() as folder:
        return book.keep(pull_with_bar(fish, number, Path(folder)))


def assessment_lines(found: Assessment | None) -> list[str]:
    """The lines that follow what was learned."""
    return [] if found is None else [found.words, *verdict_lines(found)]
