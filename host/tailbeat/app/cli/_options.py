"""Options that several commands have, each declared once.

What commands do with the experiment and the trial library of a fish.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Annotated

from tailbeat.app.cli._fish import connected
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import bytes_bar, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.experiment.current import current, named_reference
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import DISCARDED, TrialLibrary, library_of
from tailbeat.learning.assessment import progress_of
from tailbeat.learning.convergence import Assessment
from tailbeat.learning.identification import Identified
from tailbeat.session.decide import log_decision, not_logged_text, pending_of, withdrawn_if_refused
from tailbeat.session.preflight_step import PreflightLimits


def _with_rest(rest_s: float) -> PreflightLimits:
    return PreflightLimits(rest_s=rest_s)


IdentifiedFile = Annotated[
    Identified | None, opt("What 'session identify' wrote.", "FILE", by=Identified.load)
]
Plot = Annotated[Path | None, opt("Draw it.", "PNG")]
Library = Annotated[Path | None, opt("Folder of the trial libraries.", "DIR")]
Into = Annotated[
    Experiment | None,
    opt("The experiment; default: the fish's current.", "FOLDER", by=Experiment.open),
]
Rest = Annotated[
    PreflightLimits | None,
    opt("Rest since the last trial; default: 30.", "S", by=_with_rest, min=0.0, max=3600.0),
]
Root = Annotated[Path, opt("Folder that holds the experiments.")]
Yes = Annotated[bool, opt("Answer every question with yes.", name="--yes")]
EXPERIMENTS = Path("experiments")

_KINDS = ("thesis", "thesis:", "trapezoid:", "cosine:")


def reference_names(incomplete: str) -> list[str]:
    """What the shell offers: kinds of references, CSV files, and folders that may hold some."""
    folder = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    try:
        files = sorted(folder.iterdir())
    except OSError:
        files = []
    found = [str(path) for path in files if path.suffix.lower() == ".csv"]
    found += [f"{path}/" for path in files if path.is_dir() and not path.name.startswith(".")]
    return [name for name in (*_KINDS, *found) if name.startswith(incomplete)]


ReferenceName = Annotated[
    Reference | None,
    opt(
        "As for 'reference upload'; default: the board's (without a board: thesis).",
        autocompletion=reference_names,
        show_default=False,
        by=named_reference,
    ),
]


def current_of(connect: str | None) -> Experiment:
    """The one that the connected fish is in."""
    with connected(connect) as fish:
        return experiment_of(fish)


def experiment_of(fish: Fish) -> Experiment:
    """The one that the fish is in. Raises InputError."""
    if (found := current(fish)) is None:
        raise in_no_experiment(fish)
    return found


def in_no_experiment(fish: Fish) -> InputError:
    """And what to do."""
    return InputError(
        f"this fish ({fish.unique_id()}) is in no experiment.",
        "Name its folder (tailbeat experiment list), or begin one: tailbeat trial run",
    )


def warn_of_problems(experiment: Experiment) -> None:
    """On stderr, one line each: raw files are never wrong in silence."""
    for line in experiment.raw_problems():
        warn(f"{line}; put a copy back, or do without that file")


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
    None without a library, or when the trial cannot be had (reported on stderr): the board has
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


def warn_if_another(identified: Identified, unique_id: str) -> None:
    """Warns on stderr that the fish connected is not the one identified."""
    if identified.unique_id and identified.unique_id != unique_id:
        warn(f"identified on another fish ({identified.unique_id})")


def sound_identified(book: TrialLibrary) -> Identified | None:
    """What was identified; None also for a damaged file, which is reported on stderr."""
    try:
        return book.identified()
    except TailbeatError as error:
        warn(error)
        return None


def verdict_lines(verdict: Assessment) -> list[str]:
    """Why to stop, or what is saturated."""
    if verdict.stop:
        return [f"stop: {verdict.stop_reason}", verdict.advice]
    return [] if verdict.saturation is None else [verdict.saturation.text]


def assessment_lines(found: Assessment | None) -> list[str]:
    """The lines that follow what was learned."""
    return [] if found is None else [found.words, *verdict_lines(found)]
