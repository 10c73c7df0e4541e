"""What a command prints: results on stdout, all else on stderr. Where there is no terminal, lines
take the place of the one that changes.

A program that is ended from outside stops the tail first, and leaves the terminal as it was.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.files import plain
from tailbeat.core.platform.programs import terminal_closed
from tailbeat.core.printable import printable, printable_lines

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live

Number = TypeVar("Number", int, float)
TRIAL_MAX = 2**24 - 1  # trials travel as single precision numbers

typed_words: ContextVar[tuple[str, ...]] = ContextVar("typed_words", default=())
json_asked: ContextVar[bool] = ContextVar("json_asked", default=False)


def command_typed() -> str:
    """The command that runs, as it was typed; empty when something else called it."""
    words = typed_words.get()
    return shlex.join(["tailbeat", *words]) if words else ""


@dataclass(frozen=True)
class Output:
    """What a command prints: the document with --json, else the text (nothing when empty).
    ``status``: exit status. ``error``: raised once it is printed."""

    document: Any
    text: str | Callable[[], str] = ""
    status: int = 0
    error: TailbeatError | None = None


def present(output: Output) -> None:
    """Prints it. Raises its error, typer.Exit for another exit status than 0."""
    if output.error is not None and json_asked.get():
        output.error.document = plain(output.document)  # printed with the error
        raise output.error
    if json_asked.get():
        write_json(output.document)
    elif text := output.text() if callable(output.text) else output.text:
        echo(text)
    if output.error is not None:
        raise output.error
    if output.status:
        raise typer.Exit(output.status)


def pick(source: object, *names: str) -> dict[str, Any]:
    """Keys of a document that are attributes of ``source``."""
    return {name: getattr(source, name) for name in names}


def lines_of(*parts: Any) -> str:
    """One text of lines and of lists of lines; those that are None, empty or False are left out."""
    lines: list[str] = []
    for part in parts:
        lines += [part] if part and isinstance(part, str) else part or ()
    return "\n".join(lines)


def write_json(document: Any, indent: int | None = 2) -> None:
    """One JSON document on stdout, at once."""
    sys.stdout.write(json.dumps(plain(document), indent=indent, allow_nan=False) + "\n")
    sys.stdout.flush()


def print_line(document: Any, text: str) -> None:
    """One document of a JSON stream, or the text for people; at once."""
    if json_asked.get():
        json_line(document)
    else:
        echo(text)
        sys.stdout.flush()


def warn(text: object) -> None:
    """A line on stderr that is no result."""
    echo(f"tailbeat: {text}", err=True)


def echo(text: str, err: bool = False, nl: bool = True) -> None:
    """Prints lines for people. Whatever a board, a file or a note brought into the text cannot
    steer the terminal. At a terminal long lines break between words; tables stay."""
    text = printable_lines(text)
    if (sys.stderr if err else sys.stdout).isatty():
        text = wrapped(text, shutil.get_terminal_size().columns)
    typer.echo(text, err=err, nl=nl)


_COLUMNS = re.compile(r"\S {2,}\S")  # of a table; what stands before a text is shorter than _MARGIN
_MARGIN = 8


def wrapped(text: str, width: int) -> str:
    """Lines of at most ``width`` columns, what goes on indented by four; a table's stay."""
    lines: list[str] = []
    for line in text.split("\n"):
        if len(line) <= width or _COLUMNS.search(line, _MARGIN):
            lines.append(line)
            continue
        indent = " " * (4 + len(line) - len(line.lstrip()))
        parts = textwrap.wrap(
            line, max(width, 20), subsequent_indent=indent, break_long_words=False,
            break_on_hyphens=False, drop_whitespace=True,
        )  # fmt: skip
        lines += parts
        if line.endswith(" "):  # of a question, whose answer is typed behind it
            lines[-1] += " "
    return "\n".join(lines)


def json_line(document: Any) -> None:
    """One line of a JSON stream."""
    write_json(document, None)


