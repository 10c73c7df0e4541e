"""thesis."""

from __future__ import annotations

import importlib
import shutil
import sys
import textwrap
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tailbeat.app.cli._options import Json
from tailbeat.app.cli._terminal import echo, progress_bar, say
from tailbeat.core.files import plain
from tailbeat.core.parallel import cores_here
from tailbeat.studies.thesis import study
from tailbeat.studies.thesis.example import VERDICTS, Claim, Example, ExampleOptions
from tailbeat.studies.thesis.study import Result, checked, choose

_WIDTH, _WIDTH_MIN, _WIDTH_MAX = 100, 72, 120  # of lines; the first where no terminal is
_SOURCE, _VERDICT = 17, 17  # columns, two spaces between; the claim has the rest
_MEASURED, _MEASURED_NARROW = 19, 11
_SHOWN = (0, 1, 2, 3, 4, 5, 6, 8, 10, 20, 50, 100, 200, 500, 1000)  # iterations, and the last


def thesis(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="CHAPTER|EXAMPLE", help="2 to 8, or an example like ch2-ex1; default: all."
        ),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", metavar="DIR", help="Draw the figures.")
    ] = None,
    lengths: Annotated[
        str | None,
        typer.Option(
            "--lengths",
            metavar="full|uniform|pattern:EXPR",
            help="Lengths of the trials; EXPR: of the iteration i, like 45+3*(i%4).",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Of the drawn lengths and starts; default: 1.")
    ] = None,
    step: Annotated[
        str | None,
        typer.Option(
            "--step", metavar="T", help="Integration and control step; a number or 2*pi/5000."
        ),
    ] = None,
    iterations: Annotated[
        int | None, typer.Option("--iterations", help="Number of the last iteration.")
    ] = None,
    m: Annotated[
        int | None, typer.Option("--m", help="Moving average over m + 1 trials (chapter 3).")
    ] = None,
    beta: Annotated[
        str | None,
        typer.Option("--beta", help="Gain of each of these trials; default: 1/(m + 1)."),
    ] = None,
    delta: Annotated[
        str | None, typer.Option("--delta", metavar="MIN", help="Lead (chapter 7), minutes.")
    ] = None,
    uptake: Annotated[
        Literal["monod", "abs", "clip"] | None,
        typer.Option("--uptake", help="phi below v = 0 (ch7-printed); default: clip."),
    ] = None,
    precision: Annotated[
        Literal["double", "float"],
        typer.Option("--precision", help="Of the laws; float is what the board computes in."),
    ] = "double",
    cores: Annotated[
        int | None, typer.Option("--cores", min=1, help="Processes; default: one per core.")
    ] = None,
    claims: Annotated[
        bool, typer.Option("--claims/--no-claims", help="Judge the thesis's claims.")
    ] = True,
    json: Json = False,
) -> None:
    """Recompute the thesis's examples with the board's laws, and judge its claims.

    Claims are judged at the thesis's own settings. Options change the run that is printed; an
    example that does not know one keeps its own.

    Example: tailbeat sim thesis 8 --figures figures
    """

    given = checked(lengths, seed, step, iterations, m, beta, delta, uptake)
    chosen = choose(_examples(), what, given, ExampleOptions(precision=precision))
    if figures is not None:
        figures.mkdir(parents=True, exist_ok=True)
    orders = [
        study.Order(one.id, options, claims, figures, study.REGISTRY) for one, options in chosen
    ]
    weights = [one.weight for one, _ in chosen]
    with progress_bar(json, "thesis") as show:
        try:
            results = study.run_many(
                orders, weights, cores or cores_here(), lambda done: show(done, f"{done:.0%}")
            )
        except KeyboardInterrupt:
            echo("tailbeat: stopped; nothing is kept. Run it again.", err=True)
            raise typer.Exit(130) from None
    found = [(one, result) for (one, _), result in zip(chosen, results, strict=True)]
    document = {
        "examples": [_document(one, result) for one, result in found],
        "verdicts": _counts(results, ours=False),
        "verdicts_ours": _counts(results, ours=True),
    }
    say(json, document, lambda: _text(found, set(given), _width()))


def _examples() -> tuple[Example, ...]:
    examples: tuple[Example, ...] = importlib.import_module(study.REGISTRY).EXAMPLES
    return examples


