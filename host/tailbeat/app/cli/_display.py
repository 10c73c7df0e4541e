"""Where a guided swim is shown: one line that changes where there is a terminal, plain lines where
there is none. Everything on stderr; stdout is for results.

A program that is ended from outside stops the tail first, and leaves the terminal as it was.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

import typer

from tailbeat.app.cli._terminal import echo
from tailbeat.core.printable import printable

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


_NAMES = ("SIGTERM", "SIGHUP")  # ended by the system; the terminal was closed

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
    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
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
