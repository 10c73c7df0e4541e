"""sweep."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.app.cli._options import Json
from tailbeat.app.cli._terminal import echo, mm, progress_bar, say, table
from tailbeat.studies.montecarlo.cell import cells
from tailbeat.studies.montecarlo.plot import render
from tailbeat.studies.montecarlo.recipe import Recipe, load, packaged
from tailbeat.studies.montecarlo.runner import Interrupted, StudyFolder, run_study
from tailbeat.studies.montecarlo.summary import ClaimResult, GroupSummary, StudySummary, summarise

SWEEPS = Path("sweeps")
_SHOWN = (1, 2, 3, 4, 6, 10, 20, 40)  # iterations of the table, and the last
_FAILURES_SHOWN = 5


def sweep(
    recipe: Annotated[
        str | None, typer.Argument(metavar="RECIPE", help="Name of one, or a TOML file.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results; default: sweeps/RECIPE.")
    ] = None,
    cores: Annotated[
        int | None, typer.Option("--cores", min=1, help="Processes; default: one per core.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, help="Fish of each kind; default: the recipe's.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="Compute on a Dask cluster."),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Draw the curves.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Fail when a claim of the recipe does not hold.")
    ] = False,
    summary: Annotated[
        Path | None,
        typer.Option("--summary", metavar="DIR", help="Compute nothing; sum up what is there."),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="Print the recipes that come with it.")] = (
        False
    ),
    json: Json = False,
) -> None:
    """Run a study with many simulated fish, and check what holds for all of them.

    Results are kept: after Ctrl-C the same command continues.

    Example: tailbeat sim montecarlo designed-law --plot designed.png
    """

    if list_:
        _list(json)
        return
    if summary is not None:
        store, about = StudyFolder(summary), {"out": summary}
        wanted = store.recipe() if recipe is None else load(recipe)
    else:
        if recipe is None:
            raise typer.BadParameter("no recipe; 'tailbeat sim montecarlo --list' names them")
        wanted = load(recipe)
        wanted = wanted if seeds is None else wanted.with_seeds(seeds)
        out = out or SWEEPS / wanted.name
        store, about = StudyFolder(out), _compute(wanted, out, cores, scheduler, json)
    found = summarise(wanted, store.read())
    if plot is not None:
        render(found, plot)
        about["plot"] = plot
    say(json, _document(found) | about, lambda: _text(found, about))
    if check and found.failed:
        raise typer.Exit(1)


def _compute(
    recipe: Recipe, out: Path, cores: int | None, scheduler: str | None, json: bool
) -> dict[str, Any]:

    begin_s = time.monotonic()
    first: list[int] = []
    with progress_bar(json, recipe.name) as show:

        def progress(done: int, total: int) -> None:
            first.append(done)
            spent_s = time.monotonic() - begin_s
            left_s = spent_s / (done - first[0]) * (total - done) if done > first[0] else None
            words = f"{done}/{total} cells"
            show(done / total, words + (f", {_duration(left_s)} left" if left_s else ""))

        try:
            outcome = run_study(recipe, out, cores, scheduler, progress)
        except Interrupted as stopped:
            echo(f"tailbeat: {stopped}", err=True)
            raise typer.Exit(130) from None
    return {"out": out, "results": outcome.results, "computed_cells": outcome.computed}


def _duration(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole} s" if whole < 100 else f"{round(whole / 60)} min"


def _list(json: bool) -> None:

    recipes = [load(name) for name in packaged()]
    rows = [
        {
            "name": one.name,
            "title": one.title,
            "cells": len(cells(one)),
            "seeds": one.seeds,
            "claims": [claim.text for claim in one.claims],
        }
        for one in recipes
    ]
    text = table(["recipe", "what it shows"], [[r.name, r.title] for r in recipes], left=(0, 1))
    say(json, {"recipes": rows}, text)


def _document(found: StudySummary) -> dict[str, Any]:
    return {
        "recipe": found.recipe,
        "title": found.title,
        "groups": [vars(line) | {"over_floor": line.over_floor} for line in found.lines],
        "claims": [vars(claim) for claim in found.claims],
        "failed": len(found.failed),
        "failed_fish": found.failures,
    }


def _text(found: StudySummary, about: dict[str, Any]) -> str:
    parts = [f"{found.title}: true max|e| in mm/s, median [5 %, 95 %] over fish"]
    parts.append(_table(found.lines))
    if found.claims:
        parts += ["", *[_claim(claim) for claim in found.claims]]
    if found.failures:
        parts += ["", *_failures(found)]
    parts.append(f"results {about.get('results', about['out'])}")
    if "plot" in about:
        parts.append(f"plot {about['plot']}")
    return "\n".join(parts)


def _failures(found: StudySummary) -> list[str]:
    first = [f"  {one}" for one in found.failures[:_FAILURES_SHOWN]]
    more = len(found.failures) - len(first)
    return [
        f"{len(found.failures)} fish failed; claims that speak of them do not hold:",
        *first,
        *([f"  and {more} more: --json names all"] if more else []),
    ]


def _table(lines: list[GroupSummary]) -> str:
    last = max(len(line.median_m_s) for line in lines) - 1
    shown = sorted({i for i in (*_SHOWN, last) if i <= last})
    names = [
        name
        for name in ("plant", "law", "noise", "corner", "reference")
        if len({getattr(line, name) for line in lines}) > 1
    ] or ["plant"]
    header = [*names, "fish", *map(str, shown), "floor", "last/floor"]
    rows = [
        [
            *(getattr(line, name) for name in names),
            str(line.fish),
            *(_cell(line, i) for i in shown),
            mm(line.floor_lsq_m_s),
            f"{line.over_floor:.2f}",
        ]
        for line in lines
    ]
    return table(header, rows, left=tuple(range(len(names))))


def _cell(line: GroupSummary, i: int) -> str:
    if i >= len(line.median_m_s):
        return ""
    return f"{mm(line.median_m_s[i])} [{mm(line.low_m_s[i])}, {mm(line.high_m_s[i])}]"


def _claim(claim: ClaimResult) -> str:
    word = "holds" if claim.holds else "FAILS"
    where = f" ({claim.group})" if claim.group else ""
    return f"{word}: {claim.text}: {claim.figure:.3g}, {claim.bound}{where}"
