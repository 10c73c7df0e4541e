"""experiment new, list, note, export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.cli.common import Connect, Json, connected, say

app = typer.Typer(no_args_is_help=True, help="Folders that hold everything of a series of trials.")

Root = Annotated[Path, typer.Option("--root", help="Folder that holds the experiments.")]
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="The experiment's folder.")]


@app.command()
def new(
    reference: Annotated[str, typer.Option("--reference", help="As in 'reference upload'.")],
    fish_name: Annotated[str | None, typer.Option("--fish", help="Name of the fish.")] = None,
    root: Root = Path("experiments"),
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Make the folder of a new series, with the settings of the connected board.

    Example: tailbeat experiment new --reference thesis --fish carangi
    """
    from tailbeat.experiment import Experiment
    from tailbeat.laws import Law, Past
    from tailbeat.reference import from_text

    wanted = from_text(reference)
    with connected(connect) as fish:
        board = fish.info()
        params = {name: p.value for name, p in fish.params.list().items()}
    law = Past.from_params(params).label() + Law.from_params(params, wanted.beat_s).label()
    made = Experiment.new(root, fish_name or board.board, wanted.name, law)
    made.write_settings(
        {
            "simulated": board.simulated,
            "params": params,
            "firmware": board.build_id,
            "board": board.board,
            "unique_id": board.unique_id,
        }
    )
    made.add_raw("reference.bin", wanted.record())
    wanted.to_csv(made.folder / "reference.csv")
    say(json, {"folder": made.folder}, str(made.folder))


@app.command("list")
def list_(root: Root = Path("experiments"), json: Json = False) -> None:
    """Print the experiments below a folder, oldest first.

    Example: tailbeat experiment list
    """
    from tailbeat.experiment import list_experiments

    found = list_experiments(root)
    rows: list[dict[str, Any]] = [
        {
            "name": experiment.name,
            "folder": experiment.folder,
            "trials": len(list(experiment.raw.glob("*.ulg"))),
            "damaged": experiment.damaged(),
        }
        for experiment in found
    ]
    lines = [
        f"{row['name']}  {row['trials']} trial{'' if row['trials'] == 1 else 's'}"
        + (f"  DAMAGED: {', '.join(row['damaged'])}" if row["damaged"] else "")
        for row in rows
    ]
    say(json, {"experiments": rows}, "\n".join(lines) or f"no experiments in {root}")


@app.command()
def note(
    folder: Folder,
    text: Annotated[str, typer.Argument(help="What you want to remember.")],
    json: Json = False,
) -> None:
    """Add a line with the time to the experiment's notes.

    Example: tailbeat experiment note experiments/2026-05-04_fish_thesis_p4_01 "water 22 °C"
    """
    from tailbeat.experiment import Experiment

    experiment = Experiment.open(folder)
    experiment.note(text)
    say(json, {"folder": folder, "notes": experiment.notes()}, "noted")


@app.command()
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
    from tailbeat.experiment import Experiment
    from tailbeat.experiment import export as export_files
    from tailbeat.experiment.export import FORMATS

    files = export_files(Experiment.open(folder), formats or list(FORMATS))
    say(json, {"files": files}, "\n".join(map(str, files)))
