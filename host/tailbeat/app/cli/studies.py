"""sim thesis, montecarlo."""

from __future__ import annotations

import importlib
import math
import re
import secrets
import shutil
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import typer

from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, echo, lines_of, pick, progress_bar, table, warn
from tailbeat.core.files import plain
from tailbeat.core.platform.programs import cores_here
from tailbeat.core.printable import mm
from tailbeat.studies.montecarlo.cell import cells
from tailbeat.studies.montecarlo.recipe import Recipe, load, packaged
from tailbeat.studies.montecarlo.runner import Interrupted, StudyFolder, run_study
from tailbeat.studies.montecarlo.summary import (
    ClaimResult,
    GroupSummary,
    StudySummary,
    render,
    summarise,
)
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import VERDICTS, Claim, Example, ExampleOptions
from tailbeat.studies.thesis.paper import Paper, write_html, write_pdf
from tailbeat.studies.thesis.picture import contact_sheet
from tailbeat.studies.thesis.study import Result, checked, choose

_WIDTH, _WIDTH_MIN, _WIDTH_MAX = 100, 72, 120  # of lines; the first where no terminal is
_SOURCE, _VERDICT = 17, 17  # columns, two spaces between; the claim has the rest
_MEASURED, _MEASURED_NARROW = 19, 11
_SHOWN = (0, 1, 2, 3, 4, 5, 6, 8, 10, 20, 50, 100, 200, 500, 1000)  # iterations, and the last


def thesis(
    what: str | None = arg("2 to 8, or an example like ch2-ex1; default: all.", "CHAPTER|EXAMPLE"),
    figures: Path | None = opt("Draw the figures.", "DIR"),
    paper: Path | None = opt("Write ledger, findings and figures as thesis.pdf and .html.", "DIR"),
    lengths: str | None = opt(
        "Lengths of the trials; EXPR: of the iteration i, like 45+3*(i%4).",
        "full|uniform|pattern:EXPR",
    ),
    seed: int | None = opt("Of the drawn lengths and starts; default: 1."),
    step: str | None = opt("Integration and control step; a number or 2*pi/5000.", "T"),
    iterations: int | None = opt("Number of the last iteration."),
    m: int | None = opt("Moving average over m + 1 trials (chapter 3)."),
    beta: str | None = opt("Gain of each of these trials; default: 1/(m + 1)."),
    delta: str | None = opt("Lead (chapter 7), minutes.", "MIN"),
    uptake: Literal["monod", "abs", "clip"] | None = opt(
        "phi below v = 0 (ch7-printed); default: clip."
    ),
    precision: Literal["double", "float"] = opt(
        "Of the laws; float is what the board computes in.", default="double"
    ),
    cores: int | None = opt("Processes; default: one per core.", min=1),
    claims: bool = opt("Judge the thesis's claims.", name="--claims/--no-claims", default=True),
) -> Output:
    """Recompute the thesis's examples with the board's laws, and judge its claims.

    Claims are judged at the thesis's own settings. Options change the computation that is printed;
    an example that does not know one keeps its own.

    Example: tailbeat sim thesis 8 --figures figures
    """
    given = checked(lengths, seed, step, iterations, m, beta, delta, uptake)
    chosen = choose(
        importlib.import_module(study.REGISTRY).EXAMPLES,
        what,
        given,
        ExampleOptions(precision=precision),
    )
    folder = figures or paper
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    orders = [
        study.Order(one.id, options, claims, folder, study.REGISTRY) for one, options in chosen
    ]
    results = _computed(orders, [one.weight for one, _ in chosen], cores or cores_here())
    found = [(one, result) for (one, _), result in zip(chosen, results, strict=True)]
    if folder is not None:
        _write_sheets(found, folder, paper)
    document = {
        "examples": [_thesis_document(one, result) for one, result in found],
        "verdicts": _counts(results, ours=False),
        "verdicts_ours": _counts(results, ours=True),
    }
    return Output(document, lambda: _thesis_text(found, set(given), _width()))


