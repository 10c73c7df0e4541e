"""Options that several commands have, each declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document, nothing else.")]
Connect = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="URL",
        envvar="TAILBEAT_CONNECT",
        help="Serial path, tcp:HOST:PORT, udp:PORT, sim[:plant] or vboard; default: find the fish.",
        show_default=False,
    ),
]
IdentifiedFile = Annotated[
    Path | None,
    typer.Option("--identified", metavar="FILE", help="What 'session identify' wrote."),
]
Plot = Annotated[Path | None, typer.Option("--plot", metavar="PNG", help="Draw it.")]
Library = Annotated[
    Path | None,
    typer.Option("--library", metavar="DIR", help="Folder of the trial libraries."),
]
Into = Annotated[
    Path | None,
    typer.Option("--into", metavar="FOLDER", help="The experiment; default: the fish's current."),
]
Rest = Annotated[
    float | None,
    typer.Option(
        "--rest", min=0.0, max=3600.0, metavar="S", help="Rest since the last trial; default: 30."
    ),
]
Root = Annotated[Path, typer.Option("--root", help="Folder that holds the experiments.")]
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
    str | None,
    typer.Option(
        "--reference",
        help="As for 'reference upload'; default: the board's (without a board: thesis).",
        autocompletion=reference_names,
        show_default=False,
    ),
]
