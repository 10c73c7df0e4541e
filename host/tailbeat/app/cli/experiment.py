"""experiment new, use, set, note, list, show, compare, replay, export."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._experiment import (
    compared_text,
    folder_or_current,
    listed,
    replay_text,
    show_document,
    show_text,
    tell_problems,
)
from tailbeat.app.cli._options import EXPERIMENTS, Connect, Json, ReferenceName, Root
from tailbeat.app.cli._terminal import echo, say
from tailbeat.core.errors import InputError
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.compare import compare as compare_sides
from tailbeat.experiment.compare import other_differences
from tailbeat.experiment.conditions import parse_conditions, set_conditions
from tailbeat.experiment.current import (
    made_before,
    make,
    named_reference,
    own_reference,
    require_same,
)
from tailbeat.experiment.current import use as make_current
from tailbeat.experiment.export import export as export_files
from tailbeat.experiment.export import missing_formats
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import logbook_of
from tailbeat.experiment.redo import redo_text, write_redo
from tailbeat.report.replay import replay as replay_all

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="The experiment's folder.")]
FolderOrCurrent = Annotated[
    Path | None,
    typer.Argument(metavar="FOLDER", help="Default: the one the connected fish is in."),
]
Condition = Annotated[
    list[str] | None,
    typer.Option(
        "--condition", metavar="KEY=VALUE", help="Like water_depth_m=0.35 (unit in the name)."
    ),
]
WaterTemp = Annotated[
    float | None, typer.Option("--water-temp", metavar="C", help="Of the water, degrees Celsius.")
]
Configuration = Annotated[
    str | None, typer.Option("--configuration", help="How the fish is built, in a few words.")
]
Operator = Annotated[str | None, typer.Option("--operator", help="Who is at the tank.")]


def new(
    reference: ReferenceName = None,
    fish_name: Annotated[str | None, typer.Option("--fish", help="Name of the fish.")] = None,
    water_temp: WaterTemp = None,
    condition: Condition = None,
    configuration: Configuration = None,
    operator: Operator = None,
    another: Annotated[
        bool, typer.Option("--another", help="Also when the last one has no trial.")
    ] = False,
    root: Root = EXPERIMENTS,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Make the folder of a new series, with the settings of the connected board.

    From now on 'trial run' of this fish adds to it. The same command again before any trial makes
    no second folder.

    Example: tailbeat experiment new --reference thesis --fish carangi --water-temp 21.5
    """
    named = None if reference is None else named_reference(reference)
    conditions = parse_conditions(condition or [], water_temp)
    words = _words(configuration, operator)
    with connected(connect) as fish:
        wanted = named or own_reference(fish)
        given = {"conditions": conditions, **words, **({"fish": fish_name} if fish_name else {})}
        made = None if another else made_before(fish, root, wanted, given)
        if made is None:
            made = make(fish, root, wanted, fish_name, conditions, words)
        same = fish.status().reference_crc == wanted.crc
    if not same:
        echo(
            f"tailbeat: the board has another reference: tailbeat reference upload {reference}",
            err=True,
        )
    say(json, {"folder": made.folder, "board_has_reference": same}, str(made.folder))


def _words(configuration: str | None, operator: str | None) -> dict[str, str]:
    given = {"configuration": configuration, "operator": operator}
    return {key: value.strip() for key, value in given.items() if value is not None}


def use(folder: Folder, connect: Connect = None, json: Json = False) -> None:
    """Continue an experiment: 'trial run' of the connected fish adds to it.

    Example: tailbeat experiment use experiments/2026-05-04_carangi_thesis_p4_01
    """
    experiment = Experiment.open(folder)
    with connected(connect) as fish:
        require_same(fish, experiment)
        make_current(fish, experiment)
        remembered = logbook_of(fish) is not None
        experiment.journal.add("opened", unique_id=fish.unique_id())
    if not remembered:
        echo(
            "tailbeat: a simulated fish in this process is new every time. Name the folder in every"
            " command, or give it a seed (sim?seed=1) and set TAILBEAT_LOGBOOK.",
            err=True,
        )
    tell_problems(experiment)
    say(json, {"folder": folder, "remembered": remembered}, f"the fish is in {experiment.name}")


