"""Single keys of the terminal, without Enter and not shown."""

from __future__ import annotations

import importlib
import os
import select
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from tailbeat.core.errors import TailbeatError

_CTRL_C = "\x03"
_SPECIAL = ("\0", "\xe0")  # Windows
_LOOK_S = 0.02
_ESCAPE_BYTE = b"\x1b"
_ARROW_S = 0.05  # the rest of its sequence follows at once, also over a network


class TerminalGone(TailbeatError):
    """Whoever was there to answer is not any more."""

    def __init__(self) -> None:
        super().__init__(
            "the terminal is gone, and nothing was decided",
            "The trial waits on the board; run the same command again.",
        )


class Keys(Protocol):
    """What the operator types."""

    def pressed(self) -> bool:
        """Whether any key was pressed since the last question; never waits."""

    def forget(self) -> None:
        """What was typed before a question is no answer to it."""

    def key(self, timeout_s: float) -> str | None:
        """The next key, in small letters; None when none comes in time, or one that is no letter
        (an arrow). Raises TerminalGone."""

    def line(self) -> str:
        """What is typed up to Enter, seen as it is typed."""


@contextmanager
def terminal_keys(system: str = sys.platform) -> Iterator[Keys | None]:
    """The keys of the terminal for the length of a block; None when there is none. The terminal is
    put back as it was in every case."""
    if not sys.stdin.isatty():
        yield None
    elif system == "win32":
        yield _Console()
    else:
        terminal = _Terminal(sys.stdin.fileno())
        try:
            terminal.single()
            yield terminal
        finally:
            terminal.restore()


class _Console:
    """The console of Windows."""

    def __init__(self) -> None:
        self._console: Any = importlib.import_module("msvcrt")

    def pressed(self) -> bool:
        return bool(self._console.kbhit())

    def forget(self) -> None:
        while self._console.kbhit():
            self._console.getwch()

    def key(self, timeout_s: float) -> str | None:
        end_s = time.monotonic() + timeout_s
        while not self._console.kbhit():
            if time.monotonic() >= end_s:
                return None
            time.sleep(_LOOK_S)
        key = str(self._console.getwch()).lower()
        if key in _SPECIAL:  # of two characters, the second often a letter
            self._console.getwch()
            return None
        if key == _CTRL_C:
            raise KeyboardInterrupt
        return key

    def line(self) -> str:
        return input()


class _Terminal:
    """A POSIX terminal, read around Python's own buffer."""

    def __init__(self, descriptor: int) -> None:
        self._modes: Any = importlib.import_module("termios")
        self._descriptor = descriptor
        self._usual = self._modes.tcgetattr(descriptor)
        self._gone = False

    def single(self) -> None:
        """Keys come at once and are not shown; Ctrl-C stays what it is."""
        tty: Any = importlib.import_module("tty")
        tty.setcbreak(self._descriptor, self._modes.TCSADRAIN)

    def restore(self) -> None:
        """As it was found. What was typed and not read is forgotten: a key that should stop
        the tail must not become a command of the shell."""
        try:
            self._modes.tcsetattr(self._descriptor, self._modes.TCSAFLUSH, self._usual)
        except self._modes.error:
            self._gone = True

    def pressed(self) -> bool:
        return not self._gone and self._ready(0.0)

    def forget(self) -> None:
        try:
            self._modes.tcflush(self._descriptor, self._modes.TCIFLUSH)
        except self._modes.error:
            self._gone = True

    def key(self, timeout_s: float) -> str | None:
        if not self._gone and not self._ready(timeout_s):
            return None
        piece = self._read()
        if piece == _ESCAPE_BYTE and self._ready(_ARROW_S):
            piece += self._read()
        if piece.startswith(_ESCAPE_BYTE) and len(piece) > 1:
            return None
        return piece.decode(errors="replace")[:1].lower()

    def line(self) -> str:
        self.restore()
        try:
            return self._read().decode(errors="replace").strip()
        finally:
            self.single()

    def _ready(self, timeout_s: float) -> bool:
        return bool(select.select([self._descriptor], [], [], timeout_s)[0])

    def _read(self) -> bytes:
        try:
            piece = b"" if self._gone else os.read(self._descriptor, 1024)
        except OSError:
            piece = b""
        if not piece:
            self._gone = True
            raise TerminalGone
        return piece
