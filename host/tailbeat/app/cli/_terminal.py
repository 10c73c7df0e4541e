"""How results are printed."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

from tailbeat.app.cli._lazy import typed_words
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.core.printable import printable, printable_lines

TRIAL_MAX = 2**24 - 1  # trials travel as single precision numbers


def command_typed() -> str:
    """The command that runs, as it was typed; empty when something else called it."""
    words = typed_words.get()
    return shlex.join(["tailbeat", *words]) if words else ""


def say(as_json: bool, document: Any, text: str | Callable[[], str] = "") -> None:
    """Prints the JSON document, or the text for people (nothing when empty)."""
    if as_json:
        sys.stdout.write(json.dumps(plain(document), indent=2, allow_nan=False) + "\n")
        return
    words = text() if callable(text) else text
    if words:
        echo(words)


def echo(text: str, err: bool = False, nl: bool = True) -> None:
    """Prints lines for people. Whatever a board, a file or a note brought into the text cannot
    steer the terminal."""
    typer.echo(printable_lines(text), err=err, nl=nl)


def json_line(document: Any) -> None:
    """One line of a JSON stream."""
    sys.stdout.write(json.dumps(plain(document), allow_nan=False) + "\n")
    sys.stdout.flush()


def mm(value_m_s: float | None) -> str:
    """A speed in mm/s, or a dash."""
    if value_m_s is None or not math.isfinite(value_m_s):
        return "-"
    return f"{value_m_s * 1e3:.1f}"


def table(header: list[str], rows: list[list[str]], left: tuple[int, ...] = ()) -> str:
    """Columns under a header; numbers to the right, the columns in ``left`` to the left."""
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(row: list[str]) -> str:
        cells = (
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        return "  ".join(cells).rstrip()

    return "\n".join(map(line, [header, *rows]))


def assignments(pairs: list[str]) -> dict[str, float]:
    """``["kappa=5"]`` to ``{"kappa": 5.0}``."""
    values = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        try:
            values[key.strip()] = float(text)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"'{pair}' is no setting.", "Write it like --set kappa_per_m=5.")
    return values


@contextmanager
def progress_bar(as_json: bool, label: str) -> Iterator[Callable[[float, str], None]]:
    """Gives ``show(fraction, text)``: a bar when a person watches, otherwise nothing."""
    if as_json or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (TextColumn("{task.fields[label]}"), BarColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0, label=label)
        yield lambda fraction, text: bar.update(task, completed=fraction, description=text)