def _document(example: Example, result: Result) -> dict[str, Any]:
    return {
        "id": example.id,
        "chapter": example.chapter,
        "title": example.title,
        "law": example.law,
        "settings": example.settings_of(result.options),
        "iterations": result.iterations,
        "max_abs_error": result.max_abs_error,
        "executed_max_abs_error": result.executed,
        "lengths": result.lengths,
        "diverged_at": result.diverged,
        "claims": result.claims,
        "figures": result.figures,
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


def _text(found: list[tuple[Example, Result]], given: set[str], width: int) -> str:
    parts = []
    for example, result in found:
        parts += _wrapped(f"{example.id}: {example.title}; {example.law}", "  ", width)
        if given & example.knows or result.options.precision != "double":
            parts += _settings(example, result, width)
        parts += _errors(result, width)
        if result.claims:
            parts += ["", *_claims(result.claims, width)]
        parts += _figures(result, width)
        parts.append("")
    results = [result for _, result in found]
    judged = _in_words(_counts(results, ours=False)) or "none judged"
    parts += _wrapped(f"claims: {judged}", "  ", width)
    if beside := _in_words(_counts(results, ours=True)):
        parts += _wrapped(f"beside them, not the thesis's: {beside}", "  ", width)
    return "\n".join(parts)


def _in_words(counts: dict[str, int]) -> str:
    if not any(counts.values()):
        return ""
    return ", ".join(f"{verdict} {count}" for verdict, count in counts.items())


def _settings(example: Example, result: Result, width: int) -> list[str]:
    found = example.settings_of(result.options).items()
    words = ", ".join(f"{name} {_figure(value)}" for name, value in found if value is not None)
    return _wrapped(f"settings: {words}", "  ", width)


def _errors(result: Result, width: int) -> list[str]:
    last = int(result.iterations[-1]) if len(result.iterations) else -1
    cells = [
        f"{i}: {_figure(error, '/')}"
        for i, error in zip(plain(result.iterations), plain(result.max_abs_error), strict=True)
        if i in _SHOWN or i == last
    ]
    if result.diverged is not None:
        cells.append(f"diverged at {result.diverged}")
    return _wrapped("max|e| in iteration " + ", ".join(cells), "  ", width)


def _claims(claims: list[Claim], width: int) -> list[str]:
    """The thesis's, then those beside them."""
    last = _MEASURED if width >= _WIDTH else _MEASURED_NARROW
    columns = (width - _SOURCE - _VERDICT - last - 6, _SOURCE, _VERDICT, last)
    lines: list[str] = []
    for head, ours in (("claim", False), ("beside the thesis's claims", True)):
        some = [claim for claim in claims if claim.ours == ours]
        if not some:
            continue
        lines += [""] if lines else []
        lines += _row((head, "source", "verdict", "measured"), columns)
        lines.append("  ".join("-" * column for column in columns))
        lines += [line for claim in some for line in _lines(claim, columns, width)]
    return lines


def _lines(claim: Claim, columns: tuple[int, ...], width: int) -> list[str]:
    """What was measured has a line of its own below where it does not fit beside."""
    measured = _figure(plain(claim.measured))
    fits = len(measured) <= columns[-1]
    beside = measured if fits else "see below"
    lines = _row((claim.text, claim.source, claim.verdict, beside), columns)
    if not fits:
        lines += _wrapped(f"  measured: {measured}", "    ", width)
    if claim.note:
        lines += _wrapped(f"  {claim.note}", "  ", width)
    return lines


def _row(cells: tuple[str, ...], columns: tuple[int, ...]) -> list[str]:
    wrapped = [textwrap.wrap(cell, width) for cell, width in zip(cells, columns, strict=True)]
    height = max(len(lines) for lines in wrapped)
    return [
        "  ".join(
            (lines[i] if i < len(lines) else "").ljust(width)
            for lines, width in zip(wrapped, columns, strict=True)
        ).rstrip()
        for i in range(height)
    ]


def _figures(result: Result, width: int) -> list[str]:
    lines = []
    for figure in result.figures:
        lines += _wrapped(f"figure {figure.path}: {figure.name}, {figure.caption}", "  ", width)
        if figure.contradicts:
            against = f"  contradicted by the text's own numbers: {figure.contradicts}"
            lines += _wrapped(against, "    ", width)
    return ["", *lines] if lines else []


def _wrapped(text: str, indent: str, width: int) -> list[str]:
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
