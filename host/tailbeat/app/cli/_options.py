"""Options that several commands have, each declared once, and what they stand for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tailbeat.app.cli._fish import connected
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.experiment.current import current, named_reference
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import TrialLibrary
from tailbeat.learning.convergence import Assessment
from tailbeat.learning.identification import Identified

IdentifiedFile = Annotated[
    Identified | None, opt("What 'session identify' wrote.", "FILE", by=Identified.load)
]
Plot = Annotated[Path | None, opt("Draw it.", "PNG")]
Library = Annotated[Path | None, opt("Folder of the trial libraries.", "DIR")]
Into = Annotated[
    Experiment | None,
    opt("The experiment; default: the fish's current.", "FOLDER", by=Experiment.open),
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