def _computed(orders: list[study.Order], weights: list[float], cores: int) -> list[Result]:
    with progress_bar("thesis") as show:
        try:
            return study.run_many(orders, weights, cores, lambda done: show(done, f"{done:.0%}"))
        except KeyboardInterrupt:
            echo("tailbeat: stopped; nothing is kept. Run it again.", err=True)
            raise typer.Exit(130) from None


def _write_sheets(found: list[tuple[Example, Result]], figures: Path, paper: Path | None) -> None:
    _contact_sheet([result for _, result in found], figures)
    if paper is not None:
        paper.mkdir(parents=True, exist_ok=True)
        _write_paper(found, paper)


def _write_paper(found: list[tuple[Example, Result]], folder: Path) -> None:
    claims = [claim for _, result in found for claim in result.claims]
    figures = [one for _, result in found for one in result.figures if one.name]
    figures.sort(key=lambda one: _in_order(one.path.stem))
    sketches = [(one, sketch) for one, _ in found for sketch in one.figures if sketch.name]
    sketches.sort(key=lambda pair: _in_order(pair[1].number))
    made = Paper(claims, figures)
    write_html(made, folder / "thesis.html")
    with progress_bar("paper") as show:
        pdf = folder / "thesis.pdf"
        write_pdf(made, sketches, pdf, lambda done: show(done, f"{done:.0%}"))


def _in_order(number: str) -> list[str]:
    """To sort by: 2.9 before 2.10, A.1 last."""
    return [f"{part:0>3}" for part in re.split(r"[.-]", number)]


def _contact_sheet(results: list[Result], folder: Path) -> None:
    drawn = [figure for result in results for figure in result.figures]
    drawn.sort(key=lambda one: _in_order(one.path.stem))
    if drawn:
        pictures = [(one.name or one.path.stem, one.path.with_suffix(".png")) for one in drawn]
        contact_sheet(pictures, folder / "contact-sheet.png")


def _thesis_document(example: Example, result: Result) -> dict[str, Any]:
    return {
        **pick(example, "id", "chapter", "title", "law", "on_board"),
        "settings": example.settings_of(result.options),
        **pick(result, "iterations", "max_abs_error", "lengths", "claims", "figures"),
        "executed_max_abs_error": result.executed,
        "diverged_at": result.diverged,
    }


def _counts(results: list[Result], ours: bool) -> dict[str, int]:
    """By verdict, of the thesis's claims or of those beside them."""
    claims = (claim for result in results for claim in result.claims if claim.ours == ours)
    counted = Counter(claim.verdict for claim in claims)
    return {verdict: counted[verdict] for verdict in VERDICTS}


def _width() -> int:
    """Of lines: the terminal's, within what can be read."""
    if not sys.stdout.isatty():
        return _WIDTH
    return min(max(shutil.get_terminal_size().columns, _WIDTH_MIN), _WIDTH_MAX)


def _thesis_text(found: list[tuple[Example, Result]], given: set[str], width: int) -> str:
    texts = _paragraphs(found, given, width)
    return "\n".join(line for text in texts for line in _wrapped(text, width) or [""])


def _paragraphs(found: list[tuple[Example, Result]], given: set[str], width: int) -> Iterator[str]:
    for example, result in found:
        where = "" if example.on_board else ", not on the board"
        yield f"{example.id}: {example.title}; {example.law}{where}"
        if given & example.knows or result.options.precision != "double":
            values = example.settings_of(result.options).items()
            words = ", ".join(f"{name} {_figure(one)}" for name, one in values if one is not None)
            yield f"settings: {words}"
        yield _errors(result)
        yield from _claims(result.claims, width)
        yield from [""] if result.figures else []
        for figure in result.figures:
            yield f"figure {figure.path}: {', '.join(filter(None, (figure.name, figure.caption)))}"
            if figure.contradicts:
                yield f"  contradicted by the text's own numbers: {figure.contradicts}"
        yield ""
    results = [result for _, result in found]
    yield f"claims: {_in_words(_counts(results, ours=False)) or 'none judged'}"
    if beside := _in_words(_counts(results, ours=True)):
        yield f"beside them, not the thesis's: {beside}"


def _in_words(counts: dict[str, int]) -> str:
    words = ", ".join(f"{verdict} {count}" for verdict, count in counts.items())
    return words if any(counts.values()) else ""