def table(header: list[str], rows: list[list[Any]], left: tuple[int, ...] = ()) -> str:
    """Columns under a header; numbers to the right, the columns in ``left`` to the left."""
    lines = [header, *([printable(str(cell)) for cell in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


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


def numbers(text: str, option: str, kind: type[Number]) -> list[Number]:
    """``"1,2"`` to ``[1, 2]``. Raises typer.BadParameter."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError as error:
        words = f"{option}: '{text}' are no numbers with commas between"
        raise typer.BadParameter(words) from error


@contextmanager
def progress_bar(label: str, quiet: bool = False) -> Iterator[Callable[[float, str], None]]:
    """Gives ``show(fraction, text)``: a bar and the time left at a terminal, otherwise nothing."""
    if quiet or json_asked.get() or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    label_column, text_column = map(TextColumn, ("{task.fields[label]}", "{task.description}"))
    columns = (label_column, BarColumn(), text_column, TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, speed_estimate_period=600) as bar:
        task = bar.add_task("", total=1.0, label=label)
        yield lambda fraction, text: bar.update(task, completed=fraction, description=text)


@contextmanager
def bytes_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """As ``progress_bar``, gives ``show(done, total)`` for bytes."""
    with progress_bar(label) as show:
        yield lambda done, total: show(done / max(total, 1), f"{done} bytes")


_WIDTH = 80


class Display:
    """Lines for people. Use as a context manager: the cursor comes back in every case. ``quiet``:
    only what was not expected."""

    def __init__(self, quiet: bool = False) -> None:
        self.moves = sys.stderr.isatty()
        self.quiet = quiet and not self.moves
        self._live: Live | None = None
        self._terminal: Console | None = None
        self._text = ""

    def __enter__(self) -> Display:
        return self

    def __exit__(self, *raised: object) -> None:
        self.clear()

    def show(self, text: str) -> None:
        """The line that changes; nothing without a terminal."""
        if not self.moves or text == self._text:
            return
        from rich.text import Text

        self._text, self._live = text, self._live or self._begin()
        self._live.update(Text(printable(text), no_wrap=True, overflow="ellipsis"), refresh=True)

    @property
    def width(self) -> int:
        """Columns of the line that changes, as wide as the window is now."""
        return self._console().width if self.moves else _WIDTH

    def _console(self) -> Console:
        from rich.console import Console

        if self._terminal is None:
            self._terminal = Console(stderr=True, highlight=False)
        return self._terminal

    def _begin(self) -> Live:
        from rich.live import Live

        console = self._console()
        live = Live(console=console, auto_refresh=False, transient=True, redirect_stdout=False)
        live.start()
        return live

    def keep(self, text: str, loud: bool = False) -> None:
        """A line that stays. ``loud``: also where it is to be quiet."""
        self.clear()
        if loud or not self.quiet:
            echo(text, err=True)

    def bell(self) -> None:
        """A sound, where there is somebody to hear it."""
        if self.moves:
            typer.echo("\a", err=True, nl=False)

    def ask(self, text: str) -> None:
        """A question; the answer is typed behind it."""
        self.clear()
        echo(text, err=True, nl=False)

    def clear(self) -> None:
        """Takes the line that changes away."""
        live, self._live, self._text = self._live, None, ""
        if live is not None:
            live.stop()


_came: list[str] = []


def ended() -> str:
    """Why the program is to end, in words; empty = it is not."""
    return _came[0] if _came else ""


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """For the length of a block these signals raise KeyboardInterrupt with words; one that is
    ignored (nohup), or that somebody else handles, stays with them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [signal.SIGTERM, *terminal_closed()]
    taken = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    begun_by = os.getpid()

    def end(number: int, _: FrameType | None) -> None:
        if os.getpid() != begun_by:  # a worker that was forked ends at once
            os._exit(128 + number)
        _came.append(f"ended by {signal.Signals(number).name}")
        raise KeyboardInterrupt(_came[0])

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
        _came.clear()
