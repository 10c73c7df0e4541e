"""report: a page and figures of an experiment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._terminal import Json, echo, say

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.report.paper import Written

_ROOT = Path("experiments")


def report(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="FOLDER",
            help="The experiment's folder; default: the newest below --root.",
            show_default=False,
        ),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="Also figures as PDF and SVG, captions and tables.")
    ] = False,
    against: Annotated[
        list[Path] | None,
        typer.Option("--against", metavar="FOLDER", help="Compare with another; repeatable."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Default: report/ in the experiment.", show_default=False
        ),
    ] = None,
    root: Annotated[
        Path, typer.Option("--root", help="Folder that holds the experiments.")
    ] = _ROOT,
    json: Json = False,
) -> None:
    """Write one page about an experiment, and figures and tables for a paper.

    Example: tailbeat report --paper
    """
    from tailbeat.experiment.export import missing_formats
    from tailbeat.experiment.folder import Experiment
    from tailbeat.experiment.redo import write_redo
    from tailbeat.report.paper import write_report

    chosen = Experiment.open(folder) if folder else newest(root)
    others = [Experiment.open(one) for one in against or []]
    written = write_report(chosen, paper, others, out)
    write_redo(chosen)
    document = {
        "experiment": chosen.folder,
        "page": written.page,
        "figures": written.figures,
        "tables": written.tables,
    }
    if written.tables and (line := missing_formats()):
        echo(f"tailbeat: {line}", err=True)
    say(json, document, lambda: _text(chosen, written, named=folder is not None))


def newest(root: Path) -> Experiment:
    """The one made last below ``root``. Raises InputError when there is none."""
    from tailbeat.core.errors import InputError
    from tailbeat.experiment.folder import list_experiments

    found = list_experiments(root)
    if not found:
        raise InputError(
            f"there is no experiment below {root}.",
            "Name its folder, or begin one: tailbeat experiment new --reference thesis",
        )
    return max(found, key=_made)


def _made(experiment: Experiment) -> tuple[float, str]:
    """When, by its settings; one without a time is the oldest."""
    from datetime import datetime

    try:
        moment = datetime.fromisoformat(str(experiment.settings().get("made", "")))
    except ValueError:
        return 0.0, experiment.name
    return moment.timestamp(), experiment.name


def _text(experiment: Experiment, written: Written, named: bool) -> str:
    lines = [] if named else [f"the newest: {experiment.folder}"]
    lines.append(str(written.page))
    if written.figures:
        lines.append(f"{len(written.figures)} files of figures in {written.figures[0].parent}")
    if written.tables:
        lines.append(f"{len(written.tables)} tables in {written.tables[0].parent}")
    return "\n".join(lines)
