"""thesis."""

from __future__ import annotations

import textwrap
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tailbeat.cli.common import Json, plain, progress_bar, say

if TYPE_CHECKING:
    from tailbeat.thesis.example import Claim, Example
    from tailbeat.thesis.study import Result

_WIDTH = 100
_COLUMNS = (42, 17, 16, 19)  # claim, source, verdict, measured; two spaces between
_SHOWN = (0, 1, 2, 3, 4, 5, 6, 8, 10, 20, 50, 100, 200, 500, 1000)  # iterations, and the last


def thesis(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[CHAPTER|EXAMPLE]", help="2 to 8, or an example like ch2-ex1; default: all."
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

    Example: tailbeat thesis 8 --figures figures
    """
    from tailbeat.sweep.runner import cores_here
    from tailbeat.thesis import study
    from tailbeat.thesis.choice import checked, choose
    from tailbeat.thesis.options import Options

    given = checked(lengths, seed, step, iterations, m, beta, delta)
    chosen = choose(_examples(), what, given, Options(precision=precision))
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
            typer.echo("tailbeat: stopped; nothing is kept. Run it again.", err=True)
            raise typer.Exit(130) from None
    found = [(one, result) for (one, _), result in zip(chosen, results, strict=True)]
    document = {
        "examples": [_document(one, result, set(given)) for one, result in found],
        "verdicts": _counts(results),
    }
    say(json, document, lambda: _text(found))


def _examples() -> tuple[Example, ...]:
    import importlib

    from tailbeat.thesis import study

    examples: tuple[Example, ...] = importlib.import_module(study.REGISTRY).EXAMPLES
    return examples


def _document(example: Example, result: Result, given: set[str]) -> dict[str, Any]:
    asked = sorted(given & example.knows)
    return {
        "id": example.id,
        "chapter": example.chapter,
        "title": example.title,
        "law": example.law,
        "settings": {name: getattr(result.options, name) for name in [*asked, "precision"]},
        "iterations": result.iterations,
        "max_abs_error": result.max_abs_error,
        "executed_max_abs_error": result.executed,
        "lengths": result.lengths,
        "diverged_at": result.diverged,
        "claims": result.claims,
        "figures": result.figures,
    }


def _counts(results: list[Result]) -> dict[str, int]:
    from tailbeat.thesis.example import VERDICTS

    counted = Counter(claim.verdict for result in results for claim in result.claims)
    return {verdict: counted[verdict] for verdict in VERDICTS}


def _text(found: list[tuple[Example, Result]]) -> str:
    parts = []
    for example, result in found:
        parts += [*_wrapped(f"{example.id}: {example.title}; {example.law}", "  "), _errors(result)]
        if result.claims:
            parts += ["", *_claims(result.claims)]
        parts += _figures(result)
        parts.append("")
    counts = _counts([result for _, result in found])
    words = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return "\n".join([*parts, f"claims: {words if any(counts.values()) else 'none judged'}"])


def _errors(result: Result) -> str:
    last = int(result.iterations[-1]) if len(result.iterations) else -1
    cells = [
        f"{i}: {_figure(error, '/')}"
        for i, error in zip(plain(result.iterations), plain(result.max_abs_error), strict=True)
        if i in _SHOWN or i == last
    ]
    if result.diverged is not None:
        cells.append(f"diverged at {result.diverged}")
    return "\n".join(_wrapped("max|e| in iteration " + ", ".join(cells), "  "))


def _claims(claims: list[Claim]) -> list[str]:
    lines = _row(("claim", "source", "verdict", "measured"))
    lines.append("  ".join("-" * width for width in _COLUMNS))
    for claim in claims:
        lines += _row((claim.text, claim.source, claim.verdict, _figure(plain(claim.measured))))
        if claim.note:
            lines += textwrap.wrap(claim.note, _WIDTH, initial_indent="  ", subsequent_indent="  ")
    return lines


def _row(cells: tuple[str, ...]) -> list[str]:
    wrapped = [textwrap.wrap(cell, width) for cell, width in zip(cells, _COLUMNS, strict=True)]
    height = max(len(lines) for lines in wrapped)
    return [
        "  ".join(
            (lines[i] if i < len(lines) else "").ljust(width)
            for lines, width in zip(wrapped, _COLUMNS, strict=True)
        ).rstrip()
        for i in range(height)
    ]


def _figures(result: Result) -> list[str]:
    lines = []
    for figure in result.figures:
        lines += _wrapped(f"figure {figure.path}: {figure.name}, {figure.caption}", "  ")
        if figure.contradicts:
            lines += _wrapped(f"  contradicted by the text's own numbers: {figure.contradicts}")
    return ["", *lines] if lines else []


def _wrapped(text: str, indent: str = "    ") -> list[str]:
    return textwrap.wrap(text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False)


def _figure(value: Any, between: str = ", ") -> str:
    """A number or several, to four digits; null is one that is not finite."""
    if isinstance(value, list):
        return between.join(_figure(one) for one in value) if value else "-"
    if value is None:
        return "-"
    if isinstance(value, bool | str | int):
        return str(value)
    return f"{value:.4g}"
