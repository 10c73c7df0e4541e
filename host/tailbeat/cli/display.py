"""Where a guided swim is shown: one line that changes where there is a terminal, plain lines where
there is none. Everything on stderr; stdout is for results."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING

import typer

from tailbeat.cli.common import echo
from tailbeat.printable import printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.clear()

    def show(self, text: str) -> None:
        """The line that changes; nothing without a terminal."""
        if not self.moves or text == self._text:
            return
        from rich.text import Text

        self._text = text
        if self._live is None:
            self._live = self._begin()
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