def _errors(result: Result) -> str:
    last = int(result.iterations[-1]) if len(result.iterations) else -1
    cells = [
        f"{i}: {_figure(error, '/')}"
        for i, error in zip(plain(result.iterations), plain(result.max_abs_error), strict=True)
        if i in _SHOWN or i == last
    ]
    cells += [] if result.diverged is None else [f"diverged at {result.diverged}"]
    return "max|e| in iteration " + ", ".join(cells)


def _claims(claims: list[Claim], width: int) -> Iterator[str]:
    """The thesis's, then those beside them."""
    last = _MEASURED if width >= _WIDTH else _MEASURED_NARROW
    columns = (width - _SOURCE - _VERDICT - last - 6, _SOURCE, _VERDICT, last)
    for head, ours in (("claim", False), ("beside the thesis's claims", True)):
        if some := [claim for claim in claims if claim.ours == ours]:
            yield from ["", *_row((head, "source", "verdict", "measured"), columns)]
            yield "  ".join("-" * column for column in columns)
            for claim in some:
                yield from _lines(claim, columns, width)


def _lines(claim: Claim, columns: tuple[int, ...], width: int) -> Iterator[str]:
    """What was measured has a line of its own below where it does not fit beside."""
    measured = _figure(plain(claim.measured))
    fits = len(measured) <= columns[-1]
    beside = measured if fits else "see below"
    yield from _row((claim.claim, claim.where, claim.verdict, beside), columns)
    if not fits:
        yield f"  measured: {measured}"
    if claim.note:
        yield from _wrapped(f"  {claim.note}", width, "  ")


def _row(cells: tuple[str, ...], columns: tuple[int, ...]) -> list[str]:
    wrapped = [textwrap.wrap(cell, width) for cell, width in zip(cells, columns, strict=True)]
    return [
        "  ".join(map(str.ljust, line, columns)).rstrip()
        for line in zip_longest(*wrapped, fillvalue="")
    ]


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    """Further lines stand two columns to the right of the first, unless there is an ``indent``."""
    indent = indent or " " * (len(text) - len(text.lstrip()) + 2)
    return textwrap.wrap(text, width, subsequent_indent=indent, break_on_hyphens=False)


def _figure(value: Any, between: str = ", ") -> str:
    """A number or several, to four digits; null is one that is not finite."""
    if isinstance(value, list):
        return between.join(_figure(one) for one in value) if value else "-"
    if value is None:
        return "-"
    if isinstance(value, bool | str | int):
        return str(value)
    return f"{value:.4g}"


SWEEPS = Path("sweeps")
_STUDY_SHOWN = (1, 2, 3, 4, 6, 10, 20, 40)  # iterations of the table, and the last
_FAILURES_SHOWN = 5


def montecarlo(
    recipe: str | None = arg("Name of one, or a TOML file.", "RECIPE"),
    out: Path | None = opt("Folder of the results; default: sweeps/RECIPE."),
    cores: int | None = opt("Processes; default: one per core.", min=1),
    seeds: int | None = opt("Fish of each kind; default: the recipe's.", min=1),
    pinned: bool = opt("The recipe's own fish, for regressions; default: others each time."),
    scheduler: str | None = opt("Compute on a Dask cluster.", "tcp://HOST:PORT"),
    plant: Path | None = opt("Fish compiled elsewhere, instead of the recipe's.", "FILE.so"),
    plot: Path | None = opt("Draw the curves.", "PNG"),
    check: bool = opt("Fail when a claim does not hold; with --pinned, when one is open, too."),
    summary: Path | None = opt("Compute nothing; sum up what is there.", "DIR"),
    list_: bool = opt("Print the recipes that come with it."),
) -> Output:
    """Run a study with many simulated fish, and check what holds for all of them.

    Results are kept: after Ctrl-C the same command continues.

    Example: tailbeat sim montecarlo designed-law --plot designed.png
    """
    if list_:
        return _recipes()
    if summary is not None:
        store, about = StudyFolder(summary), {"out": summary}
        chosen = store.recipe() if recipe is None else load(recipe)
    else:
        if recipe is None:
            raise typer.BadParameter("no recipe; 'tailbeat sim montecarlo --list' names them")
        chosen = load(recipe)
        chosen = chosen if seeds is None else chosen.with_seeds(seeds)
        chosen = chosen if plant is None else chosen.with_plant(plant)
        if plant is not None and scheduler is not None:
            raise typer.BadParameter("--plant is of this computer; leave out --scheduler")
        out = out or SWEEPS / chosen.name
        if not pinned:
            chosen = chosen.with_first_seed(StudyFolder(out).first_seed() or _fresh_seed())
        store, about = StudyFolder(out), _compute(chosen, out, cores, scheduler)
    found = summarise(chosen, store.read())
    if plot is not None:
        render(found, plot)
        about["plot"] = plot
    status = int(bool(check and (found.failed or (pinned and found.open))))
    return Output(_study_document(found) | about, lambda: _study_text(found, about), status)