def set_(
    folder: FolderOrCurrent = None,
    water_temp: WaterTemp = None,
    condition: Condition = None,
    configuration: Configuration = None,
    operator: Operator = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Set conditions that became known later; the event log keeps the earlier ones.

    Example: tailbeat experiment set FOLDER --water-temp 22 --condition salinity_psu=0.3
    """
    experiment = folder_or_current(folder, connect)
    conditions = parse_conditions(condition or [], water_temp)
    set_conditions(experiment, conditions, _words(configuration, operator))
    write_redo(experiment)
    now = experiment.settings()
    text = ", ".join(f"{key} = {value}" for key, value in now["conditions"].items())
    document = {"folder": experiment.folder, "conditions": now["conditions"]}
    say(json, document, text or "set")


def list_(root: Root = EXPERIMENTS, json: Json = False) -> None:
    """Print the experiments below a folder, oldest first.

    Example: tailbeat experiment list
    """
    rows, text = listed(root)
    say(json, {"experiments": rows}, text)
    if any(row["problems"] for row in rows):
        raise typer.Exit(1)


def show(
    folder: FolderOrCurrent = None,
    redo: Annotated[
        bool, typer.Option("--redo", help="Print how to do it again, and write redo.md.")
    ] = False,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Print an experiment: conditions, trials with their decisions, notes.

    Example: tailbeat experiment show experiments/2026-05-04_carangi_thesis_p4_01
    """
    experiment = folder_or_current(folder, connect)
    if redo:
        text = redo_text(experiment)
        say(json, {"file": write_redo(experiment), "text": text}, text.rstrip())
        tell_problems(experiment)
    else:
        document = show_document(experiment)
        say(json, document, lambda: show_text(document))
    if experiment.raw_problems():
        raise typer.Exit(1)


def note(
    first: Annotated[str, typer.Argument(metavar="[FOLDER] TEXT", help="What to remember.")],
    second: Annotated[str | None, typer.Argument(hidden=True)] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Add a line with the time to the experiment's notes.

    Example: tailbeat experiment note experiments/2026-05-04_fish_thesis_p4_01 "water 22 °C"
    """
    text = first if second is None else second
    if not text.strip():
        raise InputError("the note is empty.", "Say what is to be remembered.")
    if second is None and Path(first).is_dir():
        raise InputError(f"what is to be noted in {first}?", 'Write it behind: note FOLDER "TEXT"')
    experiment = folder_or_current(None if second is None else Path(first), connect)
    experiment.note(text)
    write_redo(experiment)
    say(json, {"folder": experiment.folder, "notes": experiment.notes()}, "noted")


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="An experiment's folder.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one, of the same reference.")],
    what: Annotated[str, typer.Option("--what", metavar="max|rms", help="Which error.")] = "max",
    iterations: Annotated[
        str | None,
        typer.Option("--iterations", metavar="4,5,6", help="Default: repeats of the best input."),
    ] = None,
    json: Json = False,
) -> None:
    """Compare two experiments: effect with its confidence interval, repeats needed.

    Example: tailbeat experiment compare experiments/A experiments/B --iterations 4,5,6
    """
    experiments = [Experiment.open(folder) for folder in (a, b)]
    if a.resolve() == b.resolve():
        raise InputError(f"{a} and {b} are the same experiment.", "Name two.")
    sides = [analyse(experiment) for experiment in experiments]
    found = compare_sides(sides[0], sides[1], what, _numbers(iterations))
    others = other_differences(experiments[0], experiments[1])
    document = {**vars(found), "also_different": others}
    say(json, document, lambda: compared_text(found, others, any(s.simulated for s in sides)))
    for experiment in experiments:
        tell_problems(experiment)


def _numbers(text: str | None) -> list[int] | None:
    if text is None:
        return None
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter("--iterations is like 4,5,6") from None


def replay(folder: Folder, json: Json = False) -> None:
    """Compute everything again from the raw files, and compare each bit.

    Sums of the raw files, speeds and learning by the board's own code, then the analysis and the
    report's figures and tables.

    Example: tailbeat experiment replay experiments/2026-05-04_carangi_thesis_p4_01
    """
    experiment = Experiment.open(folder)
    with TemporaryDirectory() as scratch:
        found = replay_all(experiment, Path(scratch))
    say(json, {**vars(found), "identical": found.identical}, lambda: replay_text(found))
    if not found.identical:
        raise typer.Exit(1)


def export(
    folder: Folder,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", metavar="csv|mat|parquet", help="Default: all; repeatable."),
    ] = None,
    json: Json = False,
) -> None:
    """Write the trials as CSV, MATLAB and Parquet files.

    Example: tailbeat experiment export FOLDER --format csv
    """
    experiment = Experiment.open(folder)
    files = export_files(experiment, formats or [])
    if not formats and (line := missing_formats()):
        echo(f"tailbeat: {line}", err=True)
    say(json, {"files": files}, "\n".join(map(str, files)))
    tell_problems(experiment)