def _fresh_seed() -> int:
    """Far from those that recipes pin; the fish of a study are those from it on."""
    return 1_000_000 * (1 + secrets.randbelow(4000))


def _compute(recipe: Recipe, out: Path, cores: int | None, scheduler: str | None) -> dict[str, Any]:
    with progress_bar(recipe.name) as show:

        def progress(done: int, total: int) -> None:
            show(done / total, f"{done}/{total} cells")

        try:
            outcome = run_study(recipe, out, cores, scheduler, progress)
        except Interrupted as stopped:
            warn(stopped)
            raise typer.Exit(130) from None
    return {
        "out": out,
        "results": outcome.results,
        "computed_cells": outcome.computed,
        "first_seed": recipe.first_seed,
    }


def _recipes() -> Output:
    recipes = [load(name) for name in packaged()]
    rows = [
        pick(one, "name", "title", "seeds")
        | {"cells": len(cells(one)), "claims": [claim.text for claim in one.claims]}
        for one in recipes
    ]
    text = table(["recipe", "what it shows"], [[r.name, r.title] for r in recipes], left=(0, 1))
    return Output({"recipes": rows}, text)


def _study_document(found: StudySummary) -> dict[str, Any]:
    return {
        **pick(found, "recipe", "title", "claims"),
        "groups": [vars(line) | {"over_floor": line.over_floor} for line in found.lines],
        "failed": len(found.failed),
        "open": len(found.open),
        "failed_fish": found.failures,
    }


def _study_text(found: StudySummary, about: dict[str, Any]) -> str:
    return lines_of(
        f"{found.title}: true max|e| in mm/s, median [5 %, 95 %] over fish",
        _group_table(found.lines),
        found.claims and ["", *map(_claim_line, found.claims)],
        found.failures and ["", *_failed_fish(found.failures)],
        "first_seed" in about and f"fish of the seeds from {about['first_seed']} on",
        f"results {about.get('results', about['out'])}",
        "plot" in about and f"plot {about['plot']}",
    )


def _failed_fish(failures: Sequence[object]) -> list[str]:
    more = len(failures) - _FAILURES_SHOWN
    return [
        f"{len(failures)} fish failed; claims that speak of them do not hold:",
        *(f"  {one}" for one in failures[:_FAILURES_SHOWN]),
        *([f"  and {more} more: --json names all"] if more > 0 else []),
    ]


def _group_table(lines: list[GroupSummary]) -> str:
    last = max(len(line.median_m_s) for line in lines) - 1
    shown = sorted({i for i in (*_STUDY_SHOWN, last) if i <= last})
    names = [
        name
        for name in ("plant", "law", "noise", "corner", "reference")
        if len({getattr(line, name) for line in lines}) > 1
    ] or ["plant"]
    header = [*names, "fish", *map(str, shown), "bound", "last/bound"]
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


def _claim_line(claim: ClaimResult) -> str:
    word = "holds" if claim.holds else "open" if claim.is_open else "FAILS"
    where = f" ({claim.group})" if claim.group else ""
    low, high = claim.interval
    within = f" [{low:.3g}, {high:.3g}]" if math.isfinite(low) else ""
    return f"{word}: {claim.text}: {claim.figure:.3g}{within}, {claim.bound}{where}"
